"""What a command prints when a run has ended."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from hir_core.run.run_directory import RunDirectory


def explanation_sentence(document: Mapping[str, Any]) -> str:
    """The selected material and light beside the runner-up, from run.json; empty where none were compared."""
    report = document.get("stages", {}).get("reflectance", {}).get("report") or {}
    return str((report.get("explanation") or {}).get("sentence", ""))


def show_summary(directory: RunDirectory) -> None:
    """Prints where the results are."""
    if sentence := explanation_sentence(directory.read_run()):
        click.echo(f"{'model':>8}  {sentence}")
    lines = [("asset", directory.scene), ("files", directory.exports), ("report", directory.path / "report.html")]
    for name, path in lines:
        if path.exists():
            click.echo(f"{name:>8}  {path}")
    if directory.exports.is_dir():
        for file in sorted(directory.exports.iterdir()):
            click.echo(f"{'':>8}  {file.name}  {file.stat().st_size / 1e6:.2f} MB")
