"""Textures of glTF files of any program: images of every mode, embedded, broken, and without an image."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import InputError
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.mesh_import import load_mesh_asset
from PIL import Image

from tests.fixtures.gltf_quads import png, textured, write_quad

CODES = np.random.default_rng(0).integers(0, 256, (16, 8, 3)).astype(np.uint8)
COLORS = Image.fromarray(CODES)


def loaded(path: Path) -> AssetMaterial:
    return load_mesh_asset(path).material


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P", "P with alpha", "L", "LA", "1", "I;16"])
def test_a_base_colour_of_any_mode_has_its_colours(mode: str, tmp_path: Path) -> None:
    if mode == "I;16":
        image = Image.fromarray(CODES[..., 0].astype(np.uint16) * 257)
        expected = np.repeat(CODES[..., :1], 3, axis=2)
    elif mode == "P with alpha":
        image = COLORS.convert("P")
        image.info["transparency"] = 3
        expected = np.asarray(image.convert("RGBA"))[..., :3]
    else:
        image = COLORS.convert(mode)
        expected = np.asarray(image.convert("RGB"))
    path = write_quad(tmp_path / "a.glb", textured(), [png(image)])
    np.testing.assert_allclose(loaded(path).diffuse_albedo, srgb_to_linear(expected / 255), atol=1e-5)


@pytest.mark.parametrize("mode", ["RGB", "P", "L", "LA", "I;16"])
def test_roughness_and_metalness_of_any_mode_are_green_and_blue(mode: str, tmp_path: Path) -> None:
    if mode == "I;16":
        image, expected = Image.fromarray(CODES[..., 0].astype(np.uint16) * 257), np.repeat(CODES[..., :1], 3, axis=2)
    else:
        image = COLORS.convert(mode)
        expected = np.asarray(image.convert("RGB"))
    material = {"pbrMetallicRoughness": {"metallicRoughnessTexture": {"index": 0}}}
    surface = read_gltf(write_quad(tmp_path / "a.glb", material, [png(image)])).surface
    np.testing.assert_allclose(surface.roughness, expected[..., 1] / 255, atol=1e-6)
    np.testing.assert_allclose(surface.metallic, expected[..., 2] / 255, atol=1e-6)


def test_a_normal_map_with_a_palette_has_its_vectors(tmp_path: Path) -> None:
    image = Image.fromarray(np.full((8, 8, 3), (200, 90, 220), np.uint8)).quantize(4)
    path = write_quad(tmp_path / "a.glb", textured() | {"normalTexture": {"index": 1}}, [png(COLORS), png(image)])
    vector = np.array([200, 90, 220]) / 255 * 2 - 1
    normal = loaded(path).normal
    assert normal is not None
    np.testing.assert_allclose(normal.reshape(-1, 3)[0], vector / np.linalg.norm(vector), atol=1e-5)


def test_alpha_is_1_where_an_image_has_none(tmp_path: Path) -> None:
    specular = {"KHR_materials_specular": {"specularFactor": 0.5, "specularTexture": {"index": 0}}}
    back = read_gltf(write_quad(tmp_path / "a.glb", {"extensions": specular}, [png(COLORS)]))
    np.testing.assert_array_equal(back.surface.specular_weight, np.float32(0.5))
    glossy = {"specularGlossinessTexture": {"index": 0}, "glossinessFactor": 0.25}
    old = {"extensions": {"KHR_materials_pbrSpecularGlossiness": glossy}}
    found = read_gltf(write_quad(tmp_path / "b.glb", old, [png(COLORS)])).specular_surface
    assert found is not None
    np.testing.assert_array_equal(found.roughness, np.float32(0.75))
    np.testing.assert_array_equal(found.diffuse, np.ones(3))
    np.testing.assert_allclose(found.specular, srgb_to_linear(CODES / 255), atol=1e-6)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_embedded_images_are_read(suffix: str, tmp_path: Path) -> None:
    path = write_quad(tmp_path / f"a.{suffix}", textured(), [png(COLORS)], embedded=True)
    np.testing.assert_allclose(loaded(path).diffuse_albedo, srgb_to_linear(CODES / 255), atol=1e-5)


def test_a_broken_image_is_named(tmp_path: Path) -> None:
    data = png(COLORS)
    path = write_quad(tmp_path / "a.glb", textured(), [data[: len(data) * 2 // 3]])
    with pytest.raises(InputError, match=r"a\.glb: image 0 is a broken image \(.*truncated.*\); write it again"):
        loaded(path)
    changes = {"images": [{"uri": "gone.png"}], "textures": [{"source": 0}]}
    with pytest.raises(InputError, match=r"a\.glb names 'gone\.png', which is not in its folder; put it"):
        loaded(write_quad(tmp_path / "a.glb", textured(), changes=changes))


@pytest.mark.parametrize(
    ("texture", "words"),
    [({}, "it has no image"), ({"extensions": {"ACME_raw": {"source": 0}}}, "only ACME_raw names its image")],
)
def test_a_texture_without_an_image_is_none_and_is_named(
    texture: dict[str, object], words: str, tmp_path: Path
) -> None:
    material = textured(baseColorFactor=[0.5, 0.25, 0.125, 1.0])
    path = write_quad(tmp_path / "a.glb", material, changes={"textures": [texture]})
    with pytest.warns(UserWarning, match=rf"a\.glb is read without texture 0 \({words}\), which"):
        albedo = loaded(path).diffuse_albedo
    np.testing.assert_allclose(albedo, [0.5, 0.25, 0.125], rtol=1e-5)
