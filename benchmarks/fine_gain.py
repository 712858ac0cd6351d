"""How much of the fine candidate of photo-consistency pays: `LEAST_FINE_GAIN` against true meshes.

    python -m benchmarks.fine_gain CAPTURE… [--seeds 0] [--store benchmarks/results/fine_gain.jsonl]
    python -m benchmarks.fine_gain --table benchmarks/results/fine_gain.jsonl

The default chain and its geometry stage, as `hir reconstruct` runs them, with today's value and the candidates of
`benchmarks.default_values`, and with a value so large that the fine candidate is never taken. What does not depend on
the constant is computed once for a capture and seed: initial mesh, silhouettes and all passes but the last. Captures
come from `python -m benchmarks.shape make`. Rows carry commit, date and machine; a row that is stored already is not
measured again.
"""

from __future__ import annotations

import hashlib
import statistics
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.default_values import DEFAULT_VALUES, gain_of
from benchmarks.mesh_chains import CHAINS
from benchmarks.stored_rows import add_rows, provenance, stored_rows, study_arguments
from hir_core.capture import Capture
from hir_core.config import load_config
from hir_core.intake.reader_lookup import read_capture
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene
from hir_core.stages.geometry import geometry_fit
from hir_core.stages.geometry.photo_consistency import photo_refinement
from hir_core.stages.geometry.photo_consistency.photo_consistency_report import PhotoConsistencyReport
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_mesh

STAGE = "hir_core.stages.geometry"
CONSTANT = DEFAULT_VALUES["least_fine_gain"]
NEVER = 1e9
VALUES = (*map(float, (CONSTANT.value, *CONSTANT.candidates)), NEVER)
MEASURES = {"chamfer": "Chamfer distance", "normals_deg": "normals"}


@contextmanager
def computed_once() -> Iterator[None]:
    """For one capture and seed: fits of silhouettes and passes of photo-consistency are kept.

    The same mesh, views and plan give the same.
    """

    def kept(function: Callable[..., Any], key: Callable[..., Any]) -> Callable[..., Any]:
        known: dict[Any, Any] = {}

        def called(*arguments: Any) -> Any:
            found = key(*arguments)
            if found not in known:
                known[found] = function(*arguments)
            return known[found]

        return called

    with (
        patch(f"{STAGE}.geometry_fit._prepare", kept(geometry_fit._prepare, lambda mesh, *rest: _key(mesh))),
        patch(
            f"{STAGE}.geometry_fit._fit_silhouettes",
            kept(geometry_fit._fit_silhouettes, lambda mesh, *rest: _key(mesh)),
        ),
        patch(f"{STAGE}.photo_consistency.photo_refinement.fit_pass", kept(photo_refinement.fit_pass, _key_of_pass)),
    ):
        yield


def _key(mesh: Mesh) -> str:
    arrays = (mesh.positions.detach().numpy().tobytes(), mesh.faces.numpy().tobytes())
    return hashlib.blake2b(b"".join(arrays)).hexdigest()


def _key_of_pass(mesh: Mesh, details: Any, neighbours: Any, train: Sequence[int], *rest: Any) -> Any:
    plan = rest[3]
    return _key(mesh), tuple(train), plan


def initial_scene(capture: Capture, seed: int, plugins: PluginManager) -> Scene:
    """The scene that the default chain of initializers gives to the geometry stage."""
    scene: Scene | None = None
    with tempfile.TemporaryDirectory() as folder:
        for name in CHAINS["default"]:
            initializer = plugins.create("initializer", name, {"vertex_colors": False}, seed)
            _, scene = initializer.initialize(capture, scene, Path(folder))
    assert scene is not None
    return scene


def measured(path: Path, seed: int, plugins: PluginManager) -> Iterator[dict[str, Any]]:
    """Errors of the mesh with each value."""
    capture = decode_images(read_capture(path, "train", plugins))
    truth = true_mesh(path, capture)
    assert truth is not None, f"{path} has no reference.obj"
    scene = initial_scene(capture, seed, plugins)
    settings = load_config(plugins).geometry
    with computed_once():
        for value in VALUES:
            with (
                tempfile.TemporaryDirectory() as folder,
                patch(f"{STAGE}.photo_consistency.photo_refinement.LEAST_FINE_GAIN", value),
            ):
                (Path(folder) / "checkpoints").mkdir()
                context = StageContext(plugins, Path(folder), seed=seed)
                fitted, report = geometry_fit.fit_geometry(scene, capture, settings, context)
            mesh, refined = fitted.scene.mesh, report.photo_consistency
            arrays = (mesh.positions.detach().numpy().astype(np.float64), mesh.faces.numpy())
            figures = compare_surfaces(arrays, truth, capture.cameras)
            fine = refined.fine if isinstance(refined, PhotoConsistencyReport) else None
            yield {
                "capture": path.name,
                "half": path.parent.name,
                "seed": seed,
                "least_fine_gain": value,
                "share": fine and fine.share,
                "gain": fine and fine.gain,
                "noise": fine and fine.noise,
                "chamfer": round(figures.chamfer, 7),
                "normals_deg": round(figures.normal_error_deg, 4),
                **provenance(),
            }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: shares and errors of each capture, and how much lower the candidates' errors are, in per cent."""
    captures = sorted({row["capture"] for row in rows})
    values = [value for value in VALUES if any(row["least_fine_gain"] == value for row in rows)]

    def of(capture: str, value: float, key: str) -> list[float]:
        chosen = [row for row in rows if (row["capture"], row["least_fine_gain"]) == (capture, value)]
        return [row[key] for row in sorted(chosen, key=lambda row: row["seed"]) if row[key] is not None]

    def means(capture: str, key: str, form: str) -> str:
        found = [of(capture, value, key) for value in values]
        return ", ".join(format(statistics.mean(each), form) if each else "–" for each in found)

    names = ", ".join(f"{value:g}" if value < NEVER else "never" for value in values)
    lines = [
        f"Values: {names}.",
        "",
        "| capture | gain ± noise | share | Chamfer | normals, ° |",
        "|---|---|---|---|---|",
    ]
    for capture in captures:
        gain, noise = (of(capture, values[0], key) for key in ("gain", "noise"))
        cells = [
            f"{statistics.mean(gain):.3f} ± {statistics.mean(noise):.3f}" if gain else "not refined",
            means(capture, "share", ".2f"),
            means(capture, "chamfer", ".6f"),
            means(capture, "normals_deg", ".2f"),
        ]
        lines.append(f"| {capture} | {' | '.join(cells)} |")
    lines += ["", "| value | measure | lower by, % | verdict |", "|---|---|---|---|"]
    for value in values[1:]:
        for key, name in MEASURES.items():
            # per cent, so that captures of other sizes weigh the same
            decibels = [
                {c: [-100 * np.log(error) for error in of(c, v, key)] for c in captures} for v in (values[0], value)
            ]
            gain = gain_of(*decibels)
            label = f"{value:g}" if value < NEVER else "never"
            lines.append(f"| {label} | {name} | {gain.mean:+.2f} ± {gain.standard_error:.2f} | {gain.verdict} |")
    return "\n".join(lines)


def main() -> None:
    options = study_arguments(__doc__, Path("benchmarks/results/fine_gain.jsonl"), table)
    plugins = PluginManager.discover()
    known = {(row["capture"], row["seed"]) for row in stored_rows(options.store)}
    for seed in options.seeds:
        for path in options.captures:
            if (path.name, seed) not in known:
                add_rows(options.store, measured(path, seed, plugins))


if __name__ == "__main__":
    main()
