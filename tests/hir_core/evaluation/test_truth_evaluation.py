"""Figures against the truth, through a run's frames: what is put there by hand comes back as no error at all."""

from __future__ import annotations

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import write_png

from hir_core.cli import main
from hir_core.errors import HirError, InputError
from hir_core.evaluation import EvaluationRequest, evaluate_run
from hir_core.evaluation.truth_evaluation import light_figures, surface_figures
from hir_core.metrics import composite, psnr, unassociate
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.light_files import load_light
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory
from hir_core.scene.asset_conversion import scene_from_asset

CHEAP = {"render_samples": 8}


@pytest.fixture(scope="module")
def plugins() -> PluginManager:
    return PluginManager.discover()


@pytest.fixture
def known(finished: Run, tiny_capture: Path, plugins: PluginManager, tmp_path: Path) -> RunDirectory:
    """A copy of the run and of its capture, whose true mesh and albedo are the run's own."""
    shutil.copytree(finished.path, tmp_path / "run")
    shutil.copytree(tiny_capture, tmp_path / "capture")
    directory = RunDirectory(tmp_path / "run")
    document = directory.read_run()
    document["capture"]["path"] = str(tmp_path / "capture")
    directory.write_run(document)
    run = open_finished_run(directory)
    source_from_working = np.linalg.inv(run.frames.working_from_source)
    positions = run.scene.mesh.positions.numpy() @ source_from_working[:3, :3].T + source_from_working[:3, 3]
    trimesh.Trimesh(positions, run.scene.mesh.faces.numpy(), process=False).export(
        tmp_path / "capture" / "reference.obj"
    )
    test = json.loads((tmp_path / "capture" / "transforms_test.json").read_text())
    views = run.read_split(tmp_path / "capture", "test", plugins)
    for frame, camera in zip(test["frames"], views.cameras, strict=True):
        color, coverage = unassociate(UnlitRenderer(run.scene).render(camera))
        frame["file_path"] = frame["file_path"].replace("test/", "albedo_test/")
        name = tmp_path / "capture" / Path(frame["file_path"]).with_suffix(".png")
        name.parent.mkdir(exist_ok=True)
        write_png(name, np.concatenate([linear_to_srgb(color), coverage[..., None]], axis=2).astype(np.float32))
    del test["environment"]
    (tmp_path / "capture" / "transforms_albedo_test.json").write_text(json.dumps(test))
    return directory


def test_a_run_is_its_own_truth(known: RunDirectory, plugins: PluginManager) -> None:
    result = evaluate_run(known, EvaluationRequest(truth=True, options=CHEAP, views=1), plugins)
    assert len(result["views"]) == 1
    assert result["surface"]["chamfer"] < 1e-5 and result["surface"]["seen"]["f_score"]["0.005"] == 1.0
    # 8 bits of sRGB: an error of at most half a step, mostly less
    assert result["albedo"]["psnr"] > 20 * np.log10(2 * 255)
    np.testing.assert_allclose(result["albedo"]["scale"], 1.0, atol=0.01)
    assert result["light_error"]["spheres"]["diffuse"] > 0.0, "the quick run did not find the true light"
    kept = known.read_run()["metrics"]["test"]
    assert {"surface", "albedo", "light_error", "flip", "iou", "stanford_orb"} <= set(kept)


def test_the_true_light_is_no_error_and_a_turned_one_is(known: RunDirectory, plugins: PluginManager) -> None:
    run = open_finished_run(known)
    path = run.capture_path
    capture = run.read_split(path, "train", plugins)
    assert capture.environment is not None
    truth = load_light(capture.environment, capture.world_from_source)
    found = light_figures(replace(run, scene=run.with_light(truth)), path, capture, plugins)
    assert found is not None and found["texels"] < 1e-9 and found["scale"] == pytest.approx(1.0)
    turned = replace(truth, radiance=truth.radiance.roll(truth.radiance.shape[1] // 4, dims=1))
    wrong = light_figures(replace(run, scene=run.with_light(turned)), path, capture, plugins)
    assert wrong is not None and wrong["spheres"]["diffuse"] > 0.05
    carried = replace(truth, frame="camera")
    assert light_figures(replace(run, scene=run.with_light(carried)), path, capture, plugins) is None


def test_a_file_that_is_no_mesh_is_named(known: RunDirectory, plugins: PluginManager, tmp_path: Path) -> None:
    run = open_finished_run(known)
    capture = run.read_split(run.capture_path, "test", plugins)
    (tmp_path / "points.obj").write_text("v 0 0 0\n")
    with pytest.raises(InputError, match=r"points\.obj"):
        surface_figures(run, tmp_path / "points.obj", capture)
    with pytest.raises(InputError, match="no such file"):
        surface_figures(run, tmp_path / "gone.obj", capture)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"mesh": Path("gone.obj")}, "gone.obj: no such file"), ({"albedo": "gone"}, "no split 'gone'")],
)
def test_a_wrong_truth_is_refused_before_views_are_rendered(
    known: RunDirectory, plugins: PluginManager, wrong: dict[str, Any], message: str
) -> None:
    rendered: list[int] = []
    request = EvaluationRequest(options=CHEAP, views=1, **wrong)
    with pytest.raises(HirError, match=re.escape(message)):
        evaluate_run(known, request, plugins, lambda done, count, text: rendered.append(done))
    assert rendered == []


def test_command_compares_runs(known: RunDirectory, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [
        "evaluate",
        str(known.path),
        str(known.path),
        "--mesh",
        str(known.path.parent / "capture" / "reference.obj"),
    ]
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--views", "1", "--set", "render_samples=8", "-q"])
    printed = capsys.readouterr().out
    assert stop.value.code == 0 and printed.count("run  ") >= 2 and "Chamfer" in printed


@pytest.mark.parametrize("split", ["relight_0", "relight_1"])
def test_a_light_file_lights_the_true_object_as_cycles_did(shared: Path, plugins: PluginManager, split: str) -> None:
    """The axes of a capture's light: the true mesh and material under it are the photograph, a turned light is not."""
    from hir_exporters.reading.material_overrides import MaterialOverrides
    from hir_exporters.reading.mesh_import import load_mesh_asset

    from hir_core.intake.reader_lookup import read_capture
    from hir_core.scene.frames import move_scene

    capture = read_capture(shared / "captures" / "spot", split, plugins)
    maps = MaterialOverrides(shared / "models" / "spot" / "spot_texture.png", roughness=0.3, metallic=0.0)
    asset = load_mesh_asset(shared / "captures" / "spot" / "reference.obj", maps)
    scene = move_scene(scene_from_asset(asset), capture.world_from_source)
    assert capture.environment is not None
    light = load_light(capture.environment, capture.world_from_source)
    view = capture.views[2].pixels().downsampled(4)
    truth = composite(view.color_linear, view.mask)
    _, renderer = reference_renderer(plugins, "", {"render_samples": 64, "max_depth": 4})

    def error(turn_deg: float) -> float:
        spun = trimesh.transformations.rotation_matrix(np.radians(turn_deg), [0, 1, 0])[:3, :3]
        to_world = light.to_world.new_tensor(spun) @ light.to_world
        lit = replace(scene, environment=replace(light, to_world=to_world))
        image = render_view(renderer, lit, capture.cameras[2].downsampled(4), "relit")
        found = psnr(composite(*unassociate(image)), truth, view.mask > 0.5)
        assert found is not None
        return found

    right = error(0)
    assert right > 30, "noise, our separable G and a pixel's filter are what is left"
    assert all(right > error(turn) + 6 for turn in (90, 180, 270))
