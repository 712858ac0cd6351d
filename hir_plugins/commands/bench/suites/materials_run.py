"""One run of the materials benchmark: `hir reconstruct`, its evaluation, and the file that holds the figures."""

from __future__ import annotations

import re
import shutil
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

from pydantic import TypeAdapter

from hir_core.evaluation import EvaluationRequest, evaluate_run
from hir_core.evaluation.truth_evaluation import TRUE_MESH
from hir_core.files.json_documents import read_json, write_json
from hir_core.intake.reader_lookup import find_reader
from hir_core.metrics import mean
from hir_core.pipeline import reconstruct
from hir_core.plugins.manager import PluginManager
from hir_core.run.finished_run import open_finished_run
from hir_core.run.machine import describe_machine, source_commit
from hir_core.run.run_directory import RunDirectory
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture
from hir_plugins.commands.bench.inputs.parameter_errors import parameter_errors
from hir_plugins.commands.bench.inputs.simplified_truth import write_simplified
from hir_plugins.commands.bench.materials_options import MeshSource
from hir_plugins.commands.bench.results.bench_result import Timing
from hir_plugins.commands.bench.results.materials_summary import RELIT, UNSEEN

EVALUATED_VIEWS: Final = 6
"""Of each split."""
PATHS_PER_PIXEL: Final = 256
"""As `hir evaluate`. The noise of 64 takes up to 1 dB from a good fit (docs/studies/remaining_error.md)."""


@dataclass(frozen=True)
class RunKey:
    """What was run; a stored result of another key is measured again."""

    capture: str
    half: str
    mesh: MeshSource
    seed: int
    settings: tuple[str, ...]
    """Those of every run, then those of the forced hypothesis."""
    commit: str


@dataclass(frozen=True)
class RunFigures:
    """What a run found, and its errors."""

    kind: str
    """Of the finished material: diffuse, dielectric, metal or mixed."""
    light_frame: str
    """`camera` also where the camera carries a lamp."""
    model: str
    """Name of the selected model."""
    errors: Mapping[str, float]
    timing: Timing
    reflectance: Mapping[str, Any]
    """The report of the reflectance stage, with all comparisons of the selection."""
    machine: Mapping[str, Any]
    margin_within_noise: bool | None = None
    """Whether the selection says that the runner-up is within noise; None where the run does not say."""


def run_figures(key: RunKey, capture: MaterialsCapture, workspace: Path, plugins: PluginManager) -> RunFigures:
    """The stored figures of `key`, or those of a new run; an interrupted run is resumed.

    A result of changed source files is never reused: their commit does not say what they held.
    """
    folder = workspace / "materials" / _folder_name(key)
    stored = folder.with_suffix(".json")
    dirty = key.commit.endswith("-dirty") or not key.commit
    if dirty:
        shutil.rmtree(folder, ignore_errors=True)
    elif stored.is_file():
        document = read_json(stored)
        if document.get("key") == asdict(key) | {"settings": list(key.settings)}:
            return TypeAdapter(RunFigures).validate_python(document["figures"])
    settings = ("export=[]", f"seed={key.seed}", *_mesh_settings(key, capture, workspace), *key.settings)
    run = reconstruct(capture.folder, folder, resume=True, plugins=plugins, assignments=settings)
    figures = evaluated(run.directory, capture, plugins)
    write_json(stored, {"key": asdict(key), "figures": asdict(figures)})
    shutil.rmtree(folder)  # some 50 MB each; the figures are what is kept
    return figures


def evaluated(directory: RunDirectory, capture: MaterialsCapture, plugins: PluginManager) -> RunFigures:
    """The figures of a finished run."""
    request = EvaluationRequest(options={"render_samples": PATHS_PER_PIXEL}, views=EVALUATED_VIEWS)
    unseen = evaluate_run(directory, request, plugins)["psnr"]
    splits = find_reader(capture.folder, plugins)[1].splits(capture.folder)
    relit = [evaluate_run(directory, replace(request, split=s), plugins) for s in splits if s.startswith("relight")]
    run = open_finished_run(directory)
    material, light = run.scene.material, run.scene.environment
    assert material is not None and light is not None
    test = run.read_split(capture.folder, "test", plugins)
    parameters = parameter_errors(run.scene, test, capture.folder / "truth_test")
    errors = {
        UNSEEN: unseen["object"],
        "unseen dB, frame": unseen["frame"],
        RELIT: mean([found["psnr_scaled"]["frame"] for found in relit]) or 0.0,
        **parameters.errors,
    }
    report = run.document["stages"]["reflectance"]["report"]
    explanation = report.get("explanation")
    return RunFigures(
        parameters.kind(material),
        "camera" if light.lamp is not None else light.frame,
        str(report.get("model")),
        errors,
        _timing(directory),
        report,
        describe_machine("cpu"),
        bool(explanation["near_tie"]) if explanation else None,
    )


def current_key(capture: MaterialsCapture, mesh: MeshSource, seed: int, settings: tuple[str, ...] = ()) -> RunKey:
    """The key of a run with the code of this checkout."""
    return RunKey(capture.name, capture.half, mesh, seed, settings, source_commit())


def _mesh_settings(key: RunKey, capture: MaterialsCapture, workspace: Path) -> tuple[str, ...]:
    """The settings that hold the true mesh fixed, simplified; none for a run that reconstructs its own."""
    if key.mesh == "reconstructed":
        return ()
    mesh = workspace / "materials" / "true_meshes" / f"{capture.name}.ply"
    if not mesh.is_file():
        write_simplified(capture.folder / TRUE_MESH, mesh)
    return (
        'initializers=["mesh_file"]',
        f"initializer.mesh_file.path='{mesh.resolve()}'",
        "initializer.mesh_file.vertex_colors=false",
        "geometry.enabled=false",
    )


def _folder_name(key: RunKey) -> Path:
    """commit / mesh / capture / settings and seed."""
    settings = "_".join(re.sub(r"[^\w.-]+", "-", setting.rpartition(".")[2]) for setting in key.settings) or "selected"
    return Path(key.commit or "installed", key.mesh, key.capture, f"{settings}_seed{key.seed}")


def _timing(directory: RunDirectory) -> Timing:
    """Seconds of all stages, without the evaluation."""
    stages = directory.read_timings()["stages"].values()
    seconds = sum(float(stage["seconds"]) for stage in stages)
    cpu = sum(float(stage["processor_seconds"]) for stage in stages)
    memory = max(int(stage["peak_memory_bytes"]) for stage in stages)
    return Timing(seconds, seconds, seconds, 1, cpu, memory)
