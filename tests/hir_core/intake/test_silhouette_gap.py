"""The gap between masks and the hull of others, as `hir check` measures it, against the initializer's own measure."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hir_core.capture import Camera, Capture
from hir_core.intake.capture_advice import MAX_MASK_GAP, advice_on_cameras
from hir_core.intake.capture_check import check_capture
from hir_core.intake.check_result import GAP_SIDE_PIXELS
from hir_core.intake.mask_agreement import mask_agreement
from hir_core.intake.silhouette_gap import MIN_VIEWS, silhouette_gap
from hir_core.plugins import NoOptions
from hir_plugins.initializers.options import CameraRefinementOptions
from hir_plugins.initializers.refinement import camera_refinement
from hir_plugins.initializers.refinement.silhouette_agreement import silhouette_agreement
from hir_plugins.initializers.surface.silhouette_fields import silhouette_fields
from hir_plugins.readers.transforms_json import TransformsJsonReader
from tests.fixtures.command_line import hir
from tests.fixtures.silhouette_captures import StoredPixels, dome, shape_capture
from tests.hir_plugins.initializers.test_camera_refinement import moved, shape, with_cameras

SAMPLE = Path(__file__).resolve().parents[3] / "examples" / "sample_capture"
BOX = np.full(3, -1.0), np.full(3, 1.0)


@pytest.fixture(scope="module")
def bars() -> Capture:
    return shape_capture(dome(16, 3.0, np.zeros(3), 150.0, 96), shape)


def all_moved(capture: Capture, size: float) -> Capture:
    rng = np.random.default_rng(7)
    return with_cameras(capture, [moved(c, rng, size) for c in capture.cameras])


def gap_of(capture: Capture) -> float:
    masks = [view.pixels().mask for view in capture.views]
    gap = silhouette_gap([(c, m) for c, m in zip(capture.cameras, masks, strict=True) if m is not None], *BOX)
    assert gap is not None
    return gap


def test_right_cameras_leave_nothing_beside_the_hull(bars: Capture) -> None:
    assert gap_of(bars) < 0.05


@pytest.mark.parametrize("size", [0.008, 0.02])
def test_the_gap_is_that_of_the_initializer(bars: Capture, size: float) -> None:
    """Measured on rays to points at four depths, not as an area: within a third."""
    wrong = all_moved(bars, size)
    exact = float(np.median(silhouette_agreement(silhouette_fields(wrong.views)).gap))
    assert gap_of(wrong) == pytest.approx(exact, rel=0.33) and exact > 0.3


def test_limits_are_those_of_the_initializer() -> None:
    assert CameraRefinementOptions().max_gap == MAX_MASK_GAP
    assert (camera_refinement.MIN_VIEWS, camera_refinement.MASK_SIDE) == (MIN_VIEWS, GAP_SIDE_PIXELS)


def test_few_masks_have_no_gap(bars: Capture) -> None:
    masks = [view.pixels().mask for view in bars.views]
    assert mask_agreement(bars.cameras[:11], masks[:11]).gap is None
    assert mask_agreement(bars.cameras[:12], masks[:12]).gap is not None


def test_a_wrong_mask_is_no_error_of_the_cameras(bars: Capture) -> None:
    masks = [view.pixels().mask for view in bars.views]
    assert masks[5] is not None
    masks[5] = np.roll(masks[5], 20, axis=1)
    found = mask_agreement(bars.cameras, masks)
    assert found.gap is not None and found.gap < 0.1
    assert min((score, i) for i, score in enumerate(found.iou) if score is not None)[1] == 5


def test_the_gap_of_a_check_is_in_pixels_of_a_fixed_size(bars: Capture) -> None:
    """That of photographs of four times the size is larger by as much as their masks remain larger."""
    wrong = all_moved(bars, 0.008)
    enlarged_views = []
    for view in wrong.views:
        pixels, camera = view.read(), view.camera
        assert pixels.mask is not None and camera is not None
        large = replace(
            pixels,
            color_linear=pixels.color_linear.repeat(4, 0).repeat(4, 1),
            mask=pixels.mask.repeat(4, 0).repeat(4, 1),
            saturated=pixels.saturated.repeat(4, 0).repeat(4, 1),
        )
        intrinsics = np.diag([4, 4, 1.0]) @ camera.intrinsics
        enlarged = Camera(intrinsics, camera.world_to_camera, 4 * camera.width, 4 * camera.height)
        enlarged_views.append(replace(view, camera=enlarged, read=StoredPixels(large)))
    small, large_gap = (
        check_capture(replace(wrong, views=tuple(views))).mask_gap for views in (wrong.views, enlarged_views)
    )
    # neither 96 nor 384 pixels are reduced for the unit; 384 are for the comparison
    assert small is not None and large_gap == pytest.approx(small * 384 / 96, rel=0.2)


def test_hir_check_announces_that_cameras_are_refined(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json.loads((SAMPLE / "transforms_train.json").read_text())
    capture = TransformsJsonReader(NoOptions()).read(SAMPLE)
    rng = np.random.default_rng(7)
    for frame, camera in zip(document["frames"], capture.cameras, strict=True):
        turn = moved(camera, rng, 0.006).world_to_camera @ np.linalg.inv(camera.world_to_camera)
        flip = np.diag([1.0, -1, -1, 1])
        frame["transform_matrix"] = (np.array(frame["transform_matrix"]) @ flip @ np.linalg.inv(turn) @ flip).tolist()
    shutil.copytree(SAMPLE / "train", tmp_path / "train")
    del document["environment"]
    (tmp_path / "transforms_train.json").write_text(json.dumps(document))
    for folder, said in ((SAMPLE, False), (tmp_path, True)):
        assert hir("check", folder, "-q") == 0
        printed = " ".join(capsys.readouterr().out.split())
        assert ("the given cameras seem a little wrong" in printed) is said
        assert ("hir reconstruct refines them (camera_refinement)" in printed) is said
        assert ('--set \'initializers=["visual_hull", "hollows", "stereo"]\' keeps them' in printed) is said


def test_without_an_initializer_that_refines_the_sentence_names_another_remedy(bars: Capture) -> None:
    check = check_capture(all_moved(bars, 0.03))
    assert "export them again" in advice_on_cameras(check, ["first_shape"], [])
    assert 'initializers=["first_shape"]' in advice_on_cameras(check, ["mender", "first_shape"], ["mender", "other"])
