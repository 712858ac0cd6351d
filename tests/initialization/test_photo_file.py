"""Photographs as people have them: bit depths, modes, turned, cut off, far too large."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hir_exporters.conventions import srgb_to_linear
from PIL import Image, ImageOps

from hir_core.errors import CaptureError
from hir_plugins.readers.photo_file import PhotoFile, photo_size, read_encoded, read_mask

GRADIENT = np.stack(np.meshgrid(np.arange(48), np.arange(32), indexing="xy"), axis=-1)
RGB = np.concatenate([GRADIENT * 5, np.full((32, 48, 1), 70)], axis=2).astype(np.uint8)


def test_srgb_becomes_linear_and_clipped_pixels_are_marked(tmp_path: Path) -> None:
    pixels = RGB.copy()
    pixels[3, 4, 1], pixels[5, 6, 0], pixels[7, 8] = 254, 255, 253
    Image.fromarray(pixels).save(tmp_path / "a.png")
    read = PhotoFile(tmp_path / "a.png")()
    np.testing.assert_allclose(read.color_linear, srgb_to_linear(pixels / 255), atol=1e-7)
    assert read.color_linear.dtype == np.float32 and read.mask is None
    assert np.argwhere(read.saturated).tolist() == [[3, 4], [5, 6]]


def test_alpha_is_the_mask_and_colour_stays_straight(tmp_path: Path) -> None:
    alpha = (GRADIENT[..., :1] * 5).astype(np.uint8)
    Image.fromarray(np.concatenate([RGB, alpha], axis=2)).save(tmp_path / "a.png")
    read = PhotoFile(tmp_path / "a.png")()
    assert read.mask is not None
    np.testing.assert_allclose(read.mask, alpha[..., 0] / 255, atol=1e-7)
    np.testing.assert_allclose(read.color_linear, srgb_to_linear(RGB / 255), atol=1e-7)


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_sixteen_bits_are_kept(tmp_path: Path, suffix: str, channels: int) -> None:
    path = tmp_path / f"a{suffix}"
    pixels = np.random.default_rng(0).integers(0, 65535, (8, 6, channels), dtype=np.uint16)
    pixels[0, 0], pixels[0, 1, 0] = 1001, 65300
    assert cv2.imwrite(str(path), pixels[..., [2, 1, 0, 3][:channels]] if channels > 1 else pixels)
    read = PhotoFile(path)()
    np.testing.assert_allclose(read.color_linear, np.broadcast_to(
        srgb_to_linear(pixels[..., :3] / 65535), read.color_linear.shape), atol=1e-6)
    assert read.saturated[0, 1] and not read.saturated[0, 0]
    if channels == 4:
        assert read.mask is not None
        np.testing.assert_allclose(read.mask, pixels[..., 3] / 65535, atol=1e-6)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation_is_applied_when_asked(tmp_path: Path, orientation: int) -> None:
    image = Image.fromarray(RGB)
    exif = image.getexif()
    exif[0x0112] = orientation
    image.save(tmp_path / "a.png", exif=exif)
    upright = np.asarray(ImageOps.exif_transpose(Image.open(tmp_path / "a.png")))
    np.testing.assert_array_equal(read_encoded(tmp_path / "a.png", orient=True), upright)
    assert photo_size(tmp_path / "a.png", orient=True) == (upright.shape[1], upright.shape[0])
    np.testing.assert_array_equal(read_encoded(tmp_path / "a.png"), RGB)


def test_cmyk_palette_and_grey(tmp_path: Path) -> None:
    flat = Image.new("RGB", (16, 16), (200, 100, 50))
    flat.convert("CMYK").save(tmp_path / "c.jpg", quality=100)
    flat.convert("P").save(tmp_path / "p.png")
    flat.convert("L").save(tmp_path / "g.png")
    assert np.abs(read_encoded(tmp_path / "c.jpg")[8, 8].astype(int) - [200, 100, 50]).max() <= 6
    assert read_encoded(tmp_path / "p.png").shape == (16, 16, 3)
    grey = PhotoFile(tmp_path / "g.png")().color_linear
    assert grey.shape == (16, 16, 3) and (grey[..., :1] == grey).all()


def bomb(path: Path, width: int, height: int) -> Path:
    """A PNG of a few hundred bytes that says it is width × height."""

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 99)))
    return path


def test_broken_pictures_are_one_error_that_names_the_file(tmp_path: Path) -> None:
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)).save(tmp_path / "whole.png")
    whole = (tmp_path / "whole.png").read_bytes()
    Image.open(tmp_path / "whole.png").save(tmp_path / "whole.jpg")
    jpeg = (tmp_path / "whole.jpg").read_bytes()
    files = {
        "cut.png": whole[: len(whole) // 2], "cut.jpg": jpeg[: len(jpeg) // 2], "header.png": whole[:20],
        "empty.png": b"", "text.jpg": b"hello", "raw.dng": b"II*\0", "phone.heic": b"\0\0\0\x18ftypheic",
    }  # fmt: skip
    for name, content in files.items():
        (tmp_path / name).write_bytes(content)
    bomb(tmp_path / "large.png", 20000, 10001)
    bomb(tmp_path / "huge.png", 2_000_000_000, 2_000_000_000)
    for name in (*files, "large.png", "huge.png", "missing.png"):
        with pytest.raises(CaptureError) as caught:
            read_encoded(tmp_path / name)
        assert name in str(caught.value) and "\n" not in str(caught.value), name


def test_deep_broken_pictures_too(tmp_path: Path) -> None:
    pixels = np.random.default_rng(0).integers(0, 65535, (64, 64, 3), dtype=np.uint16)
    cv2.imwrite(str(tmp_path / "deep.png"), pixels)
    content = (tmp_path / "deep.png").read_bytes()
    (tmp_path / "deep.png").write_bytes(content[:60])
    with pytest.raises(CaptureError, match=r"deep\.png"):
        read_encoded(tmp_path / "deep.png")


def test_masks_beside_the_picture(tmp_path: Path) -> None:
    soft = (GRADIENT[..., 0] * 5).astype(np.uint8)
    Image.fromarray(soft).save(tmp_path / "m.png")
    np.testing.assert_allclose(read_mask(tmp_path / "m.png", 48, 32), soft / 255, atol=1e-7)
    with pytest.raises(CaptureError, match="48×32"):
        read_mask(tmp_path / "m.png", 48, 33)
    Image.fromarray(RGB).save(tmp_path / "a.png")
    with pytest.raises(CaptureError, match=r"a\.png is 48×32, its camera 50×32"):
        PhotoFile(tmp_path / "a.png", width=50, height=32)()
    read = PhotoFile(tmp_path / "a.png", mask_path=tmp_path / "m.png")()
    assert read.mask is not None and read.mask[0, 10] == np.float32(50 / 255)
