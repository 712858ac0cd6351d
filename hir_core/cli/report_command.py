"""`hir report`: renders the pictures of a run and writes its page."""

from __future__ import annotations

from pathlib import Path

import click

from hir_core.terminal.command_options import FOLDER, plugin_option, verbosity_options
from hir_core.terminal.plugin_problems import echo_problems
from hir_core.terminal.required_packages import require_reconstruction_packages


@click.command("report")
@click.argument("run", type=FOLDER)
@plugin_option
@verbosity_options
def report_command(run: Path, plugin_files: tuple[str, ...], quiet: bool, verbose: bool) -> None:
    """Renders the pictures of RUN again and writes its report.html."""
    require_reconstruction_packages("hir report")
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.run_directory import open_run

    directory = open_run(run)
    plugins = PluginManager.discover(plugin_files)
    from hir_core.report import write_report

    known = len(plugins.problems)
    page = write_report(directory, plugins)
    echo_problems(plugins.problems[known:])
    if not quiet:
        click.echo(str(page))
