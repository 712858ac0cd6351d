"""A whole run of a tiny capture: what it leaves, what it reuses, what it never looks at."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.scene_format import load_scene

from hir_core.errors import MissingExtraError
from hir_core.pipeline import Run
from hir_core.plugins import manager
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory
from tests.fixtures.runs import QUICK

Reconstruct = Callable[..., Run]


def files(folder: Path) -> dict[str, bytes]:
    """Every file below a folder."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_run_directory_is_that_of_the_design(finished: Run) -> None:
    names = {entry.name for entry in finished.path.iterdir()} - {".lock"}
    assert names == {
        "run.json",
        "timings.json",
        "log.txt",
        "capture",
        "stages",
        "scene",
        "exports",
        "report",
        "report.html",
    }
    stages = sorted(entry.name for entry in (finished.path / "stages").iterdir())
    assert stages == [f"{i + 1}-{name}" for i, name in enumerate(STAGE_NAMES)]
    exports = {path.suffix for path in finished.directory.exports.iterdir()}
    assert exports >= {".glb", ".usdz", ".usda", ".hdr", ".exr"}
    pictures = {path.name for path in finished.directory.report.glob("*.png")}
    assert pictures >= {"light.png", "albedo.png", "specular.png", "roughness.png"}
    assert sum(name.endswith("_difference.png") for name in pictures) == 4
    assert not [p for p in finished.path.rglob("*") if p.suffix in (".pkl", ".pt", ".pth", ".pickle")]


def test_run_json_holds_settings_and_timings_json_the_clock(finished: Run) -> None:
    document, timings = finished.directory.read_run(), finished.directory.read_timings()
    assert document["settings"]["geometry"]["triangles"] == 1500 and document["seed"] == 0
    assert set(document["stages"]) == set(STAGE_NAMES) == set(timings["stages"])
    assert document["versions"]["torch"] and any("visual_hull" in plugin for plugin in document["plugins"])
    text = json.dumps({name: value for name, value in document.items() if name != "settings"})
    assert "seconds" not in text and "started" not in text
    assert all(timings["stages"][name]["seconds"] >= 0 for name in STAGE_NAMES)
    assert timings["report"]["seconds"] > 0 and timings["report"]["processor_seconds"] > 0


def test_every_entry_is_documented(finished: Run) -> None:
    """docs/run_folder.md names each file of a run, and each key of run.json and timings.json."""
    page = (Path(__file__).parents[2] / "docs" / "run_folder.md").read_text()
    document, timings = finished.directory.read_run(), finished.directory.read_timings()
    names = {f"{entry.name}{'/' * entry.is_dir()}" for entry in finished.path.iterdir()} - {".lock", "capture/"}
    names |= set(document) | set(timings) | set(timings["machine"])
    names = names.union(*timings["stages"].values(), *document["stages"].values())
    assert {name for name in names if f"`{name}`" not in page} == set()


def test_cameras_and_asset_share_the_world(finished: Run, tiny_capture: Path) -> None:
    """The asset, projected by cameras.json, covers the photographs' masks."""
    from hir_exporters.textures.image_files import read_ldr

    from hir_core.run.capture_store import read_cameras

    asset = load_scene(finished.directory.scene)
    cameras = read_cameras(finished.directory.cameras)
    assert len(cameras) == 10
    for name, camera in cameras.items():
        pixels, depth = camera.project(asset.mesh.positions.astype(np.float64))
        assert (depth > 0).all()
        mask = read_ldr(tiny_capture / "train" / f"{Path(name).name}.png")[..., 3] > 0.5
        rows, columns = np.nonzero(mask)
        low, high = pixels.min(axis=0), pixels.max(axis=0)
        box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
        assert np.abs(np.concatenate([low, high]) - box).max() < 3.0, name


def test_asset_lies_where_the_files_have_the_object(finished: Run) -> None:
    """The capture's files put a unit-radius object at their origin: undoing the working frame restores that."""
    asset = load_scene(finished.directory.scene)
    radius = np.linalg.norm(asset.mesh.positions, axis=1).max()
    assert radius == pytest.approx(1.0, abs=0.04), "the true mesh has radius 1; a pixel of 64² is 0.04 wide"
    matrix = np.array(finished.directory.read_run()["stages"]["initializer"]["report"]["frames"]["asset_from_source"])
    np.testing.assert_allclose(matrix[:3, :3], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3], 0, atol=1e-12)


def test_fit_looks_at_nothing_but_the_train_split(
    tiny_capture: Path, finished: Run, quick: Reconstruct, tmp_path: Path
) -> None:
    """Without other views, lights, true mesh and the train split's own light entry: the same scene, byte for byte."""
    bare = tmp_path / "tiny"
    shutil.copytree(tiny_capture, bare)
    for gone in ("test", "relight_0"):
        shutil.rmtree(bare / gone)
        (bare / f"transforms_{gone}.json").unlink()
    for gone in [*bare.glob("*.hdr"), bare / "reference.obj"]:
        gone.unlink()
    document = json.loads((bare / "transforms_train.json").read_text())
    assert document.pop("environment")
    (bare / "transforms_train.json").write_text(json.dumps(document))
    again = quick(bare, tmp_path / "run", deterministic=True)
    assert files(again.directory.scene) == files(finished.directory.scene)


def test_finished_run_is_reused_whole_and_a_setting_redoes_what_depends_on_it(
    finished: Run, tiny_capture: Path, quick: Reconstruct, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(finished.path, folder)
    before = files(folder / "scene")
    again = quick(tiny_capture, folder, resume=True, deterministic=True)
    assert again.reused == STAGE_NAMES and files(folder / "scene") == before
    said: list[str] = []
    changed = quick(tiny_capture, folder, "export=['obj']", resume=True, deterministic=True, on_message=said.append)
    assert changed.reused == STAGE_NAMES[:-1]
    assert {path.suffix for path in changed.directory.exports.iterdir()} <= {".obj", ".mtl", ".png"}
    assert sum("reused" in sentence for sentence in said) == len(STAGE_NAMES) - 1


@pytest.mark.slow
def test_until_leaves_a_run_that_goes_on(tiny_capture: Path, quick: Reconstruct, finished: Run, tmp_path: Path) -> None:
    begun = quick(tiny_capture, tmp_path / "run", until="initializer", deterministic=True)
    # the cameras are there for other programs already
    assert begun.directory.cameras.read_bytes() == finished.directory.cameras.read_bytes()
    first = quick(tiny_capture, tmp_path / "run", until="atlas", resume=True, deterministic=True)
    assert not first.directory.scene.exists()
    rest = quick(tiny_capture, tmp_path / "run", resume=True, deterministic=True)
    assert rest.reused == ("initializer", "geometry", "atlas")
    assert files(rest.directory.scene) == files(finished.directory.scene), "stored scenes lose no bit"


def test_a_format_without_its_library_is_refused_before_the_first_stage(
    tiny_capture: Path, quick: Reconstruct, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(manager, "is_installed", lambda name: name != "pxr")
    with pytest.raises(MissingExtraError, match=r"exporter 'usdz' \(from hir\) needs pxr; .* 'hir\[usd\]'$"):
        quick(tiny_capture, tmp_path / "run", 'export=["glb", "usdz"]')
    assert not (tmp_path / "run").exists()
    run = quick(tiny_capture, tmp_path / "run", 'export=["glb", "usdz"]', until="initializer")
    assert run.path.is_dir(), "a run that stops before needs no exporter"


def test_evaluate_says_what_it_compared(finished: Run, tiny_capture: Path, tmp_path: Path) -> None:
    from hir_core.evaluation import EvaluationRequest, evaluate_run
    from hir_core.plugins.manager import PluginManager

    folder = tmp_path / "run"
    shutil.copytree(finished.path, folder)
    plugins = PluginManager.discover()
    result = evaluate_run(RunDirectory(folder), EvaluationRequest(), plugins)
    assert result["light"] == {"fitted": True}, "the test split names the light of train by another file"
    assert len(result["views"]) == 2 and result["psnr"]["object"] > 12
    assert result["psnr"]["frame"] == pytest.approx(np.mean([v["psnr"]["frame"] for v in result["views"]]))
    assert (result["lpips"] is None) == bool(result["lpips_missing"])
    assert set(result) >= {"psnr", "psnr_scaled", "scale", "ssim", "lpips", "views"} and len(result["scale"]) == 3
    relit = evaluate_run(RunDirectory(folder), EvaluationRequest(split="relight_0"), plugins)
    assert relit["light"]["file"] == "env_relight_0.hdr"
    assert relit["psnr_scaled"]["object"] >= relit["psnr"]["object"] - 1.0
    assert set(RunDirectory(folder).read_run()["metrics"]) == {"test", "relight_0"}
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "http://" not in page.replace("http://www.w3.org", "") and "https://" not in page, "needs nothing beside it"


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_interrupt_leaves_a_run_that_goes_on(tiny_capture: Path, tmp_path: Path) -> None:
    settings = [word for assignment in QUICK for word in ("--set", assignment)]
    words = [
        sys.executable,
        "-m",
        "hir_core.cli",
        "reconstruct",
        str(tiny_capture),
        "-o",
        str(tmp_path / "run"),
        *settings,
    ]
    slow = [*words, "--set", "geometry.iterations=100000", "--device", "cpu"]
    with subprocess.Popen(slow, stderr=subprocess.PIPE, text=True) as process:
        started = time.monotonic()
        while not (tmp_path / "run" / "stages" / "2-geometry" / "stage.json").exists():
            # bounds for a hang, not for speed: other tests may have the processors
            assert process.poll() is None and time.monotonic() - started < 600
            time.sleep(0.1)
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=120) == 130
        assert process.stderr is not None
        assert "--resume" in process.stderr.read()
    run = RunDirectory(tmp_path / "run")
    first, second = run.record("initializer"), run.record("geometry")
    assert first is not None and first.finished and second is not None and not second.finished
    done = subprocess.run([*words, "--resume", "--until", "geometry"], capture_output=True, text=True, check=True)
    assert "initializer: reused" in done.stderr and "geometry: computed again" in done.stderr
