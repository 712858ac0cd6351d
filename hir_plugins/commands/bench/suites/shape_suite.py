"""Shapes: chains of initializers, with and without the geometry stage, against true meshes of made captures.

The captures come from `python -m benchmarks.shape make`; any capture with cameras, masks and `reference.obj` serves.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.config import load_config
from hir_core.errors import HirError
from hir_core.files.json_documents import read_json
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.mesh_validity import MeshState, inspect_mesh
from hir_core.metrics.surface_metrics import compare_surfaces
from hir_core.run.machine import source_commit
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.bench_captures import decode_images, true_mesh
from hir_plugins.commands.bench.measurement import Stopwatch
from hir_plugins.commands.bench.results.bench_result import Case, Result, Role, Row, Timing
from hir_plugins.commands.bench.suites.initializers_suite import ChainStep, run_chain

FORMER_CHAIN: Final[tuple[ChainStep, ...]] = (("visual_hull", {}),)
"""The default chain before a photograph could open the hull; kept for comparison."""

FUSED_DEPTHS: Final[tuple[ChainStep, ...]] = (("stereo", {"surface": "tsdf"}),)


@dataclass(frozen=True)
class ShapeMethod:
    """A way from photographs to a mesh."""

    label: str
    chain: tuple[ChainStep, ...]
    geometry: bool
    """Whether the geometry stage of the default preset follows."""
    role: Role = "ours"


def shape_rows(options: BenchOptions) -> Iterator[Row]:
    """Rows for each capture and method.

    `WORKSPACE/shape/CAPTURE.json` stores the rows of each capture with the commit and the machine. Rows of the same
    commit are read from there, so an interrupted suite continues where it ended.
    """
    for path in made_captures(options.captures):
        capture = read_capture(path, "train", options.plugins)
        truth = true_mesh(path, capture)
        if truth is None or any(view.camera is None for view in capture.views):
            continue
        file = options.workspace / "shape" / f"{path.name}.json"
        known = _stored_rows(file)
        rows: list[Row] = []
        decoded = decode_images(capture)
        for method in shape_methods(options, decoded):
            row = known.get(method.label) or measured_row(method, path, decoded, truth, options)
            rows.append(row)
            command = f"hir bench shape --capture {path.name}"
            Result("shape", tuple(rows), settings={"command": command}).write(file)
            yield row


def made_captures(folders: tuple[Path, ...]) -> list[Path]:
    """The captures with a true mesh among the folders and, for a folder without one, among the folders in it."""
    found: list[Path] = []
    for folder in folders:
        inner = [folder] if (folder / "reference.obj").is_file() else sorted(folder.glob("*/"))
        found += [path for path in inner if (path / "reference.obj").is_file()]
    return found


def shape_methods(options: BenchOptions, capture: Capture) -> list[ShapeMethod]:
    """The hull, multi-view stereo, its depths fused by open3d, and the geometry stage after the former and the
    suggested chain.
    """
    suggested: tuple[ChainStep, ...] = tuple((name, {}) for name in options.plugins.suggest_initializers(capture))
    methods = [
        ShapeMethod("visual_hull", FORMER_CHAIN, False),
        ShapeMethod("visual_hull, geometry", FORMER_CHAIN, True),
    ]
    if suggested != FORMER_CHAIN:
        methods.append(ShapeMethod("default: " + ", ".join([*dict(suggested), "geometry"]), suggested, True))
    if not options.quick:
        methods.append(ShapeMethod("stereo", (("stereo", {}),), False))
    if options.peers and not options.quick:
        methods.append(ShapeMethod("open3d TSDF of stereo's depths", FUSED_DEPTHS, False, "peer"))
    return methods


def measured_row(
    method: ShapeMethod,
    path: Path,
    capture: Capture,
    truth: tuple[NDArray[np.float64], NDArray[np.int64]],
    options: BenchOptions,
) -> Row:
    """Time and errors of one method; a note where it makes no mesh."""
    case = _case(path)
    try:
        scene, timing = run_chain(method.chain, capture, options)
        if method.geometry:
            scene, timing = _with_geometry(scene, timing, capture, options)
    except HirError as error:
        return Row(case, method.label, method.role, None, note=f"no mesh: {error}")
    mesh = (scene.mesh.positions.detach().numpy().astype(np.float64), scene.mesh.faces.numpy())
    figures = compare_surfaces(mesh, truth, capture.cameras)
    state, true_state = inspect_mesh(*mesh), inspect_mesh(*truth)
    errors = {
        "Chamfer, radii": figures.chamfer,
        "completeness": figures.completeness,
        "normals, °": figures.normal_error_deg,
        "self-intersecting": float(state.self_intersecting),
    }
    if state.watertight:
        errors["genus error"] = float(abs(state.genus - true_state.genus))
    return Row(case, method.label, method.role, timing, errors, _note(state, true_state))


def _note(state: MeshState, truth: MeshState) -> str:
    if not state.watertight:
        return f"open; the truth has genus {truth.genus}"
    return f"genus {state.genus} of {truth.genus}, components {state.components} of {truth.components}"


def _case(path: Path) -> Case:
    """Object, kind and material where the benchmark made the capture, else its name."""
    if not (path / "truth.json").is_file():
        return {"capture": path.name}
    document: Mapping[str, Any] = read_json(path / "truth.json")
    known = {name: str(document[name]) for name in ("object", "kind", "material") if name in document}
    return known or {"capture": path.name}


def _with_geometry(scene: Scene, before: Timing, capture: Capture, options: BenchOptions) -> tuple[Scene, Timing]:
    """The scene after the geometry stage of the default preset, and the time of chain and stage together."""
    settings = load_config(options.plugins).geometry
    stopwatch = Stopwatch()
    with tempfile.TemporaryDirectory() as folder:
        workspace = Path(folder)
        (workspace / "checkpoints").mkdir()
        fitted, _ = fit_geometry(scene, capture, settings, StageContext(options.plugins, workspace))
    own = stopwatch.timing()
    memory = max(before.memory_bytes or 0, own.memory_bytes or 0) or None
    seconds = before.median + own.median
    return replace(scene, mesh=fitted.scene.mesh), Timing(seconds, seconds, seconds, 1, before.cpu + own.cpu, memory)


def _stored_rows(file: Path) -> Mapping[str, Row]:
    """The rows of an earlier suite by method; none where the file is missing or its commit is another or unknown."""
    if not file.is_file():
        return {}
    stored = Result.read(file)
    commit = source_commit()
    same = stored.commit == commit and commit != "" and not commit.endswith("-dirty")
    return {row.method: row for row in stored.rows} if same else {}
