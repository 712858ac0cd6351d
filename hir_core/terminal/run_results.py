"""What a command prints when a run has ended."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from hir_core.run.run_directory import LAST_STAGE, SCENE_STAGE, RunDirectory


def decisions(document: Mapping[str, Any]) -> dict[str, str]:
    """What held-out views decided, from run.json: the selected material and light (`model`) and the shape, each beside
    the runner-up, whether initializers' changes of the mesh were kept (`change`), whether it was revised (`mesh`),
    exposures that differ, and where the scale between albedo and light was measured; and what gave the metres and
    corrected measured depths. Empty where nothing was compared or measured.
    """
    initial = document.get("stages", {}).get("initializer", {}).get("report") or {}
    metres, depths = initial.get("scale_from"), (initial.get("depth_scale") or {}).get("sentence")
    report = document.get("stages", {}).get("reflectance", {}).get("report") or {}
    scale = report.get("light_scale") or {}
    found = {
        "model": report.get("explanation"),
        "shape": report.get("shape"),
        "change": report.get("unchanged_mesh"),
        "mesh": report.get("revision"),
        "exposure": report.get("exposures"),
        "scale": scale if scale.get("source") == "card" else None,
    }
    sentences = {name: str(part["sentence"]) for name, part in found.items() if part and part.get("sentence")}
    sentences |= {"metres": f"from {metres}"} if metres else {}
    return sentences | ({"depths": str(depths)} if depths else {})


def show_summary(directory: RunDirectory) -> None:
    """Prints where the results are."""
    document = directory.read_run()
    for name, sentence in decisions(document).items():
        click.echo(f"{name:>8}  {sentence}")
    lines = [
        ("asset", directory.scene, SCENE_STAGE),
        ("files", directory.exports, LAST_STAGE),
        ("report", directory.path / "report.html", SCENE_STAGE),
    ]
    for name, path, stage in lines:
        if path.exists():
            earlier = "" if stage in document.get("stages", {}) else " (of an earlier call; --resume finishes this one)"
            click.echo(f"{name:>8}  {path}{earlier}")
    if directory.exports.is_dir():
        for file in sorted(directory.exports.iterdir()):
            click.echo(f"{'':>8}  {file.name}  {file.stat().st_size / 1e6:.2f} MB")


def say_earlier_scene(run: Path, shown: str) -> None:
    """One sentence on stderr where a run was started again and has not reached its scene since then.

    `shown` is subject and verb of what the command makes, such as `the files show`. Other folders have no sentence.
    """
    if (run / "run.json").is_file() and not RunDirectory(run).has_finished_scene:
        click.echo(
            f"hir: {run}: its latest call ended before the stage {SCENE_STAGE}, so {shown} the scene of an earlier "
            "one; finish the run with: hir reconstruct … --resume",
            err=True,
        )
