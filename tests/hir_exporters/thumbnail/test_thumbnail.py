"""Thumbnails: the whole object, its nearest surfaces, its own light; named in USD files, equal for all formats."""

from __future__ import annotations

import dataclasses
import io
import zipfile
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from hir_exporters import budgets
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.budgets import Budget
from hir_exporters.engines.surface_points import surface_points
from hir_exporters.engines.surface_psnr import encoded, model_radiance, psnr_db
from hir_exporters.format_options import GltfConfig, UsdConfig, UsdzConfig
from hir_exporters.formats import create_exporter
from hir_exporters.light.environment_map import world_radiance
from hir_exporters.reading.usd_reading.usd_readback import read_usd
from hir_exporters.reading.validators import validate_omniverse, validate_usd
from hir_exporters.textures.texture_maps import sample_texels
from hir_exporters.thumbnail import thumbnail
from hir_exporters.thumbnail.image_based_shading import ShadedPoints, prefiltered_light, shaded
from hir_exporters.thumbnail.thumbnail import render_thumbnail
from PIL import Image
from pxr import Usd, UsdMedia

SIDE = 128
"""Pixels of the pictures here, a quarter of those of an export."""
PAINTED = {"specular_albedo": [0.0] * 3, "roughness": 1.0}


def matte(mesh: AssetMesh, albedo: np.ndarray, light: np.ndarray | None = None) -> Asset:
    """A surface of Lambert's model under a uniform light of 0.5."""
    radiance = np.full((16, 32, 3), 0.5) if light is None else light
    return Asset(mesh, AssetMaterial("paper", albedo, **PAINTED), AssetEnvironment(radiance))


@pytest.fixture
def full_size(monkeypatch: pytest.MonkeyPatch) -> int:
    """The side of an export's picture, for one of the tests."""
    monkeypatch.undo()
    return thumbnail.SIDE


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are small, because a large one takes seconds."""
    monkeypatch.setattr(thumbnail, "SIDE", SIDE)


def test_a_sphere_fills_nine_tenths(make_sphere: Callable[..., AssetMesh], full_size: int) -> None:
    picture = render_thumbnail(matte(make_sphere(64, 128), np.array([0.5, 0.4, 0.3])))
    assert full_size == 512 and picture.shape == (full_size, full_size, 4) and picture.dtype == np.uint8
    alpha = picture[..., 3] / 255
    assert alpha.mean() == pytest.approx(np.pi / 4 * 0.9**2, rel=2e-3)
    filled = np.flatnonzero(alpha.max(axis=0) > 0)
    assert filled[0] == pytest.approx(0.05 * full_size, abs=1.5) and filled[-1] == pytest.approx(
        0.95 * full_size, abs=1.5
    )
    # uniform light: white is 0.9, so that the albedo is seen as 0.9 times itself
    middle = picture[full_size // 2, full_size // 2, :3] / 255
    np.testing.assert_allclose(middle, encoded(0.9 * np.array([0.5, 0.4, 0.3])), atol=0.01)


def test_right_is_plus_x_and_up_is_plus_y(make_sphere: Callable[..., AssetMesh]) -> None:
    """The texture of the sphere is painted by direction: red towards +X, green towards +Y."""
    v, u = (np.mgrid[:64, :64] + 0.5) / 64 * [[[np.pi]], [[2 * np.pi]]]
    albedo = np.stack([0.5 + 0.4 * np.sin(v) * np.sin(u), 0.5 + 0.4 * np.cos(v), np.full_like(u, 0.5)], axis=-1)
    picture = render_thumbnail(matte(make_sphere(32, 64), albedo)).astype(float)
    quarter = SIDE // 4
    assert picture[2 * quarter, 3 * quarter, 0] > picture[2 * quarter, quarter, 0] + 40
    assert picture[quarter, 2 * quarter, 1] > picture[3 * quarter, 2 * quarter, 1] + 40


@pytest.mark.parametrize("front_first", [True, False])
def test_the_nearest_surface_is_shown(front_first: bool) -> None:
    square = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
    positions = np.concatenate([square + np.float32([0, 0, 0.1]), square])
    uvs = np.repeat([[0.25, 0.5], [0.75, 0.5]], 4, axis=0)  # the left half of the texture is in front
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    mesh = AssetMesh(positions, np.tile([0, 0, 1], (8, 1)), uvs, faces if front_first else faces[::-1])
    albedo = np.zeros((4, 4, 3))
    albedo[:, :2, 0], albedo[:, 2:, 1] = 0.9, 0.9
    picture = render_thumbnail(matte(mesh, albedo))
    assert picture[SIDE // 2, SIDE // 2, 0] > 200 and picture[SIDE // 2, SIDE // 2, 1] < 10


def test_a_mesh_that_faces_away_is_shown_from_behind() -> None:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32)
    mesh = AssetMesh(corners, np.tile([0, 0, -1], (3, 1)), corners[:, :2] / 4 + 0.5, [[0, 2, 1]])
    assert (render_thumbnail(matte(mesh, np.full(3, 0.5)))[..., 3] > 0).mean() > 0.2


@pytest.mark.parametrize("model", ["paper", "dielectric", "metallic"])
def test_shading_is_that_of_the_model(textured_asset: Asset, model: str) -> None:
    """Against the split sum by sampled directions, and less closely against the whole integral."""
    material = (
        AssetMaterial.metallic([0.9, 0.7, 0.4], 1.0, 0.3)
        if model == "metallic"
        else dataclasses.replace(textured_asset.material, model=model)
    )
    asset = dataclasses.replace(textured_asset, material=material)
    points = surface_points(asset)
    own = ShadedPoints(
        material.model,
        sample_texels(material.diffuse_albedo, True, points.uvs),
        sample_texels(material.specular_albedo, True, points.uvs),
        points.alpha,
        points.normals,
        2 * points.cos_o[:, None] * points.normals - points.reflected,
    )
    found = encoded(shaded(own, prefiltered_light(world_radiance(asset)[0])))
    lobe = own.specular * points.slices.albedo_scale[:, 0, :1] + points.slices.albedo_bias[:, 0, :1]
    if model == "paper":
        lobe = own.specular * (points.slices.albedo_scale + points.slices.albedo_bias)[:, 0, :1]
    diffuse = (1 - lobe * (model != "paper")) * own.diffuse * points.irradiance_over_pi()
    expected = encoded(diffuse + lobe * points.prefiltered(points.reflected, points.alpha))
    assert psnr_db(found, expected) > 30
    assert psnr_db(found[::-1], expected) < 15, "the comparison can fail"
    assert psnr_db(found, encoded(model_radiance(asset, points))) > (20 if model == "metallic" else 26)


def test_exposure_follows_the_light_and_not_the_object(textured_asset: Asset) -> None:
    light = textured_asset.environment
    assert light is not None
    brighter = dataclasses.replace(textured_asset, environment=AssetEnvironment(light.radiance * 7))
    difference = render_thumbnail(brighter).astype(int) - render_thumbnail(textured_asset)
    assert np.abs(difference).max() <= 1
    white, black = (render_thumbnail(matte(textured_asset.mesh, np.full(3, rho))) for rho in (0.8, 0.04))
    assert white[..., :3].max() > 200 and black[..., :3].max() < 80


def test_a_light_of_the_camera_is_that_of_the_picture(make_sphere: Callable[..., AssetMesh]) -> None:
    """A lamp above the camera: the upper half is brighter, whatever the first view was."""
    lamp = np.full((16, 32, 3), 0.05)
    lamp[12:] = 5.0  # the lower rows are the camera's +Y, which is downwards in the picture's axes
    asset = matte(make_sphere(), np.full(3, 0.5))
    asset = dataclasses.replace(asset, environment=AssetEnvironment(lamp, frame="camera"))
    picture = render_thumbnail(asset)[..., 0].astype(float)
    assert picture[SIDE // 4, SIDE // 2] > picture[3 * SIDE // 4, SIDE // 2] + 40


def test_without_light_the_object_is_seen(constant_asset: Asset) -> None:
    picture = render_thumbnail(constant_asset)
    assert picture[SIDE // 2, SIDE // 2, :3].min() > 60


@pytest.mark.slow
def test_all_formats_have_the_same_picture(textured_asset: Asset, tmp_path: Path) -> None:
    """Also where a format reduces the asset. It is rendered once, and again for another asset."""
    for suffix, config in (
        ("glb", GltfConfig(thumbnail=True)),
        ("gltf", GltfConfig(thumbnail=True, max_texture_size=4)),
        ("usda", UsdConfig(thumbnail=True, image_format="jpeg")),
        ("usdz", UsdzConfig(thumbnail=True, max_texture_size=4)),
    ):
        report = create_exporter(suffix, config).write(textured_asset, tmp_path / suffix / f"x.{suffix}")
        assert (tmp_path / suffix / "x_thumbnail.png" in report.files) == (suffix != "usdz")
    pictures = {suffix: (tmp_path / suffix / "x_thumbnail.png").read_bytes() for suffix in ("glb", "gltf", "usda")}
    with zipfile.ZipFile(tmp_path / "usdz" / "x.usdz") as package:
        pictures["usdz"] = package.read("thumbnails/thumbnail.png")
    assert len(set(pictures.values())) == 1
    with Image.open(io.BytesIO(pictures["glb"])) as image:
        assert image.size == (SIDE, SIDE) and image.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(image), render_thumbnail(textured_asset))
    darker = dataclasses.replace(textured_asset, material=AssetMaterial("dielectric", [0.1] * 3, [0.04] * 3, 0.3))
    assert thumbnail.thumbnail_png(darker) != pictures["glb"]


def test_no_picture_by_default(textured_asset: Asset, tmp_path: Path) -> None:
    for suffix in ("glb", "usda", "usdz"):
        create_exporter(suffix).write(textured_asset, tmp_path / f"x.{suffix}")
    assert not (tmp_path / "x_thumbnail.png").exists()
    stage = Usd.Stage.Open(str(tmp_path / "x.usdz"))
    assert not stage.GetDefaultPrim().HasAPI(UsdMedia.AssetPreviewsAPI)


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usdz"])
def test_usd_names_the_picture(textured_asset: Asset, tmp_path: Path, suffix: str) -> None:
    config = UsdzConfig(thumbnail=True) if suffix == "usdz" else UsdConfig(thumbnail=True)
    path = tmp_path / f"x.{suffix}"
    create_exporter(suffix, config).write(textured_asset, path)
    stage = Usd.Stage.Open(str(path))
    prim = stage.GetDefaultPrim()
    assert prim.HasAPI(UsdMedia.AssetPreviewsAPI)
    found = UsdMedia.AssetPreviewsAPI(prim).GetDefaultThumbnails().defaultImage
    expected = f"{path}[thumbnails/thumbnail.png]" if suffix == "usdz" else str(tmp_path / "x_thumbnail.png")
    assert found.resolvedPath == expected, "USD's resolver finds the picture"
    assert [str(f) for f in validate_usd([path]) if f.severity != "information"] == []
    if find_spec("omni") is not None:
        assert [str(f) for f in validate_omniverse([path]) if f.severity != "information"] == []
    assert len(read_usd(path).corner_positions) == len(textured_asset.mesh.faces)


def test_the_picture_in_a_package_counts_in_its_budget(
    textured_asset: Asset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(0).random((256, 256, 3), np.float32)
    asset = dataclasses.replace(textured_asset, material=AssetMaterial("dielectric", noise, [0.04] * 3, 0.3))
    picture = len(thumbnail.thumbnail_png(asset))
    limit = 2 * picture
    monkeypatch.setitem(budgets.BUDGETS, "web", Budget(100_000, 2048, limit))
    create_exporter("usdz", UsdzConfig(thumbnail=True, budget="web")).write(asset, tmp_path / "x.usdz")
    assert picture < (tmp_path / "x.usdz").stat().st_size <= limit
