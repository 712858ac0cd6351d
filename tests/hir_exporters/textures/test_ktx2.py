"""KTX2 by the npm package: what is encoded decodes to nearly the same, files are valid, what is missing is named."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset
from hir_exporters.errors import ExportError, InputError
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.reading import texture_decoding
from hir_exporters.reading.file_verification import verify_file
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.reading.validators import validate_gltf
from hir_exporters.textures import ktx2
from hir_exporters.textures.ktx2 import IDENTIFIER, check_ktx2, decode_ktx2, encode_ktx2

_UNKNOWN_TO_THE_VALIDATOR = ("VALUE_NOT_IN_LIST", "IMAGE_UNRECOGNIZED_FORMAT")
"""Khronos' validator does not know KHR_texture_basisu, and warns of the type and the bytes of each image."""


def waves(height: int, width: int) -> np.ndarray:
    """Smooth 8-bit RGB whose channels are independent and whose rows and columns differ."""
    y, x = np.mgrid[:height, :width]
    channels = [np.sin(x / 11), np.sin(y / 7 + 1), np.cos((x + 2 * y) / 23)]
    return np.rint(127 + 100 * np.stack(channels, -1)).astype(np.uint8)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(10 * np.log10(255**2 / (np.mean((a.astype(float) - b) ** 2) + 1e-6)))


@pytest.mark.usefixtures("ktx2_encoder")
@pytest.mark.parametrize(
    ("kind", "quality", "least"),
    [
        ("color", 92, 30),
        ("normal", 0, 40),
        pytest.param("linear", 0, 40, marks=pytest.mark.slow),
        pytest.param("linear", 75, 25, marks=pytest.mark.slow),
    ],
)
def test_an_image_decodes_to_nearly_the_same(kind: ktx2.Kind, quality: int, least: float) -> None:
    pixels = waves(32, 48)
    data = encode_ktx2(pixels, kind, quality)
    assert data.startswith(IDENTIFIER) and struct.unpack_from("<2I", data, 20) == (48, 32)
    (levels,) = struct.unpack_from("<I", data, 40)
    assert levels == 6, "mipmaps to one pixel"
    assert data == encode_ktx2(pixels, kind, quality), "the same bytes each time"
    back = decode_ktx2(data)
    assert back.shape == (32, 48, 4) and np.all(back[..., 3] == 255)
    assert psnr(back[..., :3], pixels) > least > psnr(back[::-1, :, :3], pixels)
    transfer = data[struct.unpack_from("<I", data, 48)[0] + 14]
    assert transfer == (2 if kind == "color" else 1), "sRGB for colour, linear for the others"


@pytest.mark.slow
@pytest.mark.usefixtures("ktx2_encoder")
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_grey_and_alpha(channels: int) -> None:
    pixels = np.concatenate([waves(16, 16), waves(16, 16)[::-1, :, :1]], -1)
    source = pixels[..., [0, 3]] if channels == 2 else pixels[..., :channels]
    back = decode_ktx2(encode_ktx2(source, "linear", 0))
    color = source[..., :3] if channels > 2 else np.repeat(source[..., :1], 3, -1)
    assert psnr(back[..., :3], color) > 30
    assert psnr(back[..., 3], source[..., -1] if channels in (2, 4) else np.full((16, 16), 255)) > 30


@pytest.mark.slow
@pytest.mark.usefixtures("ktx2_encoder")
@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_a_file_has_ktx2_beside_a_fallback(
    suffix: str, textured_asset: Asset, node_tools: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Read-back gets the KTX2 images, whose sides are multiples of 4; the validator has no finding elsewhere."""
    albedo = waves(30, 50).astype(np.float32) / 300 + 0.1
    asset = replace(textured_asset, material=replace(textured_asset.material, diffuse_albedo=albedo))
    path = tmp_path / f"x.{suffix}"
    create_exporter(suffix, GltfConfig(image_format="ktx2")).write(asset, path)
    data = path.read_bytes()
    content = json.loads(data[20 : 20 + struct.unpack("<I", data[12:16])[0]] if suffix == "glb" else data)
    assert "KHR_texture_basisu" in content["extensionsUsed"] and "extensionsRequired" not in content
    for texture in content["textures"]:
        image = content["images"][texture["extensions"]["KHR_texture_basisu"]["source"]]
        fallback = content["images"][texture["source"]]
        if suffix == "glb":
            assert image["mimeType"] == "image/ktx2" and fallback["mimeType"] in ("image/png", "image/jpeg")
        else:
            assert image["uri"].endswith(".ktx2") and fallback["uri"].endswith((".png", ".jpg"))
    found = [f for f in validate_gltf([path], node_tools) if f.severity in ("error", "warning")]
    assert {(f.severity, f.code) for f in found} <= {("warning", code) for code in _UNKNOWN_TO_THE_VALIDATOR}
    ktx2_images = [texture["extensions"]["KHR_texture_basisu"]["source"] for texture in content["textures"]]
    assert {int(f.message.split("/images/")[1].split("/")[0]) for f in found} <= set(ktx2_images)
    back = read_gltf(path)
    assert all(side % 4 == 0 for side in back.surface.base_color.shape[:2]), "the image, not its fallback"
    assert verify_file(path, asset).problems == ()
    assert load_mesh_asset(path).material.diffuse_albedo.shape == back.surface.base_color.shape
    monkeypatch.setenv("HIR_NODE_MODULES", str(tmp_path))
    texture_decoding._decoded.cache_clear()
    with pytest.raises(InputError, match=r"KTX2 image was not read: .* has no npm package ktx2-encoder"):
        load_mesh_asset(path)


@pytest.mark.usefixtures("ktx2_encoder")
def test_damaged_files_are_refused() -> None:
    data = encode_ktx2(waves(16, 16), "linear", 0)
    with pytest.raises(InputError, match="a KTX2 image was not read: node failed"):
        decode_ktx2(data[:100] + bytes(len(data) - 100))
    with pytest.raises(InputError, match="is a KTX2 image of 0 x 0 pixels"):
        check_ktx2(data[:40], "x.glb: image 0")
    with pytest.raises(InputError, match="65535 x 65535 pixels"):
        check_ktx2(data[:20] + struct.pack("<2I", 65535, 65535) + data[28:], "x.glb: image 0")


@pytest.mark.usefixtures("ktx2_encoder")
def test_what_is_too_large_or_too_slow_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ExportError, match=r"4096 × 4096 pixels, .*; set max_texture_size=2048"):
        encode_ktx2(np.broadcast_to(np.uint8(0), (4096, 4096, 3)), "color", 92)
    monkeypatch.setattr(ktx2, "_SECONDS", 1e-3)
    with pytest.raises(ExportError, match="did not finish"):
        encode_ktx2(waves(16, 16), "linear", 0)


def test_a_missing_encoder_is_named(textured_asset: Asset, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before anything is written."""
    monkeypatch.setenv("HIR_NODE_MODULES", str(tmp_path))
    monkeypatch.setattr(ktx2.shutil, "which", lambda _: "node")
    config = GltfConfig(image_format="ktx2")
    with pytest.raises(ExportError, match=r"run `npm install ktx2-encoder@0\.6`"):
        create_exporter("glb", config).write(textured_asset, tmp_path / "x.glb")
    monkeypatch.delenv("HIR_NODE_MODULES")
    (tmp_path / "node_modules").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ExportError, match="ktx2-encoder is not there"):
        create_exporter("glb", config).write(textured_asset, tmp_path / "x.glb")
    monkeypatch.setattr(ktx2.shutil, "which", lambda _: None)
    with pytest.raises(ExportError, match="node is not installed"):
        create_exporter("glb", config).write(textured_asset, tmp_path / "x.glb")
    assert [path.name for path in tmp_path.iterdir()] == ["node_modules"]
