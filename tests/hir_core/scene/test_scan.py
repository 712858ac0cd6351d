"""The scan of a run: kept with its texture, and given to no stage after the initializers."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from hir_core.errors import InputError
from hir_core.scene.scan import DOCUMENT, TEXTURE, Scan, load_scan, save_scan

CODES = np.random.default_rng(0).integers(0, 256, (5, 3, 3)).astype(np.uint8)


def test_a_scan_comes_back(tmp_path: Path) -> None:
    save_scan(None, tmp_path)
    assert load_scan(tmp_path) is None and not any(tmp_path.iterdir())
    save_scan(Scan("a scan.obj"), tmp_path)
    plain = load_scan(tmp_path)
    assert plain is not None and plain.file == "a scan.obj" and plain.texture is None
    save_scan(Scan("b.glb", CODES), tmp_path)
    textured = load_scan(tmp_path)
    assert textured is not None and textured.file == "b.glb" and textured.texture is not None
    np.testing.assert_array_equal(textured.texture, CODES)


def test_damaged_files_are_one_sentence(tmp_path: Path) -> None:
    save_scan(Scan("b.glb", CODES), tmp_path)
    (tmp_path / TEXTURE).write_bytes((tmp_path / TEXTURE).read_bytes()[:40])
    with pytest.raises(InputError, match=TEXTURE):
        load_scan(tmp_path)
    (tmp_path / DOCUMENT).write_text('{"file": 3}')
    with pytest.raises(InputError, match="does not name a file"):
        load_scan(tmp_path)


def test_a_link_in_place_of_the_texture_is_refused(tmp_path: Path) -> None:
    save_scan(Scan("b.glb", CODES), tmp_path / "stage")
    (tmp_path / "stage" / TEXTURE).rename(tmp_path / "outside.png")
    (tmp_path / "stage" / TEXTURE).symlink_to(tmp_path / "outside.png")
    with pytest.raises(InputError, match="leads out of"):
        load_scan(tmp_path / "stage")


def test_later_stages_are_given_its_name_alone(tmp_path: Path) -> None:
    """The state that all stages share has no place for a texture: what the initializer stage adds to it is a name."""
    from hir_core.capture import Capture, CoordinateFrames
    from hir_core.capture.pixel_cache import PixelCache
    from hir_core.config import RunConfig
    from hir_core.plugins.manager import PluginManager
    from hir_core.run.run_directory import RunDirectory
    from hir_core.scene import Scene
    from hir_core.stages.initialization import InitializedCapture
    from hir_core.stages.run_state import CaptureSource, RunState
    from hir_core.stages.stage_list import INITIALIZER
    from tests.fixtures.scenes import square

    capture = Capture(tmp_path, ())
    state = RunState(
        RunConfig(),
        PluginManager.discover(),
        RunDirectory(tmp_path / "run"),
        "cpu",
        CaptureSource(tmp_path, "x", "", ()),
        PixelCache(0),
        capture,
    )
    scene, frames = Scene(square()), CoordinateFrames(np.eye(4), np.eye(4))
    extended = [
        INITIALIZER.extend(state, InitializedCapture(capture, scene, frames, scan))
        for scan in (None, Scan("b.glb"), Scan("b.glb", CODES))
    ]
    assert [found.scan_file for found in extended] == ["", "b.glb", "b.glb"]
    for field in fields(RunState):
        one, other = (getattr(found, field.name) for found in extended[1:])
        assert one is other or one == other, field.name
