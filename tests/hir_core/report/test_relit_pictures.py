"""The asset under another light, beside a texture of the photographs' colours."""

from __future__ import annotations

import shutil
from dataclasses import replace
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.textures.image_files import read_ldr, write_png

from hir_core.errors import HirError
from hir_core.evaluation import EvaluationRequest, evaluate_run
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.photographs import masked_photograph
from hir_core.report import embedded_pictures, refresh_page
from hir_core.report.relit_pictures import FILES, relit_pictures, turned
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory
from hir_core.scene import EnvironmentMap
from hir_core.scene.scan import Scan, save_scan
from hir_core.scene.scene_store import load_stage_scene, save_stage_scene

RADIANCE = torch.rand(4, 8, 3, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("frame", ["world", "camera"])
def test_three_turns_by_a_third_are_none(frame: str) -> None:
    upright = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
    light = EnvironmentMap(RADIANCE, upright if frame == "camera" else None, frame)  # type: ignore[arg-type]
    once = turned(light, 120)
    thrice = turned(turned(once, 120), 120)
    assert once.to_world is not None and thrice.to_world is not None and thrice.frame == frame
    torch.testing.assert_close(thrice.to_world, torch.eye(3) if light.to_world is None else upright, atol=1e-6, rtol=0)
    torch.testing.assert_close(once.to_world @ torch.tensor([0.0, 1.0, 0.0]), upright @ torch.tensor([0.0, 1.0, 0.0])
                               if frame == "camera" else torch.tensor([0.0, 1.0, 0.0]))  # fmt: skip
    assert once.radiance is light.radiance


def compared(directory: RunDirectory) -> dict[str, np.ndarray]:
    """The pictures of `relit_pictures` for the first view of a run at its own size, with the fit of its report."""
    plugins = PluginManager.discover()
    run = open_finished_run(directory)
    capture = run.views_of_split(run.capture_path, "train", plugins)
    photograph = masked_photograph(capture.views[0])
    fit = np.concatenate([photograph.color_linear * photograph.mask[..., None], photograph.mask[..., None]], axis=2)
    return relit_pictures(run, capture.cameras[0], photograph, fit, plugins)


@pytest.fixture
def scanned(finished: Run, tmp_path: Path) -> RunDirectory:
    """A run as if its surface had been a scan with a texture: reddish where u is small, greenish elsewhere."""
    shutil.copytree(finished.path, tmp_path / "run")
    directory = RunDirectory(tmp_path / "run")
    stage = directory.stage("initializer")
    atlas = load_stage_scene(directory.stage("atlas") / "scene")
    save_stage_scene(replace(atlas, material=None), stage / "scene")
    codes = np.full((64, 64, 3), 90, np.uint8)
    codes[:, :32, 0] = codes[:, 32:, 1] = 200
    save_scan(Scan("scan.obj", codes), stage)
    return directory


def test_every_picture_has_a_caption() -> None:
    assert {*embedded_pictures.COMPARED, *embedded_pictures.RELIT} == set(FILES)


def test_a_report_shows_both(finished: Run) -> None:
    directory = RunDirectory(finished.path)
    before, after, photograph, unlit = (
        read_ldr(directory.report / f"{name}.png")
        for name in ("relit_vertices", "relit_material", "compared_photograph", "compared_vertices")
    )
    assert before.shape == after.shape and np.isfinite(before).all()
    shown = after[..., :3].max(axis=2) > 0.05
    assert 0.02 < shown.mean() < 0.9, "an object before black"
    difference = np.abs(before[..., :3] - after[..., :3])[shown].mean()
    assert difference > 0.005, "the texture of photographs is not the fitted material"
    assert np.abs(photograph - unlit).mean() < 0.5 * np.abs(photograph).mean(), "the photographs' own colours"
    page = (directory.path / "report.html").read_text(encoding="utf-8")
    assert "Under another light" in page and 'class="texture relit_material"' in page
    assert "there was no scan with a texture" in page and "The photographs' colours at the vertices, relit" in unescape(
        page
    )
    assert 'class="texture relit_scan"' not in page


def test_a_textured_scan_is_shown_with_its_own_texture(scanned: RunDirectory) -> None:
    pictures = compared(scanned)
    assert set(pictures) == {
        "compared_photograph", "compared_scan", "compared_material", "relit_scan", "relit_material"
    }  # fmt: skip
    for name in ("compared_scan", "relit_scan"):
        picture = pictures[name]
        shown = picture.max(axis=2) > 0.1
        red, green = ((picture[..., i] > 1.3 * picture[..., 1 - i]) & shown for i in (0, 1))
        assert shown.mean() > 0.02 and (red | green)[shown].mean() > 0.85 and red.any() and green.any()
    target = pictures["compared_photograph"]
    linear = {name: srgb_to_linear(pictures[name]).sum() for name in ("compared_photograph", "compared_scan")}
    assert linear["compared_scan"] == pytest.approx(linear["compared_photograph"], rel=0.1), "of the same brightness"
    np.testing.assert_allclose(pictures["compared_material"], target, atol=1e-6)  # the fit that was given is the photo
    for path in scanned.report.glob("*_vertices.png"):
        path.unlink()
    for name, picture in pictures.items():
        write_png(scanned.report / f"{name}.png", picture)
    refresh_page(scanned, PluginManager.discover())
    page = unescape((scanned.path / "report.html").read_text(encoding="utf-8"))
    assert "the texture of its own file" in page and "The scan's own texture, relit" in page
    assert "colours at the vertices" not in page


def test_figures_of_the_texture_stand_beside_those_of_the_asset(scanned: RunDirectory) -> None:
    """The texture is lit where the light is another one, and as it is where the light is the fitted one."""
    plugins = PluginManager.discover()
    for split, lit in (("relight_0", True), ("test", False)):
        request = EvaluationRequest(split=split, views=1, options={"render_samples": 8})
        figures = evaluate_run(scanned, request, plugins)["scan_texture"]
        assert figures["lit"] is lit
        assert 3 < figures["psnr_scaled"]["object"] < figures["psnr_scaled"]["frame"] < 40
        recorded = scanned.read_run()["metrics"][split]
        assert recorded["scan_texture"] == figures
        assert recorded["psnr_scaled"]["object"] > figures["psnr_scaled"]["object"], "red and green are no fit"
        assert len(list(scanned.evaluation(split).glob("*_scan.png"))) == 1
    refresh_page(scanned, plugins)
    page = unescape((scanned.path / "report.html").read_text(encoding="utf-8"))
    assert "scan's texture, same light" in page and "scan's texture, without a light" in page


def test_a_run_without_an_atlas_or_pictures_shows_none(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    directory, plugins = RunDirectory(tmp_path / "run"), PluginManager.discover()
    shutil.rmtree(directory.stage("atlas"))
    assert compared(directory) == {}
    (directory.report / "relit_material.png").unlink()
    assert embedded_pictures.before_and_after(directory) is None
    refresh_page(directory, plugins)
    assert "Under another light" not in (directory.path / "report.html").read_text(encoding="utf-8")


def test_a_link_in_place_of_a_picture_is_refused(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    directory = RunDirectory(tmp_path / "run")
    write_png(tmp_path / "secret.png", np.ones((2, 2, 3), np.float32))
    picture = directory.report / "relit_vertices.png"
    picture.unlink()
    picture.symlink_to(tmp_path / "secret.png")
    with pytest.raises(HirError):
        embedded_pictures.before_and_after(directory)
