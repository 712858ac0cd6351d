"""The asset under another light, beside a texture of the photographs' colours."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters.textures.image_files import read_ldr, write_png

from hir_core.errors import HirError
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.report import embedded_pictures, refresh_page
from hir_core.report.relit_pictures import AFTER, BEFORE, relit_pictures, turned
from hir_core.run.finished_run import open_finished_run
from hir_core.run.run_directory import RunDirectory
from hir_core.scene import EnvironmentMap

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


def test_a_report_shows_both(finished: Run) -> None:
    directory = RunDirectory(finished.path)
    before, after = (read_ldr(directory.report / f"{name}.png") for name in (BEFORE, AFTER))
    assert before.shape == after.shape and np.isfinite(before).all()
    shown = after[..., :3].max(axis=2) > 0.05
    assert 0.02 < shown.mean() < 0.9, "an object before black"
    difference = np.abs(before[..., :3] - after[..., :3])[shown].mean()
    assert difference > 0.005, "the texture of photographs is not the fitted material"
    page = (directory.path / "report.html").read_text(encoding="utf-8")
    assert "Under another light" in page and 'class="texture relit_material"' in page


def test_a_run_without_an_atlas_or_pictures_shows_none(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    directory, plugins = RunDirectory(tmp_path / "run"), PluginManager.discover()
    shutil.rmtree(directory.stage("atlas"))
    run = open_finished_run(directory)
    camera = run.views_of_split(run.capture_path, "train", plugins).cameras[0]
    assert relit_pictures(run, camera, plugins) == {}
    (directory.report / f"{AFTER}.png").unlink()
    assert embedded_pictures.relit(directory) == ""
    refresh_page(directory, plugins)
    assert "Under another light" not in (directory.path / "report.html").read_text(encoding="utf-8")


def test_a_link_in_place_of_a_picture_is_refused(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    directory = RunDirectory(tmp_path / "run")
    write_png(tmp_path / "secret.png", np.ones((2, 2, 3), np.float32))
    picture = directory.report / f"{BEFORE}.png"
    picture.unlink()
    picture.symlink_to(tmp_path / "secret.png")
    with pytest.raises(HirError):
        embedded_pictures.relit(directory)
