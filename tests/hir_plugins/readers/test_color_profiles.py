"""Photographs in other colour spaces than sRGB."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image, ImageCms

from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.decoding.color_profiles import MAX_PROFILE_BYTES
from hir_plugins.readers.parsing.decoding.picture_decoding import read_encoded

P3 = np.array([[0.680, 0.320], [0.265, 0.690], [0.150, 0.060]])
"""Chromaticities (x, y) of the primaries of Display P3 (SMPTE EG 432-1), whose white is that of sRGB."""
SRGB = np.array([[0.64, 0.33], [0.30, 0.60], [0.15, 0.06]])
ADOBE = np.array([[0.64, 0.33], [0.21, 0.71], [0.15, 0.06]])
WHITE = np.array([0.3127, 0.3290])
D50 = np.array([0.9642, 1.0, 0.8249])


def to_xyz(primaries: np.ndarray, white: np.ndarray = WHITE) -> np.ndarray:
    """3×3 from linear RGB to XYZ."""
    columns = np.array([[x / y, 1, (1 - x - y) / y] for x, y in primaries]).T
    x, y = white
    return columns * np.linalg.solve(columns, [x / y, 1, (1 - x - y) / y])


def profile(primaries: np.ndarray, gamma: float, name: str = "made") -> bytes:
    """A matrix profile of ICC version 2 with one exponent (ICC.1:2001-04)."""
    bradford = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
    x, y = WHITE
    scale = (bradford @ D50) / (bradford @ [x / y, 1, (1 - x - y) / y])
    matrix = np.linalg.inv(bradford) @ np.diag(scale) @ bradford @ to_xyz(primaries)

    def xyz(values: np.ndarray) -> bytes:
        return b"XYZ \0\0\0\0" + b"".join(struct.pack(">i", round(v * 65536)) for v in values)

    text = name.encode() + b"\0"
    described = b"desc\0\0\0\0" + struct.pack(">I", len(text)) + text + bytes(8 + 3 + 67)
    curve = b"curv\0\0\0\0" + struct.pack(">IH", 1, round(gamma * 256)) + bytes(2)
    tags = {b"desc": described, b"wtpt": xyz(D50), b"cprt": b"text\0\0\0\0made\0"}
    tags |= {key: xyz(matrix[:, i]) for i, key in enumerate((b"rXYZ", b"gXYZ", b"bXYZ"))}
    tags |= {key: curve for key in (b"rTRC", b"gTRC", b"bTRC")}
    start, table, data = 128 + 4 + 12 * len(tags), b"", b""
    for key, content in tags.items():
        table += key + struct.pack(">II", start + len(data), len(content))
        data += content + bytes(-len(content) % 4)
    size = start + len(data)
    header = struct.pack(">I", size) + b"lcms" + bytes.fromhex("02400000") + b"mntrRGB XYZ " + bytes(12) + b"acsp"
    header += bytes(28) + b"".join(struct.pack(">i", round(v * 65536)) for v in D50) + bytes(48)
    assert len(header) == 128
    return header + struct.pack(">I", len(tags)) + table + data


def encoded(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


@pytest.fixture
def picture() -> np.ndarray:
    """Muted colours, which both spaces have."""
    return np.random.default_rng(0).integers(70, 190, (24, 32, 3)).astype(np.uint8)


@pytest.mark.parametrize(("primaries", "gamma"), [(P3, 2.2), (ADOBE, 2.19921875), (SRGB, 1.8)])
def test_colours_of_another_profile_are_converted(
    primaries: np.ndarray, gamma: float, picture: np.ndarray, tmp_path: Path
) -> None:
    """The formula in float64 beside LittleCMS; alpha stays."""
    content = profile(primaries, gamma)
    alpha = np.arange(24 * 32, dtype=np.uint8).reshape(24, 32)
    Image.fromarray(np.dstack([picture, alpha])).save(tmp_path / "a.png", icc_profile=content)
    found = read_encoded(tmp_path / "a.png")
    linear = (picture / 255.0) ** gamma @ (np.linalg.inv(to_xyz(SRGB)) @ to_xyz(primaries)).T
    expected = 255 * encoded(linear.clip(0, 1))
    assert np.array_equal(found[..., 3], alpha)
    assert np.abs(found[..., :3] - expected).max() < 2
    assert np.abs(picture - expected).max() > 10


def test_srgb_and_pictures_without_a_profile_stay(picture: np.ndarray, tmp_path: Path) -> None:
    srgb = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    for name, content in (("plain.png", None), ("srgb.png", srgb)):
        Image.fromarray(picture).save(tmp_path / name, icc_profile=content)
        assert np.array_equal(read_encoded(tmp_path / name), picture)
    grey = picture[..., 0]
    Image.fromarray(grey).save(tmp_path / "mask.png", icc_profile=profile(P3, 1.8))
    assert np.array_equal(read_encoded(tmp_path / "mask.png")[..., 0], grey)


def test_profiles_of_other_channels_are_left_out(picture: np.ndarray, tmp_path: Path) -> None:
    """Such as a CMYK photograph's, which Pillow converts without it."""
    content = profile(P3, 1.8).replace(b"mntrRGB XYZ ", b"prtrCMYKXYZ ")
    Image.fromarray(picture).convert("CMYK").save(tmp_path / "a.tif", icc_profile=content)
    assert np.array_equal(read_encoded(tmp_path / "a.tif"), picture)


def test_a_damaged_profile_is_one_sentence(picture: np.ndarray, tmp_path: Path) -> None:
    for name, content in (("cut.jpg", profile(P3, 2.2)[:90]), ("noise.jpg", bytes(range(256)) * 4)):
        Image.fromarray(picture).save(tmp_path / name, icc_profile=content)
        with pytest.raises(CaptureError, match=rf"{name} is damaged .*colour profile"):
            read_encoded(tmp_path / name)
    Image.fromarray(picture).save(tmp_path / "huge.tif", icc_profile=bytes(MAX_PROFILE_BYTES + 1))
    with pytest.raises(CaptureError, match=r"huge\.tif is damaged .*more than 4 MB"):
        read_encoded(tmp_path / "huge.tif")


def test_sixteen_bits_in_another_profile_are_refused(picture: np.ndarray, tmp_path: Path) -> None:
    """OpenCV reads them and leaves the profile out."""
    Image.fromarray(picture).save(tmp_path / "a.tif", icc_profile=profile(ADOBE, 2.2, "Wide"))
    with Image.open(tmp_path / "a.tif") as image:
        content = image.info["icc_profile"]
    deep = tmp_path / "deep.png"
    assert cv2.imwrite(str(deep), picture[..., ::-1].astype(np.uint16) * 257)
    assert np.array_equal(read_encoded(deep), picture.astype(np.uint16) * 257)
    raw = deep.read_bytes()
    deep.write_bytes(raw[:33] + _chunk(b"iCCP", b"made\0\0" + zlib.compress(content)) + raw[33:])
    with pytest.raises(CaptureError, match=r"deep\.png has 16 bits per channel in the colour profile 'Wide'"):
        read_encoded(deep)


def _chunk(kind: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
