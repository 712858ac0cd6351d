"""What `check_capture` finds in captures that were spoilt on purpose."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import gaussian_filter

from hir_core.capture import Camera, Capture, Pixels
from hir_core.intake.capture_check import check_capture
from hir_core.intake.check_result import CaptureCheck
from hir_core.intake.contact_sheet import contact_sheet
from hir_core.intake.light_motion import headlight_score
from hir_core.intake.mask_sources import with_automatic_masks
from hir_core.intake.view_directions import directions_covered
from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.interfaces import MaskSource
from hir_core.plugins.manager import PluginManager
from hir_plugins.readers.transforms_json import TransformsJsonReader
from tests.fixtures.silhouette_captures import StoredPixels, coverage, dome, hits_sphere, make_view

SAMPLE = Path(__file__).resolve().parents[3] / "examples" / "sample_capture"


@pytest.fixture(scope="module")
def sample() -> Capture:
    capture = TransformsJsonReader(NoOptions()).read(SAMPLE)
    return replace(capture, views=tuple(replace(v, read=StoredPixels(v.read())) for v in capture.views))


def spoilt(capture: Capture, index: int, **changes: object) -> CaptureCheck:
    views = list(capture.views)
    views[index] = replace(views[index], read=StoredPixels(replace(views[index].read(), **changes)))  # type: ignore[arg-type]
    return check_capture(replace(capture, views=tuple(views)))


def test_a_good_capture_gets_no_blame(sample: Capture) -> None:
    check = check_capture(sample)
    # its highlights are clipped indeed
    assert [a for a in check.advice if "clipped" not in a] == [] and check.duplicates == ()
    # the hull is coarse, 1/56 of the object, and tolerates one mask in ten: 0.84 to 0.91 here
    assert all(v.agreement is not None and v.agreement > 0.8 for v in check.views)
    assert all((v.width, v.height) == (256, 256) for v in check.views)
    # the upper hemisphere
    assert check.directions_covered is not None and 0.4 < check.directions_covered < 0.75


def test_a_wrong_mask_is_named(sample: Capture) -> None:
    mask = sample.views[5].read().mask
    assert mask is not None
    check = spoilt(sample, 5, mask=np.roll(mask, 40, axis=1))
    worst = min(check.views, key=lambda v: v.agreement or 0)
    assert worst.name == sample.views[5].name and any(worst.name in a and "mask" in a for a in check.advice)


def test_wrong_axes_are_reported(sample: Capture) -> None:
    views = []
    for view in sample.views:
        assert view.camera is not None
        # someone forgot to turn the camera's axes
        turned = replace(view.camera, world_to_camera=np.diag([1.0, -1, 1, 1]) @ view.camera.world_to_camera)
        views.append(replace(view, camera=turned))
    assert any("do not agree" in a for a in check_capture(replace(sample, views=tuple(views))).advice)


def test_blur_duplicates_and_clipping(sample: Capture) -> None:
    sample = replace(sample, views=sample.views[:8])
    pixels = sample.views[3].read()
    blurred = np.stack([gaussian_filter(pixels.color_linear[..., i], 3) for i in range(3)], axis=-1)
    assert any("blurred" in a and sample.views[3].name in a for a in spoilt(sample, 3, color_linear=blurred).advice)
    assert any("clipped" in a for a in spoilt(sample, 3, saturated=pixels.mask > 0.9).advice)  # type: ignore[operator]
    twice = replace(sample, views=(*sample.views, replace(sample.views[0], name="copy")))
    assert check_capture(twice).duplicates == ((sample.views[0].name, "copy"),)


def test_a_capture_without_cameras_or_masks(sample: Capture) -> None:
    views = tuple(replace(v, camera=None, read=StoredPixels(replace(v.read(), mask=None))) for v in sample.views)
    check = check_capture(replace(sample, views=views))
    assert check.with_camera == 0 and check.directions_covered is None
    assert all(v.agreement is None and v.mask_share is None for v in check.views)
    assert check_capture(replace(sample, views=())).views == ()


def lit_ball(cameras: list[Camera], headlight: bool) -> list[Pixels]:
    """A matt ball under a sun that stands still over white sky, or under a lamp at the camera."""
    sun = np.array([0.5, 0.8, 0.3]) / np.linalg.norm([0.5, 0.8, 0.3])
    pictures = []
    for camera in cameras:
        rows, columns = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
        origins, directions = camera.rays(np.stack([columns, rows], axis=-1).reshape(-1, 2))
        along = -(origins * directions).sum(axis=1)
        depth = along - np.sqrt(np.maximum(0.25 - (origins**2).sum(axis=1) + along**2, 0))
        normal = (origins + depth[:, None] * directions) / 0.5
        lamp = camera.center - 0.5 * normal
        toward = lamp / np.linalg.norm(lamp, axis=1, keepdims=True) if headlight else sun[None]
        shade = 0.5 * np.clip((normal * toward).sum(axis=1), 0, 1) + (0.0 if headlight else 0.1)
        color = np.repeat(shade.reshape(camera.height, camera.width, 1), 3, axis=2).astype(np.float32)
        mask = coverage(camera, hits_sphere(np.zeros(3), 0.5), samples=2)
        pictures.append(make_view("x", camera, mask, color).read())
    return pictures


def test_a_light_at_the_camera_is_distinguished_from_the_sun() -> None:
    cameras = dome(16, 3.0, np.zeros(3), 160.0, 64)
    normals = np.random.default_rng(0).normal(size=(3000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    carried = headlight_score(lit_ball(cameras, True), cameras, 0.5 * normals, normals)
    standing = headlight_score(lit_ball(cameras, False), cameras, 0.5 * normals, normals)
    assert carried is not None and standing is not None
    assert carried > 0.75 and standing < 0.1
    assert headlight_score(lit_ball(cameras[:2], True), cameras[:2], 0.5 * normals, normals) is None


def test_the_light_is_followed_in_one_take(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shading of two takes differs though both lights stand still."""
    cameras = dome(16, 3.0, np.zeros(3), 160.0, 64)
    pictures = lit_ball(cameras, False)
    views = [
        replace(make_view("x", c, np.ones((64, 64), np.float32)), read=StoredPixels(p), take="ab"[i < 6])
        for i, (c, p) in enumerate(zip(cameras, pictures, strict=True))
    ]
    used: list[int] = []
    score = "hir_core.intake.capture_check.headlight_score"
    monkeypatch.setattr(score, lambda pixels, cameras, *surface: used.append(len(cameras)))
    check = check_capture(Capture(Path("made"), tuple(views)), (np.zeros((1, 3)), np.ones((1, 3))))
    assert used == [10], "the take of most photographs"
    assert [(take.name, take.photographs) for take in check.takes] == [("b", 6), ("a", 10)]
    assert [view.take for view in check.views] == [view.take for view in views]
    assert check_capture(Capture(Path("made"), tuple(replace(v, take="") for v in views))).takes == ()


def test_coverage_of_directions() -> None:
    cameras = dome(60, 3.0, np.zeros(3), 100.0, 32)
    assert directions_covered(cameras) == pytest.approx(1.0, abs=0.02)
    # one cap of 30° is (1 - cos 30°) / 2 of the sphere
    near = [cameras[0], replace(cameras[0], intrinsics=cameras[0].intrinsics + 0.0)]
    assert directions_covered(near) == pytest.approx((1 - np.cos(np.radians(30))) / 2, abs=0.003)


def test_the_contact_sheet_shows_all(sample: Capture) -> None:
    sheet = contact_sheet(sample, columns=6, side=64)
    assert sheet.shape == (4 * 64, 6 * 64, 3) and sheet.dtype == np.uint8
    for i in range(24):
        assert np.ptp(sheet[(i // 6) * 64 : (i // 6) * 64 + 64, (i % 6) * 64 : (i % 6) * 64 + 64]) > 60


def test_a_fired_flash_is_a_light_on_the_camera(sample: Capture, tmp_path: Path) -> None:
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x9209] = 1
    Image.new("RGB", (8, 8)).save(tmp_path / "flash.jpg", exif=exif)
    flashed = replace(sample, views=tuple(replace(view, path=tmp_path / "flash.jpg") for view in sample.views[:4]))
    assert any("the flash fired" in sentence for sentence in check_capture(flashed).advice)
    assert not any(
        "flash fired" in sentence for sentence in check_capture(replace(sample, views=sample.views[:4])).advice
    )


def test_small_or_empty_photographs_give_no_score(sample: Capture) -> None:
    """Without sharpness, hull or directions the results are None, not problems."""
    few = check_capture(replace(sample, views=sample.views[:2]))
    assert all(view.agreement is None for view in few.views)
    empty = [
        replace(v, read=StoredPixels(replace(v.read(), mask=np.zeros_like(v.read().color_linear[..., 0]))))
        for v in sample.views
    ]
    found = check_capture(replace(sample, views=tuple(empty)))
    assert all(view.mask_share == 0 for view in found.views)
    assert any("masks of 24 photographs are empty, such as 003" in sentence for sentence in found.advice)
    tiny = [replace(v, read=StoredPixels(v.read().downsampled(64)), camera=None) for v in sample.views]
    assert all(np.isfinite(v.sharpness) for v in check_capture(replace(sample, views=tuple(tiny))).views)
    pixels, cameras = [v.read() for v in sample.views], list(sample.cameras)
    assert headlight_score(pixels, cameras, np.zeros((10, 3)), np.ones((10, 3))) is None, "ten points are too few"


class Ones(MaskSource):
    def __init__(self, config: NoOptions) -> None:
        del config

    def masks(self, capture: Capture, scene: object) -> list[np.ndarray | None]:
        return [None if i == 1 else np.ones((256, 256), np.float32) for i in range(len(capture.views))]


def test_masks_that_need_no_camera_are_found_for_views_without(sample: Capture) -> None:
    """What a run would do first; views that have a mask keep it."""

    plugins = PluginManager()
    for traits in ({"automatic", "needs_cameras"}, {"automatic"}):
        name = "_".join(sorted(traits))

        class Plugin:
            @hookimpl
            def hir_register_mask_sources(self, name: str = name, traits: set[str] = traits) -> list[Component]:
                return [Component(name, f"{__name__}:Ones", NoOptions, "Everything.", traits=frozenset(traits))]

        plugins.register(Plugin(), name, "")
    bare = [replace(v, read=StoredPixels(replace(v.read(), mask=None))) for v in sample.views[:3]]
    found = with_automatic_masks(replace(sample, views=(*bare, sample.views[3])), plugins)
    assert found.views[0].pixels().mask is not None and found.views[1].pixels().mask is None
    np.testing.assert_array_equal(found.views[3].pixels().mask, sample.views[3].pixels().mask)
    assert with_automatic_masks(sample, plugins) is sample
