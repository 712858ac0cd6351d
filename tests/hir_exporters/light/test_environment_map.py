import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment
from hir_exporters.conventions import direction_to_latlong_uv, latlong_directions, latlong_solid_angles
from hir_exporters.errors import ExportError
from hir_exporters.format_options import EnvironmentConfig
from hir_exporters.formats import create_exporter
from hir_exporters.light import environment_map as env
from hir_exporters.textures.image_files import read_hdr
from scipy.spatial.transform import Rotation

AXES = {
    (1, 0, 0): (1, 0, 0),
    (0, 1, 0): (0, 1, 0),
    (0, 0, 1): (0, 0, 1),
    (-1, 0, 0): (0, 1, 1),
    (0, -1, 0): (1, 0, 1),
    (0, 0, -1): (1, 1, 0),
}


def seen(radiance: np.ndarray, direction: object) -> np.ndarray:
    """The pixel that a direction looks at."""
    u, v = direction_to_latlong_uv(direction)
    height, width = radiance.shape[:2]
    return radiance[min(int(v * height), height - 1), int(u * width) % width]


@pytest.mark.parametrize("angles", [(0, 0, 0), (90, 0, 0), (0, 90, 0), (0, 0, 90), (0, 37, 0), (25, -130, 70)])
def test_light_comes_from_where_the_rotation_puts_it(six_colors: np.ndarray, angles: tuple[int, ...]) -> None:
    rotation = Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    turned = env.rotate_latlong(six_colors, rotation)
    for axis, color in AXES.items():
        np.testing.assert_allclose(seen(turned, rotation @ axis), color, atol=0.02)
    np.testing.assert_allclose(env.mean_radiance(turned), env.mean_radiance(six_colors), rtol=1e-12)


def test_no_rotation_and_whole_pixels_change_no_value() -> None:
    radiance = np.random.default_rng(0).random((8, 16, 3))
    np.testing.assert_array_equal(env.rotate_latlong(radiance, np.eye(3)), radiance)
    quarter = Rotation.from_euler("y", 90, degrees=True).as_matrix()
    turned = env.rotate_latlong(radiance, quarter)
    np.testing.assert_array_equal(np.sort(turned, axis=1), np.sort(radiance, axis=1))
    np.testing.assert_array_equal(seen(turned, quarter @ [0.1, 0.2, 1]), seen(radiance, [0.1, 0.2, 1]))


@pytest.mark.parametrize("size", [(8, 16), (64, 128), (13, 26), (128, 512)])
def test_resampling_keeps_the_energy_of_every_colour(size: tuple[int, int]) -> None:
    radiance = np.random.default_rng(0).random((32, 128, 3)) ** 8
    resampled = env.resample_latlong(radiance, *size)
    assert resampled.shape == (*size, 3)
    np.testing.assert_allclose(env.mean_radiance(resampled), env.mean_radiance(radiance), rtol=1e-12)


def test_a_sun_keeps_its_place_and_energy(shared: Path) -> None:
    radiance = read_hdr(shared / "envmaps" / "park.hdr")
    rotation = Rotation.from_euler("xyz", (20, 50, -10), degrees=True).as_matrix()
    turned = env.rotate_latlong(radiance, rotation)

    def brightest(image: np.ndarray) -> np.ndarray:
        weight = (image.sum(-1) * latlong_solid_angles(*image.shape[:2]))[..., None] ** 2
        mean = (latlong_directions(*image.shape[:2]) * weight).sum((0, 1))
        return mean / np.linalg.norm(mean)

    angle = np.degrees(np.arccos(brightest(turned) @ (rotation @ brightest(radiance))))
    assert angle < 0.2
    np.testing.assert_allclose(env.mean_radiance(turned), env.mean_radiance(radiance), rtol=1e-10)


def test_harmonics_of_known_lights() -> None:
    height, width = 64, 128
    white = env.spherical_harmonics(np.ones((height, width, 3)))
    np.testing.assert_allclose(white[:, 0], [np.sqrt(4 * np.pi)] + [0] * 8, atol=2e-3)
    basis = env.harmonic_basis(latlong_directions(height, width))
    weight = latlong_solid_angles(height, width)
    gram = np.einsum("hwi,hwj,hw->ij", basis, basis, weight * np.ones((1, width)))
    np.testing.assert_allclose(gram, np.eye(9), atol=3e-3)
    # A white sky gives irradiance pi everywhere.
    irradiance = env.irradiance_harmonics(np.ones((height, width, 3)))
    np.testing.assert_allclose(basis @ irradiance, np.pi, rtol=2e-3)


def test_irradiance_of_a_sky_is_that_of_the_integral(six_colors: np.ndarray) -> None:
    directions = latlong_directions(*six_colors.shape[:2])
    weight = latlong_solid_angles(*six_colors.shape[:2])
    normal = np.array([0.3, 0.8, -0.52])
    normal /= np.linalg.norm(normal)
    exact = (six_colors * (np.maximum(directions @ normal, 0) * weight)[..., None]).sum((0, 1))
    nine = env.harmonic_basis(normal[None])[0] @ env.irradiance_harmonics(six_colors)
    np.testing.assert_allclose(nine, exact, rtol=0.05)  # Ramamoorthi and Hanrahan: a few percent


@pytest.mark.parametrize("suffix", ["hdr", "exr"])
def test_files_hold_the_light_in_world_axes(textured_asset: Asset, suffix: str, tmp_path: Path) -> None:
    rotation = Rotation.from_euler("xyz", (30, 60, 90), degrees=True).as_matrix()
    asset = dataclasses.replace(
        textured_asset, environment=dataclasses.replace(textured_asset.environment, to_world=rotation)
    )
    report = create_exporter(suffix, EnvironmentConfig(height=64)).write(asset, tmp_path / f"x.{suffix}")
    radiance = read_hdr(tmp_path / f"x.{suffix}")
    assert radiance.shape == (64, 128, 3) and report.warnings == ()
    for axis, color in AXES.items():
        np.testing.assert_allclose(seen(radiance, rotation @ axis), color, atol=0.03)


def test_float_files_keep_an_unturned_light_exactly(textured_asset: Asset, tmp_path: Path) -> None:
    create_exporter("exr").write(textured_asset, tmp_path / "x.exr")
    np.testing.assert_array_equal(read_hdr(tmp_path / "x.exr"), textured_asset.environment.radiance)


def test_a_light_that_travels_is_written_as_the_first_view_saw_it(textured_asset: Asset, tmp_path: Path) -> None:
    view = Rotation.from_euler("xyz", (10, 120, 5), degrees=True).as_matrix()
    light = AssetEnvironment(textured_asset.environment.radiance, np.eye(3), "camera")
    provenance = {env.FIRST_VIEW_KEY: view.tolist()}
    asset = dataclasses.replace(textured_asset, environment=light, provenance=provenance)
    report = create_exporter("exr", EnvironmentConfig(height=64)).write(asset, tmp_path / "x.exr")
    assert "first view" in report.warnings[0]
    np.testing.assert_allclose(seen(read_hdr(tmp_path / "x.exr"), view @ [0, 0, 1]), [0, 0, 1], atol=0.03)
    report = create_exporter("exr").write(dataclasses.replace(asset, provenance={}), tmp_path / "x.exr")
    assert "camera axes" in report.warnings[0]


def test_wide_lights_become_two_to_one(textured_asset: Asset, tmp_path: Path) -> None:
    wide = AssetEnvironment(np.random.default_rng(0).random((16, 64, 3)))
    create_exporter("exr").write(dataclasses.replace(textured_asset, environment=wide), tmp_path / "x.exr")
    written = read_hdr(tmp_path / "x.exr")
    assert written.shape == (32, 64, 3)
    np.testing.assert_allclose(env.mean_radiance(written), env.mean_radiance(wide.radiance), rtol=1e-6)


def test_no_light_is_an_error_for_its_own_files_only(constant_asset: Asset, tmp_path: Path) -> None:
    with pytest.raises(ExportError, match="no environment"):
        create_exporter("hdr").write(constant_asset, tmp_path / "x.hdr")
    assert [p.name for p in create_exporter("glb").write(constant_asset, tmp_path / "x.glb").files] == ["x.glb"]
