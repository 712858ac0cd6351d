"""Profile engine: the lights of glTF and USD files and their residual environments are those of the asset's light."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial
from hir_exporters.content_cache import ContentCache
from hir_exporters.conventions import latlong_directions, latlong_solid_angles
from hir_exporters.engines import engine_light_cache
from hir_exporters.engines.engine_light import EngineLight, engine_light
from hir_exporters.engines.engine_light_cache import cached_engine_light
from hir_exporters.format_options import (
    CubemapConfig,
    EnvironmentConfig,
    GltfConfig,
    HarmonicsConfig,
    UsdConfig,
    UsdzConfig,
)
from hir_exporters.formats import create_exporter
from hir_exporters.gltf.extensions.punctual_lights import POINT_DISTANCE, POINT_RANGE
from hir_exporters.reading.file_verification import verify_file
from hir_exporters.textures.image_files import read_exr, read_hdr
from pxr import Gf, Usd, UsdGeom, UsdLux
from pygltflib import GLTF2
from scipy.spatial.transform import Rotation

HEIGHT = 32

RESIDUALS = ("x_glb_residual.hdr", "x_gltf_residual.hdr", "x_usda_residual.hdr", "x_usdz_residual.hdr")


@pytest.fixture
def metal(textured_asset: Asset) -> Asset:
    """A rough metal under a dim sky with two lamps."""
    directions = latlong_directions(HEIGHT, 2 * HEIGHT)
    sky = 0.1 + 0.05 * directions[..., 1:2] * np.ones(3)
    sky[directions @ (np.array([1, 2, 2]) / 3) > 0.95] += (8, 7, 5)
    sky[directions @ (np.array([-2, 1, 2]) / 3) > 0.97] += (3, 4, 6)
    material = AssetMaterial.metallic([0.9, 0.7, 0.4], 1.0, 0.3)
    return dataclasses.replace(textured_asset, material=material, environment=AssetEnvironment(sky))


def vector_irradiance(radiance: np.ndarray) -> np.ndarray:
    """(channel, axis): the integral of radiance times direction."""
    height, width = radiance.shape[:2]
    weighted = radiance * latlong_solid_angles(height, width)[..., None]
    return np.einsum("hwc,hwk->ck", weighted, latlong_directions(height, width))


def gltf_lights(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Directions towards the lights and irradiance at the object, from the extension's own definition."""
    document = GLTF2().load(str(path))
    lights = document.extensions["KHR_lights_punctual"]["lights"]
    assert "KHR_lights_punctual" in document.extensionsUsed
    directions, irradiance = [], []
    for node in (document.nodes[i] for i in document.scenes[0].nodes[1:]):
        light = lights[node.extensions["KHR_lights_punctual"]["light"]]
        color = np.array(light["color"]) * light["intensity"]
        if light["type"] == "directional":
            directions.append(-Rotation.from_quat(node.rotation).apply([0, 0, -1]))
        else:
            distance = np.linalg.norm(node.translation)
            window = 1 - (distance / light["range"]) ** 4
            directions.append(np.array(node.translation) / distance)
            color = color * window / distance**2
        irradiance.append(color)
    return np.array(directions), np.array(irradiance)


@pytest.mark.parametrize("light_type", ["directional", "point"])
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_lights_and_residual_are_the_whole_light(metal: Asset, tmp_path: Path, suffix: str, light_type: str) -> None:
    config = GltfConfig(profile="engine", lights=6, light_type=light_type)  # type: ignore[arg-type]
    report = create_exporter(suffix, config).write(metal, tmp_path / f"x.{suffix}")
    assert report.files[-1] == tmp_path / f"x_{suffix}_residual.hdr"
    assert not (tmp_path / "x.hdr").exists(), "the whole light would be shown twice"
    directions, irradiance = gltf_lights(report.files[0])
    assert 2 <= len(directions) <= 6
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-6)
    residual = read_hdr(report.files[-1])
    whole = vector_irradiance(metal.environment.radiance)
    np.testing.assert_allclose(vector_irradiance(residual) + irradiance.T @ directions, whole, rtol=0.01, atol=0.02)


def test_point_lights_are_far_from_the_object(metal: Asset, tmp_path: Path) -> None:
    create_exporter("glb", GltfConfig(profile="engine", light_type="point")).write(metal, tmp_path / "x.glb")
    document = GLTF2().load(str(tmp_path / "x.glb"))
    size = np.linalg.norm(metal.mesh.positions.max(axis=0) - metal.mesh.positions.min(axis=0))
    for node, light in zip(document.nodes[1:], document.extensions["KHR_lights_punctual"]["lights"], strict=True):
        distance = np.linalg.norm(node.translation)
        assert distance == pytest.approx(POINT_DISTANCE * size / 2, rel=1e-3)
        assert light["range"] == pytest.approx(POINT_RANGE * distance, rel=1e-3)


def test_the_file_says_what_was_done(metal: Asset, tmp_path: Path) -> None:
    report = create_exporter("glb", GltfConfig(profile="engine")).write(metal, tmp_path / "x.glb")
    document = GLTF2().load(str(tmp_path / "x.glb"))
    done = document.scenes[0].extras["hir"]
    assert done["profile"] == "engine" and done["light"]["lights"] == len(document.nodes) - 1
    assert 0.3 < done["light"]["share_of_light"] < 1
    assert report.files[-1].name.endswith(done["light"]["residual_environment_suffix"])
    assert any("residual" in warning for warning in report.warnings)


def test_the_unaltered_asset_stays_the_default(metal: Asset, tmp_path: Path) -> None:
    create_exporter("glb").write(metal, tmp_path / "x.glb")
    document = GLTF2().load(str(tmp_path / "x.glb"))
    assert len(document.nodes) == 1 and not document.extensions
    assert document.materials[0].pbrMetallicRoughness.baseColorFactor[:3] == pytest.approx([0.9, 0.7, 0.4], abs=1e-3)


def test_the_base_colour_read_back_is_that_of_the_profile(metal: Asset, tmp_path: Path) -> None:
    create_exporter("glb", GltfConfig(profile="engine")).write(metal, tmp_path / "x.glb")
    assert verify_file(tmp_path / "x.glb", metal, "engine").brdf < 0.01
    assert verify_file(tmp_path / "x.glb", metal, "khr").brdf > 0.02


def test_usd_lights_and_residual_are_the_whole_light(metal: Asset, tmp_path: Path) -> None:
    create_exporter("usda", UsdConfig(profile="engine", lights=6)).write(metal, tmp_path / "x.usda")
    stage = Usd.Stage.Open(str(tmp_path / "x_usda_lit.usda"))
    total, count = np.zeros((3, 3)), 0
    for prim in stage.Traverse():
        if prim.IsA(UsdLux.DistantLight):
            light, count = UsdLux.DistantLight(prim), count + 1
            assert light.GetNormalizeAttr().Get(), "so that the intensity is the irradiance"
            matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(Usd.TimeCode.Default())
            toward = -np.array(matrix.TransformDir(Gf.Vec3d(0, 0, -1)))
            total += np.outer(np.array(light.GetColorAttr().Get()) * light.GetIntensityAttr().Get(), toward)
    dome = next(UsdLux.DomeLight(prim) for prim in stage.Traverse() if prim.IsA(UsdLux.DomeLight))
    residual = read_hdr(Path(dome.GetTextureFileAttr().Get().resolvedPath))
    assert 2 <= count <= 6
    whole = vector_irradiance(metal.environment.radiance)
    np.testing.assert_allclose(vector_irradiance(residual) + total, whole, rtol=0.01, atol=0.02)


def test_usdz_has_no_light_inside(metal: Asset, tmp_path: Path) -> None:
    create_exporter("usdz", UsdzConfig(profile="engine")).write(metal, tmp_path / "x.usdz")
    stage = Usd.Stage.Open(str(tmp_path / "x.usdz"))
    assert not [prim for prim in stage.Traverse() if prim.HasAPI(UsdLux.LightAPI)]


def test_light_files_have_the_same_residual(metal: Asset, tmp_path: Path) -> None:
    config = EnvironmentConfig(profile="engine", lights=6)
    create_exporter("exr", config).write(metal, tmp_path / "x.exr")
    expected = engine_light(metal, 6).split.residual
    np.testing.assert_array_equal(read_exr(tmp_path / "x.exr", 1 << 20, 3), expected)
    whole, residual = tmp_path / "whole.ktx", tmp_path / "residual.ktx"
    create_exporter("ktx", CubemapConfig(size=32)).write(metal, whole)
    create_exporter("ktx", CubemapConfig(size=32, profile="engine")).write(metal, residual)
    assert whole.read_bytes() != residual.read_bytes()


def test_polished_metal_keeps_its_reflections_in_the_environment(metal: Asset) -> None:
    """A point light in a mirror is a dot: the light of a mirror is not divided, that of a rough metal is."""
    mirror = dataclasses.replace(metal, material=AssetMaterial.metallic([0.9] * 3, 1.0, 0.001))
    assert engine_light(mirror, 8).threshold is None
    rough = engine_light(metal, 8)
    assert rough.threshold is not None and rough.predicted_db > rough.predicted_db_without + 1


def test_an_even_light_has_no_lights(metal: Asset, tmp_path: Path) -> None:
    even = dataclasses.replace(metal, environment=AssetEnvironment(np.full((16, 32, 3), 0.5)))
    report = create_exporter("glb", GltfConfig(profile="engine")).write(even, tmp_path / "x.glb")
    assert len(GLTF2().load(str(tmp_path / "x.glb")).nodes) == 1
    np.testing.assert_allclose(read_hdr(report.files[-1]), 0.5, rtol=1 / 128)


def test_an_asset_without_light_changes_only_its_colour(metal: Asset, tmp_path: Path) -> None:
    dark = dataclasses.replace(metal, environment=None)
    report = create_exporter("glb", GltfConfig(profile="engine")).write(dark, tmp_path / "x.glb")
    document = GLTF2().load(str(tmp_path / "x.glb"))
    assert len(report.files) == 1 and not document.extensions
    assert document.materials[0].pbrMetallicRoughness.baseColorFactor[0] < 0.9


@pytest.mark.parametrize(
    "make",
    [
        lambda: GltfConfig(lights=4),
        lambda: GltfConfig(light_type="point"),
        lambda: UsdConfig(lights=4),
        lambda: HarmonicsConfig(lights=4),
    ],
)
def test_options_of_the_profile_are_refused_without_it(make: object) -> None:
    with pytest.raises(ValueError, match="only profile engine has lights"):
        make()  # type: ignore[operator]


def test_levels_of_detail_have_the_lights_too(metal: Asset, tmp_path: Path) -> None:
    config = GltfConfig(profile="engine", lods=(100,))
    create_exporter("glb", config).write(metal, tmp_path / "x.glb")
    for name in ("x.glb", "x_lod1.glb"):
        assert len(gltf_lights(tmp_path / name)[0]) >= 2, name


def test_all_formats_divide_the_light_once_and_alike(
    metal: Asset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a format reduces the mesh or the textures."""
    divided: list[int] = []

    def counted(asset: Asset, max_lights: int) -> EngineLight:
        divided.append(max_lights)
        return engine_light(asset, max_lights)

    monkeypatch.setattr(engine_light_cache, "engine_light", counted)
    monkeypatch.setattr(engine_light_cache, "_CACHE", ContentCache(2))
    rough = np.linspace(0.2, 0.4, 64, dtype=np.float32).reshape(8, 8)
    asset = dataclasses.replace(metal, material=AssetMaterial.metallic([0.9, 0.7, 0.4], 1.0, rough))
    for suffix, config in (
        ("glb", GltfConfig(profile="engine", budget="web")),
        ("gltf", GltfConfig(profile="engine", max_texture_size=4)),
        ("usda", UsdConfig(profile="engine", max_texture_size=4)),
        ("usdz", UsdzConfig(profile="engine")),
        ("hdr", EnvironmentConfig(profile="engine")),
    ):
        create_exporter(suffix, config).write(asset, tmp_path / f"x.{suffix}")
    assert divided == [8]
    residuals = {name: (tmp_path / name).read_bytes() for name in ("x.hdr", *RESIDUALS)}
    assert len(set(residuals.values())) == 1, sorted(residuals)


def test_a_changed_asset_is_divided_anew(metal: Asset) -> None:
    first = cached_engine_light(metal, 8)
    assert cached_engine_light(dataclasses.replace(metal, name="other"), 8) is first
    assert cached_engine_light(metal, 4) is not first
    mirror = dataclasses.replace(metal, material=AssetMaterial.metallic([0.9] * 3, 1.0, 0.001))
    assert cached_engine_light(mirror, 8).threshold is None and first.threshold is not None
    assert metal.environment is not None
    metal.environment.radiance[:] = 0.5  # in place
    assert cached_engine_light(metal, 8).threshold is None
