"""docs/conventions.md says what the code does: its examples run, and its words agree with a scene one can picture."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import latlong_directions

from hir_core.capture import Camera, EnvironmentSource

PAGE = Path(__file__).resolve().parents[2] / "docs" / "conventions.md"
BLOCKS = re.findall(r"^## (.+)\n(?:(?!## ).*\n)*?```python\n([\s\S]*?)```", PAGE.read_text(encoding="utf-8"), re.M)


def test_every_convention_that_can_be_run_has_an_example() -> None:
    assert [name for name, _ in BLOCKS] == [
        "World",
        "Cameras",
        "Images and colour",
        "Texture coordinates",
        "Reflectance",
        "Environment",
    ]


@pytest.mark.parametrize(("name", "code"), BLOCKS, ids=[name for name, _ in BLOCKS])
def test_example_runs(name: str, code: str) -> None:
    assert "assert" in code
    exec(compile(code, f"{PAGE.name}: {name}", "exec"), {"np": np})


def six_colours(height: int = 64) -> np.ndarray:
    """A lat-long map that is red towards +X, green towards +Y, blue towards +Z, and dark versions of them opposite."""
    directions = latlong_directions(height, 2 * height)
    axis = np.abs(directions).argmax(axis=-1)
    positive = np.take_along_axis(directions, axis[..., None], -1)[..., 0] > 0
    return (np.eye(3)[axis] * np.where(positive, 1.0, 0.25)[..., None]).astype(np.float32)


def look_up(radiance: np.ndarray, direction: np.ndarray) -> np.ndarray:
    from hir_exporters.conventions import direction_to_latlong_uv

    height, width = radiance.shape[:2]
    u, v = direction_to_latlong_uv(direction)
    return radiance[min(int(v * height), height - 1), int(u * width) % width]


def test_six_colour_map_has_each_colour_where_its_axis_is() -> None:
    colours = six_colours()
    for axis in range(3):
        for sign, level in ((1, 1.0), (-1, 0.25)):
            assert look_up(colours, sign * np.eye(3)[axis]).tolist() == (level * np.eye(3)[axis]).tolist()


def test_a_light_named_by_a_capture_stays_where_the_capture_has_it(tmp_path: Path) -> None:
    """From the file's texels through the reader's rotation to the world: Blender's +Z stays above."""
    torch = pytest.importorskip("torch")
    from hir_exporters.conventions import Z_UP_TO_Y_UP
    from hir_exporters.textures.image_files import write_exr

    from hir_core.rendering.light_files import load_light

    write_exr(tmp_path / "light.exr", six_colours())
    # Blender's image centre (our map's +Z) is its +X, a quarter from the left (our +X) its +Y, the top (our +Y) its +Z
    blender_from_latlong = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
    world_from_source = np.eye(4)
    world_from_source[:3, :3] = 0.5 * Z_UP_TO_Y_UP
    light = load_light(EnvironmentSource(tmp_path / "light.exr", 2.0, blender_from_latlong), world_from_source)
    assert light.to_world is not None
    to_world = light.to_world.numpy().astype(np.float64)
    assert torch.linalg.det(light.to_world) == pytest.approx(1.0)
    seen = {
        name: look_up(light.radiance.numpy(), to_world.T @ direction)
        for name, direction in {
            "above": np.array([0.0, 1, 0]),
            "blender +X": np.array([1.0, 0, 0]),
            "blender +Y": np.array([0.0, 0, -1]),
        }.items()
    }
    assert seen["above"].tolist() == [0, 2, 0], "the map's top, green, strength included"
    assert seen["blender +X"].tolist() == [0, 0, 2], "the map's centre, blue"
    assert seen["blender +Y"].tolist() == [2, 0, 0], "a quarter from the left, red"


def test_moving_the_world_moves_cameras_and_points_together() -> None:
    generator = np.random.default_rng(3)
    rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
    rotation *= np.sign(np.linalg.det(rotation))
    similarity = np.eye(4)
    similarity[:3, :3], similarity[:3, 3] = 3.7 * rotation, [5.0, -2.0, 1.0]
    camera = Camera(np.array([[200.0, 0, 63.5], [0, 190, 60.5], [0, 0, 1]]), np.eye(4), 128, 120)
    points = generator.normal(size=(20, 3), loc=(0, 0, 5))
    before, depth = camera.project(points)
    after, moved_depth = camera.transformed(similarity).project(points @ similarity[:3, :3].T + similarity[:3, 3])
    np.testing.assert_allclose(after, before, atol=1e-9)
    np.testing.assert_allclose(moved_depth, 3.7 * depth, rtol=1e-12)


def test_a_smaller_picture_sees_the_same_place() -> None:
    """Pixel centres at .5: the middle of a block of 4×4 pixels is the centre of the pixel it becomes."""
    camera = Camera(np.array([[200.0, 0, 63.5], [0, 190, 60.5], [0, 0, 1]]), np.eye(4), 128, 120)
    point = camera.rays(np.array([[34.0, 22.0]]))[1] * 3  # the corner where four pixels of a block meet
    np.testing.assert_allclose(camera.downsampled(4).project(point)[0], [[8.5, 5.5]], atol=1e-12)
