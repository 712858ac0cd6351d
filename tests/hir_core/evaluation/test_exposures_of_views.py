"""Views of a run whose exposures differ: training views at those of the fit, other views at exposures of their own."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from PIL import Image

from hir_core.capture.photograph_exposures import PhotographExposures
from hir_core.evaluation import EvaluationRequest, evaluate_run
from hir_core.files.json_documents import read_json, write_json
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory

FACTORS = (0.8, 0.5, 0.6)
CHEAP = {"render_samples": 64}


@pytest.fixture
def own(finished: Run, tiny_capture: Path, tmp_path: Path) -> RunDirectory:
    """A copy of the run and of its capture."""
    shutil.copytree(finished.path, tmp_path / "run")
    shutil.copytree(tiny_capture, tmp_path / "capture")
    directory = RunDirectory(tmp_path / "run")
    document = directory.read_run()
    document["capture"]["path"] = str(tmp_path / "capture")
    directory.write_run(document)
    return directory


def set_exposures(directory: RunDirectory, exposures: PhotographExposures) -> None:
    path = directory.stage("reflectance") / "model.json"
    write_json(path, {**read_json(path), "exposures": exposures.as_document()})


def darken(split: Path) -> None:
    """Multiplies the photographs of a split by `FACTORS`."""
    for path in split.glob("*.png"):
        pixels = np.asarray(Image.open(path)).astype(np.float32) / 255
        changed = pixels.copy()
        changed[..., :3] = linear_to_srgb(srgb_to_linear(pixels[..., :3]) * np.array(FACTORS))
        Image.fromarray(np.round(255 * changed).astype(np.uint8)).save(path)


def object_db(directory: RunDirectory, split: str) -> float:
    plugins = PluginManager.discover()
    result = evaluate_run(directory, EvaluationRequest(split=split, options=CHEAP, views=2), plugins)
    return float(result["psnr"]["object"])


def test_other_views_are_compared_at_exposures_of_their_own_where_they_were_fitted(own: RunDirectory) -> None:
    plugins = PluginManager.discover()
    set_exposures(own, PhotographExposures("fitted", {"no such view": (1.0, 1.0, 1.0)}))
    darken(own.path.parent / "capture" / "test")  # what was clipped in the photographs is no longer left out
    before = evaluate_run(own, EvaluationRequest(options=CHEAP, views=2), plugins)
    darken(own.path.parent / "capture" / "test")
    after = evaluate_run(own, EvaluationRequest(options=CHEAP, views=2), plugins)
    assert after["exposures"] == "fitted to each view"
    assert after["psnr"]["object"] > before["psnr"]["object"] - 1
    for one, other in zip(before["views"], after["views"], strict=True):
        np.testing.assert_allclose(np.array(other["exposure"]) / one["exposure"], FACTORS, rtol=0.03)
    assert own.read_run()["metrics"]["test"]["exposures"] == "fitted to each view"


def test_training_views_are_compared_at_the_exposures_of_the_fit(own: RunDirectory) -> None:
    before = object_db(own, "train")
    darken(own.path.parent / "capture" / "train")
    plugins = PluginManager.discover()
    run = open_finished_run(own)
    names = [view.name for view in run.views_of_split(run.capture_path, "train", plugins).views]
    set_exposures(own, PhotographExposures("fitted", dict.fromkeys(names, FACTORS)))
    assert object_db(own, "train") > before - 1
    views = open_finished_run(own).views_of_split(run.capture_path, "train", plugins).views
    np.testing.assert_allclose([view.gain for view in views], [FACTORS] * len(views), rtol=1e-6)


def test_without_fitted_exposures_views_are_compared_as_they_are(own: RunDirectory) -> None:
    result = evaluate_run(own, EvaluationRequest(options=CHEAP, views=1), PluginManager.discover())
    assert result["exposures"] is None and "exposure" not in result["views"][0]
