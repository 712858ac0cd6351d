"""Metres from a scale bar and from GPS."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hir_core.capture import Array, View
from hir_core.capture.exif import gps_position
from hir_core.errors import CaptureError
from hir_plugins.initializers.sfm.metric_scale import read_marks, scale_of_bar, scale_of_gps
from tests.fixtures.silhouette_captures import look_at, make_view

ENDS = np.array([[-0.2, 0.1, 0.3], [0.3, -0.1, 0.1]])
LENGTH = float(np.linalg.norm(ENDS[0] - ENDS[1]))


def views_around(count: int, radius: float = 2.5) -> list[View]:
    angles = np.linspace(0, 1.5, count)
    positions = [radius * np.array([np.sin(t), 0.3, np.cos(t)]) for t in angles]
    cameras = [look_at(p, np.zeros(3), 300.0, 320, 240) for p in positions]
    return [make_view(f"photo {i}.jpg", c, np.ones((240, 320), np.float32)) for i, c in enumerate(cameras)]


def marks_file(folder: Path, views: list[View]) -> Path:
    lines = ["# photograph end x y"]
    for view in views:
        assert view.camera is not None
        for end, (x, y) in zip("ab", view.camera.project(ENDS)[0], strict=True):
            lines.append(f"{view.name} {end} {x:.4f} {y:.4f}")
    path = folder / "bar.txt"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_bar_tells_the_metres(tmp_path: Path) -> None:
    views = views_around(3)
    found = scale_of_bar(read_marks(marks_file(tmp_path, views)), 0.15, views)
    assert found.metres_per_unit == pytest.approx(0.15 / LENGTH, rel=1e-5)
    assert found.source == "scale bar of 0.15 m"


@pytest.mark.parametrize(
    "text,message",
    [
        ("photo 0.jpg c 1 2", "line 1"),
        ("\n\nphoto 0.jpg a one 2", "line 3"),
        ("photo 0.jpg a nan 2", "line 1"),
        ("photo 0.jpg", "line 1"),
    ],
)
def test_a_line_that_is_no_mark_is_named(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bar.txt"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(CaptureError, match=message):
        read_marks(path)


def test_marks_that_tell_nothing_are_refused(tmp_path: Path) -> None:
    views = views_around(3)
    marks = read_marks(marks_file(tmp_path, views))
    with pytest.raises(CaptureError, match="scale_bar_length"):
        scale_of_bar(marks, 0.0, views)
    with pytest.raises(CaptureError, match="marked in 1 photographs"):
        scale_of_bar([m for m in marks if m.end == "a" or m.view == "photo 0"], 0.15, views)
    with pytest.raises(CaptureError, match="same side"):
        same = [replace(views[0], name=f"photo {i}.jpg") for i in range(3)]
        scale_of_bar(read_marks(marks_file(tmp_path, same)), 0.15, same)
    with pytest.raises(CaptureError, match="cannot be read"):
        read_marks(tmp_path / "none.txt")


def with_gps(path: Path, metres: Array) -> None:
    """A photograph at a place east, north and above of a point near Zürich."""
    latitude = 47.0 + metres[1] / 111_178.0
    longitude = 8.5 + metres[0] / (111_320.0 * np.cos(np.radians(47.0)))
    exif = Image.Exif()
    table = exif.get_ifd(0x8825)
    for reference, key, value, letters in ((1, 2, latitude, "NS"), (3, 4, longitude, "EW")):
        degrees, rest = divmod(abs(value), 1)
        minutes, rest = divmod(rest * 60, 1)
        table[reference], table[key] = letters[int(value < 0)], (float(degrees), float(minutes), float(rest * 60))
    table[5], table[6] = b"\x00", float(400.0 + metres[2])
    Image.new("RGB", (8, 6)).save(path, exif=exif)


def photographed(folder: Path, metres_per_unit: float, noise: float) -> list[View]:
    rng = np.random.default_rng(3)
    views = []
    for i, view in enumerate(views_around(12)):
        assert view.camera is not None
        x, y, z = metres_per_unit * view.camera.center
        # east, north, up; the height of each differs, as a drone's does
        with_gps(folder / f"{i}.jpg", np.array([x, -z, y]) + rng.normal(scale=noise, size=3))
        views.append(replace(view, path=folder / f"{i}.jpg"))
    return views


def test_the_place_of_a_photograph_is_read(tmp_path: Path) -> None:
    with_gps(tmp_path / "a.jpg", np.array([0.0, 0.0, 12.0]))
    place = gps_position(tmp_path / "a.jpg")
    assert place is not None
    np.testing.assert_allclose(place, (47.0, 8.5, 412.0), atol=1e-6)
    Image.new("RGB", (8, 6)).save(tmp_path / "b.jpg")
    assert gps_position(tmp_path / "b.jpg") is None and gps_position(tmp_path / "none.jpg") is None


def test_gps_around_a_building_tells_the_metres(tmp_path: Path) -> None:
    found = scale_of_gps(photographed(tmp_path, 40.0, 1.0))
    assert (
        found is not None
        and found.metres_per_unit == pytest.approx(40.0, rel=0.03)
        and "12 photographs" in found.source
    )


def test_gps_around_a_table_tells_nothing(tmp_path: Path) -> None:
    assert scale_of_gps(photographed(tmp_path, 0.3, 3.0)) is None
    assert scale_of_gps(views_around(12)) is None
