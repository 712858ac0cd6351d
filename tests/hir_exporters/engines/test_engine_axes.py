"""The six-colour light through the panorama formula of each engine, with the turn that docs/engines/README.md gives."""

import dataclasses
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.conventions import latlong_directions, srgb_to_linear
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.textures.image_files import read_hdr, read_ldr

Direction = np.ndarray
COLORS = {
    (1, 0, 0): (1, 0, 0),
    (0, 1, 0): (0, 1, 0),
    (0, 0, 1): (0, 0, 1),
    (-1, 0, 0): (0, 1, 1),
    (0, -1, 0): (1, 0, 1),
    (0, 0, -1): (1, 1, 0),
}
TAU = 2 * np.pi


def height(up: float) -> float:
    return float(np.arccos(np.clip(up, -1, 1)) / np.pi)


def three(d: Direction) -> tuple[float, float]:
    """equirectUv of the direction turned by the negated environmentRotation.y = -pi/2."""
    x, y, z = d[2], d[1], -d[0]
    return np.arctan2(z, x) / TAU + 0.5, height(y)


def model_viewer(d: Direction) -> tuple[float, float]:
    """The model turned by `orientation` of 90 degrees about Y, then equirectUv without a rotation."""
    angle = np.pi / 2
    x, y, z = np.cos(angle) * d[0] + np.sin(angle) * d[2], d[1], np.cos(angle) * d[2] - np.sin(angle) * d[0]
    return np.arctan2(z, x) / TAU + 0.5, height(y)


def blender(d: Direction) -> tuple[float, float]:
    """The importer's (x, -z, y), a Mapping node of +90 degrees about Z, and the Environment Texture's formula."""
    x, y, z = d[0], -d[2], d[1]
    x, y = -y, x
    return -np.arctan2(y, x) / TAU + 0.5, height(z)


def unity(d: Direction) -> tuple[float, float]:
    """glTFast's mirrored x; Skybox/Panoramic shows at angle t what lies at t + _Rotation; then its ToRadialCoords."""
    x, y, z = -d[0], d[1], d[2]
    angle = np.arctan2(x, z) + np.pi / 2
    x, z = np.sin(angle), np.cos(angle)
    return 0.5 - np.arctan2(z, x) / TAU, height(y)


def godot(d: Direction) -> tuple[float, float]:
    """panorama_coords of Godot 4's sky shader, no rotation."""
    return np.arctan2(d[0], -d[2]) / TAU, height(d[1])


def unreal(d: Direction) -> tuple[float, float]:
    """glTF's (x, y, z) as the importer's (x, z, y); the sky light's turn of 180 degrees; FImageViewLongLat's lookup."""
    x, y, z = d[0], d[2], d[1]
    sine, cosine = np.sin(np.pi), np.cos(np.pi)
    x, y = x * cosine - y * sine, x * sine + y * cosine
    return 0.5 + np.arctan2(x, -y) / TAU, height(z)


def usd(d: Direction) -> tuple[float, float]:
    """UsdLux: +Y the pole, longitude 0 is +Z and in the middle, +X at longitude pi/2, a quarter to the left."""
    return 0.5 - np.arctan2(d[0], d[2]) / TAU, height(d[1])


@pytest.mark.parametrize("engine", [three, model_viewer, blender, unity, unreal, godot, usd])
def test_each_axis_shows_its_colour(
    engine: Callable[[Direction], tuple[float, float]], textured_asset: Asset, tmp_path: Path
) -> None:
    create_exporter("hdr").write(textured_asset, tmp_path / "x.hdr")
    image = read_hdr(tmp_path / "x.hdr")
    rows, columns = image.shape[:2]
    for axis, color in COLORS.items():
        u, v = engine(np.add(axis, (1e-6, 2e-6, 3e-6)))
        pixel = image[min(int(v * rows), rows - 1), int((u % 1) * columns)]
        np.testing.assert_allclose(pixel, color, atol=0.01, err_msg=f"{engine.__name__} {axis}")


def test_light_inside_gltf_has_its_colours_on_the_faces(textured_asset: Asset, tmp_path: Path) -> None:
    """EXT_lights_image_based: faces in OpenGL's order (+X, -X, +Y, -Y, +Z, -Z), of a left-handed world: z mirrored."""
    create_exporter("gltf", GltfConfig(image_based_light=True)).write(textured_asset, tmp_path / "x.gltf")
    faces = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    for number, (x, y, z) in enumerate(faces):
        codes = read_ldr(tmp_path / f"x_gltf_light_0_{number}.png")
        middle = srgb_to_linear(codes[60:68, 60:68, :3]) / codes[60:68, 60:68, 3:]
        np.testing.assert_allclose(middle.mean((0, 1)), COLORS[x, y, -z], atol=0.02, err_msg=str(number))


def test_light_inside_gltf_goes_on_over_the_edges_of_faces(textured_asset: Asset, tmp_path: Path) -> None:
    """OpenGL's table of faces (4.6, table 8.19) for the mirrored direction, rows stored from the bottom.

    So it was seen in Babylon.js; faces the other way up show the six colours as well, and edges all over a metal.
    """
    light = AssetEnvironment((0.5 + 0.45 * latlong_directions(64, 128)).astype(np.float32))
    asset = dataclasses.replace(textured_asset, environment=light)
    create_exporter("gltf", GltfConfig(image_based_light=True)).write(asset, tmp_path / "x.gltf")
    faces = [read_ldr(tmp_path / f"x_gltf_light_0_{number}.png") for number in range(6)]
    for direction in np.random.default_rng(0).normal(size=(300, 3)):
        x, y, z = direction / np.linalg.norm(direction) * [1, 1, -1]
        axis = int(np.abs([x, y, z]).argmax())
        number = 2 * axis + int([x, y, z][axis] < 0)
        s, t = [(-z, -y), (z, -y), (x, z), (x, -z), (x, -y), (-x, -y)][number] / np.abs([x, y, z][axis])
        size = len(faces[number])
        codes = faces[number][size - 1 - int((t + 1) / 2 * size), int((s + 1) / 2 * size)]
        np.testing.assert_allclose(srgb_to_linear(codes[:3]) / codes[3], 0.5 + 0.45 * np.array([x, y, -z]), atol=0.02)


def test_the_ready_scripts_turn_the_light_as_tested() -> None:
    """What the formulas above assume stands in the scripts and on the pages."""
    root = Path(__file__).resolve().parents[3]
    for file, words in {
        "examples/engines/unreal_import.py": "YAW_DEG = 180.0",
        "examples/engines/HirAssetImporter.cs": "Rotation = 90f",
        "examples/engines/blender_import.py": "math.radians(90)",
        "examples/engines/threejs.html": "-Math.PI / 2",
        "docs/engines/threejs.md": 'orientation="0deg 0deg 90deg"',
        "docs/engines/unreal.md": "*Source Cubemap Angle* 180",
        "docs/engines/README.md": "| Unreal 5.5 | 180°",
    }.items():
        assert words in (root / file).read_text(encoding="utf-8"), file
