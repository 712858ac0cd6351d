"""A run of two takes under two lights: its files, its evaluation, its pictures."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.textures.image_files import read_hdr, read_ldr, write_png

from hir_core.errors import InputError
from hir_core.evaluation import EvaluationRequest, evaluate_run
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.report.run_pictures import render_pictures
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory
from hir_core.scene import EnvironmentMap, Mesh, Scene, Topology
from hir_core.scene.scene_store import load_stage_scene, load_take_radiance, save_stage_scene
from tests.fixtures.command_line import hir

TAKES = "day", "evening"
FACTORS = np.array([0.5, 0.3, 0.2])
"""Of the light of the second take beside that of the first."""
CHEAP = {"render_samples": 16}


def in_takes(source: Path, folder: Path, split: str) -> None:
    """Every second photograph of a split in the evening."""
    path = folder / f"transforms_{split}.json"
    document = json.loads((source / path.name).read_text())
    for i, frame in enumerate(document["frames"]):
        frame["take"] = TAKES[i % 2]
        if i % 2:
            file = folder / Path(frame["file_path"]).with_suffix(".png")
            picture = read_ldr(file)
            picture[..., :3] = linear_to_srgb(srgb_to_linear(picture[..., :3]) * FACTORS)
            write_png(file, picture.astype(np.float32))
    path.write_text(json.dumps(document))


@pytest.fixture(scope="module")
def capture(tiny_capture: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("captures") / "takes"
    shutil.copytree(tiny_capture, folder)
    for split in ("train", "test"):
        in_takes(tiny_capture, folder, split)
    return folder


@pytest.fixture(scope="module")
def run(capture: Path, tmp_path_factory: pytest.TempPathFactory, quick: Callable[..., Run]) -> RunDirectory:
    made = quick(capture, tmp_path_factory.mktemp("runs") / "takes", "reflectance_renderer.transport_ggx.steps=60")
    return RunDirectory(made.path)


@pytest.mark.slow
def test_each_take_has_its_light_in_the_files_of_the_run(run: RunDirectory) -> None:
    report = run.read_run()["stages"]["reflectance"]["report"]
    assert report["takes"] == list(TAKES)
    scene = open_finished_run(run).scene
    assert list(scene.take_radiance) == list(TAKES) and scene.environment is not None
    day, evening = (scene.take_radiance[take].mean(dim=(0, 1)).numpy() for take in TAKES)
    np.testing.assert_allclose(evening / day, FACTORS, rtol=0.25)
    torch.testing.assert_close(scene.environment.radiance, scene.take_radiance["day"], rtol=1e-3, atol=1e-5)


@pytest.mark.slow
def test_views_are_evaluated_under_the_light_of_their_take(run: RunDirectory, capture: Path) -> None:
    plugins = PluginManager.discover()
    found = evaluate_run(run, EvaluationRequest(options=CHEAP), plugins)
    values = [view["psnr"]["object"] for view in found["views"]]
    assert len(values) == 2 and min(values) > 18
    document = json.loads((capture / "transforms_test.json").read_text())
    exchanged = {**document, "frames": [{**f, "take": TAKES[1 - i % 2]} for i, f in enumerate(document["frames"])]}
    (capture / "transforms_test.json").write_text(json.dumps(exchanged))
    try:
        wrong = evaluate_run(run, EvaluationRequest(options=CHEAP), plugins)
        assert max(view["psnr"]["object"] for view in wrong["views"]) < min(values) - 3
        for frame in exchanged["frames"]:
            frame["take"] = "night"
        (capture / "transforms_test.json").write_text(json.dumps(exchanged))
        with pytest.raises(InputError, match=r"the take 'night' is unknown.*'day', 'evening'"):
            evaluate_run(run, EvaluationRequest(options=CHEAP), plugins)
    finally:
        (capture / "transforms_test.json").write_text(json.dumps(document))


@pytest.mark.slow
def test_a_run_without_the_lights_of_its_takes_is_refused(run: RunDirectory, tmp_path: Path) -> None:
    """The light of the first take, which the asset has, would be wrong for the others."""
    shutil.copytree(run.path, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "stages" / run.stage("reflectance").name / "scene")
    with pytest.raises(InputError, match="lacks the light of the take 'day'; finish the run again with --resume"):
        open_finished_run(RunDirectory(tmp_path / "run"))


def test_another_light_replaces_those_of_all_takes(run: RunDirectory) -> None:
    found = evaluate_run(run, EvaluationRequest(split="relight_0", options=CHEAP), PluginManager.discover())
    assert found["light"]["fitted"] is False and np.isfinite(found["psnr"]["object"])


def test_pictures_show_each_photograph_under_its_light(run: RunDirectory, capture: Path, tmp_path: Path) -> None:
    plugins = PluginManager.discover()
    names = [Path(f["file_path"]).stem for f in json.loads((capture / "transforms_train.json").read_text())["frames"]]
    shown = [read_ldr(p) for p in render_pictures(run, plugins, tmp_path, names[:2], options=CHEAP)]
    for name, picture in zip(names[:2], shown, strict=True):
        photograph = read_ldr(capture / "train" / f"{name}.png")
        inside = (photograph[..., 3] > 0.99) & (picture[..., 3] > 0.99)
        ratio = srgb_to_linear(picture[inside][:, :3]).mean(axis=0) / srgb_to_linear(photograph[inside][:, :3]).mean(
            axis=0
        )
        np.testing.assert_allclose(ratio, 1, atol=0.2)
    assert len(list(run.report.glob("light_take_*.png"))) == 2
    assert "Light of take 2" in (run.path / "report.html").read_text(encoding="utf-8")


def test_an_export_has_the_light_of_the_chosen_take(
    run: RunDirectory, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lights = load_take_radiance(run.stage("reflectance") / "scene")
    files = {}
    for name, arguments in {"first": [], "day": ["--take", "day"], "evening": ["--take", "evening"]}.items():
        arguments = [*arguments, "-f", "glb", "-f", "hdr", "--no-verify", "-q", "-o", tmp_path / name]
        assert hir("export", run.path, *arguments) == 0
        (files[name],) = (tmp_path / name).glob("*.hdr")
    mean = {name: read_hdr(file).mean(axis=(0, 1)) for name, file in files.items()}
    np.testing.assert_allclose(mean["first"], lights["day"].mean(dim=(0, 1)), rtol=0.03)
    np.testing.assert_allclose(mean["day"], mean["first"], rtol=1e-3)
    np.testing.assert_allclose(mean["evening"], lights["evening"].mean(dim=(0, 1)), rtol=0.03)
    capsys.readouterr()
    assert hir("export", run.path, "--take", "night", "-f", "hdr", "-o", tmp_path / "none") == 2
    assert "has no take 'night'; its takes are 'day', 'evening'" in capsys.readouterr().err
    assert hir("export", run.path / "scene", "--take", "day", "-f", "hdr", "-o", tmp_path / "none") == 2
    assert "is no run, so it has no takes; remove --take" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()


def test_the_lights_of_a_stage_come_back(tmp_path: Path) -> None:
    faces = torch.tensor([[0, 1, 2]])
    lights = {"day": torch.rand(4, 8, 3), "evening / ☾": torch.rand(4, 8, 3)}
    scene = Scene(Mesh(torch.rand(3, 3), Topology(faces)), None, EnvironmentMap(lights["day"]), lights)
    save_stage_scene(scene, tmp_path / "two")
    for found in (load_stage_scene(tmp_path / "two").take_radiance, load_take_radiance(tmp_path / "two")):
        assert list(found) == list(lights) and all(torch.equal(found[name], lights[name]) for name in lights)
    save_stage_scene(replace(scene, take_radiance={}), tmp_path / "one")
    assert load_take_radiance(tmp_path / "one") == {} == load_take_radiance(tmp_path / "none")
    (tmp_path / "two" / "take_1.radiance.exr").unlink()
    with pytest.raises(InputError, match="not a complete scene"):
        load_take_radiance(tmp_path / "two")


def test_a_scene_under_the_light_of_a_take() -> None:
    faces = torch.tensor([[0, 1, 2]])
    lights = {"day": torch.ones(4, 8, 3), "evening": torch.zeros(4, 8, 3)}
    scene = Scene(Mesh(torch.rand(3, 3), Topology(faces)), None, EnvironmentMap(lights["day"]), lights)
    lit = scene.in_take("evening")
    assert lit.environment is not None and torch.equal(lit.environment.radiance, lights["evening"])
    assert lit.in_take("anything") is lit
    assert list(scene.to("cpu").take_radiance) == list(lights)
    with pytest.raises(InputError, match="the take '' is unknown"):
        scene.in_take("")
    one = replace(scene, take_radiance={"day": lights["day"]})
    assert one.in_take("").environment is not None
    with pytest.raises(InputError, match="the take 'evening' is unknown"):
        one.in_take("evening")
