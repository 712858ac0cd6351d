"""A command: what differs between runs, side by side: settings, figures of the stages, seconds.

hir --help        lists it where the file is installed as a plugin; `--plugin` cannot add commands
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from hir_core.plugins import hookimpl


@click.command("compare-runs")
@click.argument("runs", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--all", "with_equal", is_flag=True, help="Print equal values, too.")
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def compare_runs(runs: tuple[Path, ...], with_equal: bool, as_json: bool) -> None:
    """Prints the settings, figures and seconds in which RUNS differ."""
    columns = [_facts(run) for run in runs]
    names = list(dict.fromkeys(name for facts in columns for name in facts))
    rows = {name: [facts.get(name) for facts in columns] for name in names}
    if not with_equal and len(runs) > 1:
        rows = {name: values for name, values in rows.items() if any(value != values[0] for value in values)}
    if as_json:
        click.echo(json.dumps({"runs": [str(run) for run in runs], "rows": rows}, indent=1))
        return
    width = max(map(len, rows), default=0)
    click.echo("  ".join([" " * width, *(f"{run.name[:16]:>16}" for run in runs)]))
    for name, values in rows.items():
        click.echo("  ".join([f"{name:<{width}}", *(f"{_text(value):>16}" for value in values)]))


def _facts(run: Path) -> dict[str, Any]:
    """Every setting, every figure of a stage's report, and the seconds of each stage, by a name with points."""
    from hir_core.errors import InputError

    try:
        document = json.loads((run / "run.json").read_text(encoding="utf-8"))
        timings = json.loads((run / "timings.json").read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{run} is not a finished run: {error}") from None
    facts = dict(_flat("settings", document.get("settings", {})))
    for stage, entry in document.get("stages", {}).items():
        facts.update(_flat(stage, entry.get("report", {})))
    for stage, entry in timings.get("stages", {}).items():
        facts[f"{stage}.seconds"] = entry.get("seconds")
    return facts


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    """Numbers, words and switches inside of nested tables; lists are left out."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}", inner)
    elif isinstance(value, str | int | float | bool):
        yield name, value


def _text(value: Any) -> str:
    return "–" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)[:16]


@hookimpl
def hir_register_commands(cli: click.Group) -> None:
    cli.add_command(compare_runs)
