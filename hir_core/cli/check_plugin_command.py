"""`hir check-plugin`: runs the contract tests without pytest."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from hir_core.terminal.command_options import plugin_option
from hir_core.terminal.plugin_problems import echo_problems

if TYPE_CHECKING:
    from hir_core.testing import Result

OUTCOME_LABELS = {
    "passed": "ok",
    "failed": "FAILED",
    "skipped": "skipped",
    "expected": "expected",
    "unexpected_pass": "FAILED",
}


@click.command("check-plugin")
@click.argument("name")
@click.option(
    "--only",
    multiple=True,
    metavar="CHECK",
    help="Run this check only, after those that it depends on; repeatable. Default: all checks.",
)
@click.option(
    "--set",
    "assignments",
    multiple=True,
    metavar="KEY=VALUE",
    help="Set an option of the component, such as samples=64; repeatable.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the results as JSON.")
@click.option("-q", "--quiet", is_flag=True, help="Print failures only.")
@plugin_option
def check_plugin_command(
    name: str,
    only: tuple[str, ...],
    assignments: tuple[str, ...],
    as_json: bool,
    quiet: bool,
    plugin_files: tuple[str, ...],
) -> None:
    """Runs the contract tests of NAME: a component, KIND:COMPONENT, an observer, a command, a distribution, or the .py
    file of a plugin.

    The exit code is 2 if a check fails. Each failure names the contract, the observed value and the page of the docs.
    """
    from hir_core.config import assign
    from hir_core.errors import PluginError
    from hir_core.plugins.manager import PluginManager
    from hir_core.testing import check_component, check_whole_plugin, checks_for, whole_plugin
    from hir_core.testing.contract import PLUGIN
    from hir_core.testing.running import named, plugin_checks

    if name.endswith(".py") and name not in plugin_files:
        plugin_files = (*plugin_files, name)
    plugins = PluginManager.discover(plugin_files, strict=False)
    options: dict[str, object] = {}
    for assignment in assignments:
        assign(options, assignment)
    whole, components = whole_plugin(name, plugins), named(name, plugins)
    known = {check.name for r in components for check in checks_for(r)}
    known |= {check.name for check in plugin_checks()} if whole is not None else set()
    unknown = sorted(set(only) - known)
    if unknown:
        raise PluginError(f"{name!r} has no check {unknown[0]!r}; its checks are: {', '.join(sorted(known))}")
    results: list[Result] = []

    def is_absent(result: Result) -> bool:
        # what a plugin does not have, such as observers, would be a line for each of its contracts
        return result.kind == PLUGIN and result.outcome == "skipped"

    def show(title: str, found: list[Result]) -> None:
        # a check that runs because another depends on it is reported where it fails
        found = [result for result in found if not only or result.check in only or not result.is_ok]
        results.extend(found)
        if not (as_json or quiet):
            click.echo(title)
        for result in found:
            if not as_json and not (quiet and result.is_ok) and not is_absent(result):
                _print_result(result)

    problems = [problem for problem in plugins.problems if whole is None and name in problem]
    if whole is not None:
        own = [check.name for check in plugin_checks() if check.name in only]
        if own or not only:
            show(f"plugin {name}", check_whole_plugin(whole, only=own, raises=False))
    for registered in components:
        if registered.missing:
            raise PluginError(
                f"{registered.kind} {registered.component.name!r} cannot run here: it needs "
                f"{', '.join(registered.missing)}; install it with: {registered.install_command}"
            )
        own = [check.name for check in checks_for(registered) if check.name in only]
        if own or not only:
            title = f"{registered.kind.replace('_', ' ')} {registered.component.name} ({registered.distribution})"
            show(title, check_component(registered, only=own, options=options, plugins=plugins, raises=False))
    failed = [result for result in results if not result.is_ok]
    if as_json:
        click.echo(json.dumps({"results": [asdict(r) for r in results], "problems": problems}, indent=1))
    else:
        echo_problems(problems)
        for notice in plugins.notices:
            click.echo(f"hir: plugin notice: {notice}", err=True)
        passed = sum(result.outcome == "passed" for result in results)
        absent = sum(is_absent(result) for result in results)
        skipped = sum(result.outcome == "skipped" for result in results) - absent
        rest = f", {absent} {'does' if absent == 1 else 'do'} not concern it" if absent else ""
        click.echo(f"{passed} checks passed, {len(failed)} failed, {skipped} skipped{rest}")
    if failed or problems:
        raise click.exceptions.Exit(2)


def _print_result(result: Result) -> None:
    label = click.style(
        f"{OUTCOME_LABELS[result.outcome]:>8}", fg={"passed": "green", "failed": "red"}.get(result.outcome)
    )
    reason = f"  {result.detail}" if result.is_ok and result.detail else ""
    click.echo(f"{label}  {result.check:<36} {result.seconds:6.1f} s{reason}")
    if not result.is_ok:
        for line in result.detail.splitlines()[1:]:
            click.echo(f"{'':>8}  {line}")
