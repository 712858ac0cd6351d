"""The benchmark of two takes: its captures are those of an object that was turned over in a room."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import two_takes
from benchmarks.materials.materials import MATERIALS
from benchmarks.materials.recipes import recipes
from benchmarks.materials.render import mitsuba_mesh, render_view
from benchmarks.materials.shapes import make_shape
from benchmarks.two_takes import TAKES, TURNED_OVER, from_above, make_captures, table
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.manager import PluginManager

RECIPE = next(each for each in recipes() if each.name.startswith("42_block_matt"))


@pytest.mark.slow
def test_a_turned_over_light_is_that_of_the_room_in_the_axes_of_the_object() -> None:
    """The object upside down in the room, and the room upside down around the object: the same photograph."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    shape = make_shape("block", 40)
    surface = MATERIALS["matt"].draw(shape.positions.astype(np.float64), shape.parts, np.random.default_rng(0))
    turn = TURNED_OVER[:3, :3].astype(np.float32)
    turned = replace(shape, positions=shape.positions @ turn, normals=shape.normals @ turn)
    room = np.random.default_rng(1).uniform(0.05, 1, (8, 16, 3)).astype(np.float32) ** 3
    room = room.repeat(8, axis=0).repeat(8, axis=1)
    pose = from_above(3, 8)
    one = render_view(mi, mitsuba_mesh(mi, turned, surface), surface, room, False, 0.0, pose, 32, 2048, 1)
    around = room[::-1, ::-1].copy()
    other = render_view(
        mi, mitsuba_mesh(mi, shape, surface), surface, around, False, 0.0, TURNED_OVER @ pose, 32, 2048, 2
    )
    unturned = render_view(
        mi, mitsuba_mesh(mi, shape, surface), surface, room, False, 0.0, TURNED_OVER @ pose, 32, 2048, 2
    )
    np.testing.assert_allclose(one[..., 3], other[..., 3], atol=0.15)
    inside = (one[..., 3] > 0.99) & (other[..., 3] > 0.99)
    difference, wrong = (np.abs(image - one)[inside][:, :3].mean() for image in (other, unturned))
    assert difference < 0.04 * one[inside][:, :3].mean() and wrong > 3 * difference


@pytest.mark.slow
def test_captures_of_two_takes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    for name, value in (("SAMPLES", 2), ("TESTED", 1), ("RELIT", 2)):
        monkeypatch.setattr(two_takes, name, value)
    make_captures(RECIPE, tmp_path, side=48, photographs=6)
    plugins = PluginManager.discover()
    one, two = (read_capture(tmp_path / name, "train", plugins) for name in ("one", "two"))
    assert one.takes == ("",) and two.takes == TAKES and len(one.views) == len(two.views) == 6
    corners = np.array(
        [
            line.split()[1:]
            for line in (tmp_path / "two" / "reference.obj").read_text().splitlines()
            if line.startswith("v ")
        ],
        float,
    )
    for capture in (one, two):
        corners_in_world = corners @ capture.world_from_source[:3, :3].T + capture.world_from_source[:3, 3]
        for view, camera in zip(capture.views, capture.cameras, strict=True):
            pixel, _ = camera.project(corners_in_world)
            mask = view.pixels().mask
            assert mask is not None
            rows, columns = np.nonzero(mask > 0.5)
            np.testing.assert_allclose(pixel.min(axis=0), [columns.min(), rows.min()], atol=1.5)
            np.testing.assert_allclose(pixel.max(axis=0), [columns.max() + 1, rows.max() + 1], atol=1.5)
            assert (camera.center[1] > 0) == (view.take != TAKES[1])
    for split in ("test", *two_takes.RELIGHTS):
        assert read_capture(tmp_path / "two", split, plugins).views
    assert json.loads((tmp_path / "two" / "transforms_test.json").read_text())["frames"][0]["take"] == TAKES[0]


def test_the_table_has_means_of_the_gain() -> None:
    def part(gain: float) -> dict[str, object]:
        relit = {light: {"frame": 30 + gain, "object": 25 + gain} for light in two_takes.RELIGHTS}
        unseen = {"frame": 35.0, "object": 30.0}
        shares = {"complete": 0.9, "underside": 0.5 + gain / 10}
        return {"unseen": unseen, "relit_scaled": relit, "base_color_scaled": 20.0} | shares

    rows: list[dict[str, Any]] = []
    for name, gain in (("a", 1.0), ("b", 3.0)):
        row: dict[str, Any] = {"recipe": name, "texture": "coarse", "seed": 0, "side": 192, "photographs": 40}
        rows += [row | {"run": "one"} | part(0), row | {"run": "two"} | part(gain)]
        if name == "a":
            rows.append(row | {"run": "estimated"} | part(0.5))
    many = {"recipe": "a", "texture": "coarse", "seed": 0, "side": 192, "photographs": 80}
    rows.append(many | {"run": "one"} | part(0))
    lines = table(rows).splitlines()
    assert (
        "30.0 → 31.0 (30.5)" in lines[2] and "| +2.00 ± 1.41 |" in lines[-1] and "0.500 → 0.600 (0.550) |" in lines[2]
    )
    assert all(line.endswith(" – → – |") for line in lines[2:5]), "rows without the share on the hull have a dash"
    assert "| 80 | 0 |" in lines[3] and "30.0 → – |" in lines[3] and len(lines) == 6


def test_points_in_a_hole_are_deep_in_the_convex_hull() -> None:
    """Of a cube of radius 1: faces are on the hull, a point in a hole lies 0.9 inside, one above the cube outside."""
    cube = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    points = np.array([(1.0, 0.3, 0.2), (0.1, 0.0, 0.0), (0.5, -0.7, 0.2), (0.0, 0.0, 1.5)])
    found = two_takes.depth_in_hull(points, np.concatenate([cube, 0.1 * cube]))
    np.testing.assert_allclose(found, [0.0, 0.9, 0.3, -0.5], atol=1e-9)


def test_dots_darken_a_part_of_the_base_colour() -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (4000, 3))
    surface = MATERIALS["matt"].draw(points, np.zeros(4000, np.int64), np.random.default_rng(0))
    share = two_takes.with_dots(surface, points, 3, 8.0).base_color / surface.base_color
    assert set(np.unique(share.round(6))) == {0.3, 1.0} and 0.1 < (share < 0.5).mean() < 0.6
