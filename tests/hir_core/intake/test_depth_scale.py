"""The common factor of measured depths: biased, noisy, hollow, and where masks do not determine it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hir_core.capture import Capture, DepthPixels, MeasuredDepth, View
from hir_core.intake.depth_scale import MAX_ERROR, MIN_RAYS, PRIOR_ERROR, depth_scale, with_depth_scale
from hir_core.intake.outline_rays import outline_rays
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.testing.captures import StoredPixels
from tests.fixtures.made_captures import around, bowl
from tests.fixtures.scenes import icosphere, looking_at

SIZE, VIEWS, SAMPLES = 96, 12, 3
MESHES = {"ball": lambda: icosphere(4), "bowl": bowl}


@cache
def cast(name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """Mask with antialiased outline, and true depth along the optical axis, of each view."""
    mesh = MESHES[name]()
    queries = MeshQueries(mesh.positions.numpy(), mesh.faces.numpy())
    x, y = np.meshgrid((np.arange(SIZE * SAMPLES) + 0.5) / SAMPLES, (np.arange(SIZE * SAMPLES) + 0.5) / SAMPLES)
    found = []
    for eye in around(VIEWS, 0.9):
        camera = looking_at(eye, SIZE, SIZE)
        origins, directions = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
        distance = queries.first_distances(origins, directions)
        hit = np.isfinite(distance)
        depth = (np.where(hit, distance, 0) * (directions @ camera.world_to_camera[2, :3])).reshape(x.shape)
        mask = hit.reshape(SIZE, SAMPLES, SIZE, SAMPLES).mean(axis=(1, 3))
        found.append((mask.astype(np.float32), depth[1::SAMPLES, 1::SAMPLES].astype(np.float32)))
    return found


def views_of(name: str, factor: float = 1.0, noise: float = 0.0) -> tuple[View, ...]:
    """Views whose depths are `factor` times the true ones, with independent errors of a share of the distance."""
    random, found = np.random.default_rng(0), []
    for number, (eye, (mask, depth)) in enumerate(zip(around(VIEWS, 0.9), cast(name), strict=True)):
        measured = (depth * factor * (1 + noise * random.normal(size=depth.shape))).astype(np.float32)
        pixels = DepthPixels(measured, (depth > 0).astype(np.float32))
        color = np.full((SIZE, SIZE, 3), 0.5, np.float32)
        source = MeasuredDepth(lambda found=pixels: found)  # type: ignore[misc]
        found.append(View(str(number), looking_at(eye, SIZE, SIZE), StoredPixels(color, mask), depth=source))
    return tuple(found)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("longer", [0.0, 0.01, -0.01, 0.03])
def test_masks_determine_the_common_factor(name: str, longer: float) -> None:
    """Of a convex object and of a hollow one, whose hull the depths contradict by ten times as much."""
    found = depth_scale(views_of(name, 1 + longer))
    assert found.standard_error is not None and found.standard_error < 0.002 and found.rays > 300
    assert abs(found.factor * (1 + longer) - 1) < found.standard_error
    if longer:
        assert f"measured depths are {abs(1 / found.factor - 1):.2%} {'longer' if longer > 0 else 'shorter'}" in (
            found.sentence
        )
        assert "they are corrected" in found.sentence
    else:
        assert found.sentence == ""


@pytest.mark.parametrize("name", MESHES)
def test_noise_of_one_percent_does_not_hide_the_factor(name: str) -> None:
    found = depth_scale(views_of(name, 1.01, noise=0.01))
    assert found.standard_error is not None and 0.001 < found.standard_error < 0.003
    assert abs(found.factor * 1.01 - 1) < 2 * found.standard_error


def test_the_seed_draws_the_rays() -> None:
    found = [depth_scale(views_of("bowl", 1.01, 0.01), seed).factor for seed in (0, 0, 1)]
    assert found[0] == found[1] != found[2] and abs(found[2] - found[0]) < 0.003


def test_an_uncertain_factor_is_nearer_to_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mean of prior and measurement, weighted by their inverse variances."""
    views = views_of("ball", 1.02)
    monkeypatch.setattr("hir_core.intake.depth_scale._standard_error", lambda *_: 1e-9)
    measured = depth_scale(views).factor
    monkeypatch.setattr("hir_core.intake.depth_scale._standard_error", lambda *_: MAX_ERROR)
    found = depth_scale(views)
    variances = PRIOR_ERROR**2, MAX_ERROR**2
    assert found.factor - 1 == pytest.approx((measured - 1) * variances[0] / sum(variances), rel=1e-6)
    assert found.standard_error == pytest.approx((1 / variances[0] + 1 / variances[1]) ** -0.5)


def without_masks(view: View) -> View:
    return replace(view, read=StoredPixels(view.pixels().color_linear, None))


def with_mask(view: View, value: float) -> View:
    return replace(view, mask=np.full((SIZE, SIZE), value, np.float32))


def test_what_masks_do_not_determine_stays_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    views = views_of("ball", 1.01)
    reasons = {
        "only 3 photographs have a mask and depths": views[:3],
        "only 0 photographs have a mask and depths": tuple(without_masks(view) for view in views),
        "only 0 rays of outlines meet a measured surface within 10% of their depth": views_of("ball", 1.5),
        "only 0 rays of outlines meet": tuple(with_mask(view, 0.0) for view in views),
        "only 0 rays of": tuple(with_mask(view, 1.0) for view in views),
        "a difference of +8.0% is more than a sensor's error": views_of("ball", 1.08),
    }
    for reason, given in reasons.items():
        found = depth_scale(given)
        assert found.factor == 1 and reason in found.sentence and "is not checked" in found.sentence
        assert with_depth_scale(Capture(Path("ball"), given))[0].views == given
    few = depth_scale(views[:5])
    assert few.factor == 1 and few.rays < MIN_RAYS and f"only {few.rays} rays" in few.sentence
    monkeypatch.setattr("hir_core.intake.depth_scale._standard_error", lambda *_: 0.0123)
    unsure = depth_scale(views)
    assert (unsure.factor, unsure.standard_error) == (1, 0.0123) and "masks determine them to 1.2% only" in (
        unsure.sentence
    )


def test_all_depths_of_a_capture_are_multiplied() -> None:
    views = views_of("ball", 1.02)
    given = Capture(Path("ball"), (*views, replace(views[0], name="without", depth=None)))
    corrected, scale = with_depth_scale(given)
    assert scale is not None
    for before, after in zip(given.views[:-1], corrected.views, strict=False):
        old, new = before.measured_depth(), after.measured_depth()
        assert old is not None and new is not None
        np.testing.assert_allclose(new[1].depth, old[1].depth * scale.factor, rtol=1e-6)
    assert corrected.views[-1] is given.views[-1]
    none = Capture(Path("ball"), tuple(replace(view, depth=None) for view in views))
    assert with_depth_scale(none) == (none, None)


def test_a_moved_and_scaled_world_has_the_same_factor() -> None:
    views = views_of("bowl", 0.99)
    transform = np.diag([7.0, 7.0, 7.0, 1.0])
    transform[:3, 3] = 0.5, -1.0, 2.0
    moved = Capture(Path("bowl"), views).transformed(transform)
    assert depth_scale(moved.views).factor == pytest.approx(depth_scale(views).factor, abs=1e-5)


def test_rays_of_an_outline_are_tangent_to_a_ball() -> None:
    """Its radius is their distance from the centre, and the point of contact the normal."""
    mask, _ = cast("ball")[3]
    camera = replace(looking_at(around(VIEWS, 0.9)[3], SIZE, SIZE))
    rays = outline_rays(camera, mask, 80, np.random.default_rng(0))
    assert rays.directions.shape == (80, 3)
    contact = rays.origins - (rays.origins * rays.directions).sum(axis=1, keepdims=True) * rays.directions
    pixel = 4 / camera.intrinsics[0, 0]
    np.testing.assert_allclose(np.linalg.norm(contact, axis=1), 1, atol=0.25 * pixel)
    assert (rays.normals * contact).sum(axis=1).min() > 0.99
    np.testing.assert_allclose((rays.normals * rays.directions).sum(axis=1), 0, atol=1e-9)


def test_the_frame_is_no_outline() -> None:
    """Of an object that the frame cuts at all sides nothing is left, and of a half one no ray lies at the frame."""
    camera = looking_at((0.0, 0.0, 4.0), SIZE, SIZE)
    full = np.ones((SIZE, SIZE), np.float32)
    assert len(outline_rays(camera, full, 80, np.random.default_rng(0)).origins) == 0
    half = full.copy()
    half[:, SIZE // 2 :] = 0
    rays = outline_rays(camera, half, 80, np.random.default_rng(0))
    pixels, _ = camera.project(rays.origins + rays.directions)
    np.testing.assert_allclose(pixels[:, 0], SIZE / 2, atol=1e-6)
    np.testing.assert_allclose(rays.normals @ camera.world_to_camera[0, :3], 1, atol=0.01)
