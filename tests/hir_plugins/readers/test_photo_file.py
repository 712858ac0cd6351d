"""Photographs as people have them: bit depths, modes, turned, cut off, far too large."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from PIL import Image, ImageOps

from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.decoding.photo_file import PhotoFile, read_mask
from hir_plugins.readers.parsing.decoding.picture_decoding import photo_size, read_encoded

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
    np.testing.assert_allclose(
        read.color_linear, np.broadcast_to(srgb_to_linear(pixels[..., :3] / 65535), read.color_linear.shape), atol=1e-6
    )
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
        "cut.png": whole[: len(whole) // 2],
        "cut.jpg": jpeg[: len(jpeg) // 2],
        "header.png": whole[:20],
        "empty.png": b"",
        "text.jpg": b"hello",
        "raw.dng": b"II*\0",
        "phone.heic": b"\0\0\0\x18ftypheic",
    }
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


def write_dng(path: Path, linear: np.ndarray) -> None:
    """A raw file: a Bayer mosaic (RGGB) of a camera whose colours are linear sRGB, white balance one."""
    import tifffile

    values = np.rint(linear * 65535).astype(np.uint16)
    mosaic = values[..., 1].copy()
    mosaic[0::2, 0::2], mosaic[1::2, 1::2] = values[0::2, 0::2, 0], values[1::2, 1::2, 2]
    to_xyz = [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]]
    matrix = [x for value in np.linalg.inv(to_xyz).ravel() for x in (round(value * 10000), 10000)]
    tags = [
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNG version
        (33421, "H", 2, (2, 2), True),
        (33422, "B", 4, (0, 1, 1, 2), True),  # the mosaic
        (50708, "s", 0, "a camera", True),
        (50721, "2i", 9, matrix, True),
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # neutral
        (50717, "H", 1, 65535, True),  # white
        (50778, "H", 1, 21, True),  # daylight
    ]
    tifffile.imwrite(path, mosaic, photometric=32803, extratags=tags, metadata=None)


def test_raw_files_are_developed_linear(tmp_path: Path) -> None:
    pytest.importorskip("rawpy")
    linear = np.full((64, 96, 3), 0.25)
    linear[:, 48:] = [0.6, 0.3, 0.1]
    write_dng(tmp_path / "a.dng", linear)
    pixels = PhotoFile(tmp_path / "a.dng", None)()
    np.testing.assert_allclose(pixels.color_linear[20:40, 10:30], 0.25, atol=1e-3)
    right = pixels.color_linear[20:40, 60:80].reshape(-1, 3)
    np.testing.assert_allclose(right, np.tile([0.6, 0.3, 0.1], (400, 1)), atol=1e-3)
    (tmp_path / "b.dng").write_bytes((tmp_path / "a.dng").read_bytes()[:300])
    with pytest.raises(CaptureError, match=r"b\.dng is damaged \([A-Z]"):
        PhotoFile(tmp_path / "b.dng", None)()


def test_heic_is_read_as_the_phone_wrote_it(tmp_path: Path) -> None:
    heif = pytest.importorskip("pillow_heif")
    heif.register_heif_opener()
    picture = np.full((48, 64, 3), 60, np.uint8)
    picture[:, 32:] = [200, 120, 40]
    Image.fromarray(picture).save(tmp_path / "a.heic", quality=100)
    pixels = PhotoFile(tmp_path / "a.heic", None)()
    assert pixels.color_linear.shape == (48, 64, 3)
    np.testing.assert_allclose(linear_to_srgb(pixels.color_linear[24, 10]) * 255, [60, 60, 60], atol=3)
    np.testing.assert_allclose(linear_to_srgb(pixels.color_linear[24, 50]) * 255, [200, 120, 40], atol=4)


def test_a_picture_of_two_hundred_megapixels_is_too_large(tmp_path: Path) -> None:
    Image.new("1", (16000, 12600)).save(tmp_path / "a.png")
    with pytest.raises(CaptureError, match=r"a\.png has far more than .* reduce it"):
        PhotoFile(tmp_path / "a.png", None)()
