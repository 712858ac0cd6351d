"""Reflections look like a surface behind the mirror: stereo must not carve towards it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Array, Capture
from hir_core.scene import Scene
from hir_plugins.initializers.hull.visual_hull import VisualHull
from hir_plugins.initializers.options import StereoOptions, VisualHullOptions
from hir_plugins.initializers.plugin import hir_suggest_initializers
from hir_plugins.initializers.stereo import stereo as stereo_module
from hir_plugins.initializers.stereo.stereo import Stereo
from hir_plugins.initializers.stereo.stereo_photographs import directions_from, evenly_distributed_views
from hir_plugins.initializers.stereo.surface_sweep import SweptView
from hir_plugins.initializers.stereo.view_independence import ViewIndependence, view_independence
from hir_plugins.initializers.surface.swept_surface import SweptSurface
from hir_plugins.initializers.surface.volume import Volume
from tests.fixtures.silhouette_captures import dome, make_view
from tests.hir_plugins.initializers.test_stereo import rays_of

SIDE = 128
QUICK = StereoOptions(max_image_size=SIDE, vertex_colors=False, max_resolution=72)


def surroundings(directions: Array) -> Array:
    """A smooth random picture of the surroundings; brightness of each direction."""
    rng = np.random.default_rng(3)
    waves, phases = rng.normal(scale=5, size=(24, 3)), rng.uniform(0, 2 * np.pi, 24)
    return np.clip(0.4 + 0.05 * np.cos(directions @ waves.T + phases).sum(axis=1), 0.02, 0.95)


def ball(mirror: bool) -> Capture:
    """A ball of radius 0.8 that reflects its surroundings as a mirror, or that is painted with their picture."""
    views = []
    for i, camera in enumerate(dome(40, 3.0, np.zeros(3), 200.0, SIDE)):
        origins, directions = rays_of(camera)
        along = -(origins * directions).sum(axis=1)
        discriminant = along**2 - (origins**2).sum(axis=1) + 0.8**2
        hit = discriminant > 0
        points = origins + directions * (along - np.sqrt(np.maximum(discriminant, 0)))[:, None]
        normals = points / 0.8
        seen = directions - 2 * (directions * normals).sum(axis=1, keepdims=True) * normals if mirror else normals
        value = np.where(hit, surroundings(seen), 0)
        color = np.repeat(value.reshape(SIDE, SIDE, 1), 3, axis=2).astype(np.float32)
        views.append(make_view(f"{i}", camera, hit.reshape(SIDE, SIDE).astype(np.float32), color))
    return Capture(Path("made-in-memory"), tuple(views))


def swept_view(capture: Capture, index: int) -> SweptView:
    """A photograph at whose pixels both surfaces lie at a depth of 2.5."""
    view = capture.views[index]
    pixels = view.pixels()
    assert view.camera is not None and pixels.mask is not None
    inside = torch.from_numpy(pixels.mask > 0.5)
    depth = torch.where(inside, 0.4, 0.0)
    return SweptView(view.camera, torch.from_numpy(pixels.color_linear[..., 0]), inside, inside, depth, depth)


def hull_of(capture: Capture) -> Scene:
    hull = VisualHull(VisualHullOptions(max_resolution=72, vertex_colors=False))
    _, scene = hull.initialize(capture, None, Path("unused"))
    assert scene is not None
    return scene


def farthest_from(hull: Scene, scene: Scene) -> float:
    shell = SweptSurface(hull.mesh.positions.double().numpy(), hull.mesh.faces.numpy())
    return float(np.quantile(np.abs(shell.signed_distance(scene.mesh.positions.double().numpy())), 0.99))


@pytest.mark.slow
def test_a_mirror_is_not_carved(monkeypatch: pytest.MonkeyPatch) -> None:
    capture = ball(mirror=True)
    hull = hull_of(capture)
    stereo = Stereo(QUICK)
    _, scene = stereo.initialize(capture, hull, Path("unused"))
    assert scene is not None
    report = stereo.report()
    assert report["explained_share"] < 0.4 and report["confirmed_share"] == 0
    assert scene is hull and report["surface"] == "unchanged: no carving is confirmed"
    # without the comparison of distant photographs the reflections are taken for a surface
    everything = lambda whole, *rest: ViewIndependence(np.ones(whole.values.shape, np.float32), None)  # noqa: E731
    monkeypatch.setattr(stereo_module, "view_independence", everything)
    _, carved = Stereo(QUICK).initialize(capture, hull, Path("unused"))
    assert carved is not None and farthest_from(hull, carved) > 0.05


@pytest.mark.slow
def test_a_painted_ball_stays_a_ball() -> None:
    capture = ball(mirror=False)
    hull = hull_of(capture)
    _, scene = Stereo(QUICK).initialize(capture, hull, Path("unused"))
    assert scene is not None and farthest_from(hull, scene) < 0.016  # a pixel is 3 / 200 = 0.015


def test_evenly_distributed_views_cover_all_directions() -> None:
    cameras = dome(200, 3.0, np.zeros(3), 200.0, SIDE)
    chosen = evenly_distributed_views(cameras, np.zeros(3), 48)
    assert len(chosen) == 48 and chosen == sorted(set(chosen))
    toward = directions_from(cameras, np.zeros(3))
    nearest = (toward @ toward[chosen].T).max(axis=1)
    # 48 caps of 20° would have 1.45 times the area of the sphere; the sets that are added greedily need 25°
    assert np.degrees(np.arccos(nearest.min())) < 25
    assert evenly_distributed_views(cameras[:30], np.zeros(3), 48) == list(range(30))


def test_stereo_is_suggested_where_photographs_can_be_matched() -> None:
    capture = ball(mirror=False)
    assert hir_suggest_initializers(capture) == ["camera_refinement", "visual_hull", "hollows", "stereo"]
    few = Capture(capture.path, capture.views[:15])
    assert hir_suggest_initializers(few) == ["camera_refinement", "visual_hull"]
    thirty = Capture(capture.path, tuple(replace(v, take=f"{i % 2}") for i, v in enumerate(capture.views[:30])))
    assert hir_suggest_initializers(thirty) == ["camera_refinement", "visual_hull"]
    more = Capture(capture.path, tuple(replace(v, take=f"{i % 2}") for i, v in enumerate(capture.views[:32])))
    assert hir_suggest_initializers(more) == ["camera_refinement", "visual_hull", "hollows", "stereo"]


def test_photographs_that_are_near_each_other_cannot_tell_and_say_so() -> None:
    capture = ball(mirror=True)
    toward = directions_from(capture.cameras, np.zeros(3))
    near = [i for i in range(len(toward)) if toward[i] @ toward[0] > np.cos(np.radians(17))]
    values = np.full((12, 12, 12), 1.0, np.float32)
    whole, carved = Volume(values, np.full(3, -0.6), 0.1), Volume(values.copy(), np.full(3, -0.6), 0.1)
    carved.values[4:8] = -1
    views = [swept_view(capture, i) for i in near]
    with pytest.warns(UserWarning, match="35° to 60° apart"):
        found = view_independence(whole, carved, views, [0.01] * len(views), np.zeros(3))
    assert found.explained is None and (found.share == 1).all()
    # one that is 47° away is compared, unless it is of another take
    distant = int(np.argmin(np.abs(toward @ toward[0] - np.cos(np.radians(47)))))
    views, takes = [*views, swept_view(capture, distant)], [0] * len(near) + [1]
    assert view_independence(whole, carved, views, [0.01] * len(views), np.zeros(3)).explained == 0
    with pytest.warns(UserWarning, match="no two photographs of one take are 35° to 60° apart"):
        found = view_independence(whole, carved, views, [0.01] * len(views), np.zeros(3), takes)
    assert found.explained is None and (found.share == 1).all()


def test_a_carving_that_no_two_photographs_show_is_not_kept() -> None:
    capture = ball(mirror=True)
    values = np.full((12, 12, 12), 1.0, np.float32)
    whole, carved = Volume(values, np.full(3, -0.6), 0.1), Volume(values.copy(), np.full(3, -0.6), 0.1)
    carved.values[4:8] = -1
    views = [swept_view(capture, i) for i in range(len(capture.views))]  # both surfaces are the same: nothing to see
    found = view_independence(whole, carved, views, [0.01] * len(views), np.zeros(3))
    assert found.explained == 0 and (found.share == 0).all()
