"""KTX2 images of Basis Universal, by the npm package ktx2-encoder in a process of node.

The package is used from the folder that the environment variable HIR_NODE_MODULES names, and from nowhere else: a
`node_modules` in the working folder may come with a stranger's file. Node gets the pixels through a pipe: no files, no
network.
"""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
from pathlib import Path
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import ExportError, HirError, InputError

IDENTIFIER: Final = b"\xabKTX 20\xbb\r\n\x1a\n"
"""First bytes of a KTX2 file."""

MODULES_VARIABLE: Final = "HIR_NODE_MODULES"
"""Environment variable with the folder that has the npm package."""

Kind = Literal["color", "linear", "normal"]
"""What an image holds: sRGB colour, linear values or a normal map. Mipmaps are filtered accordingly."""

_PACKAGE: Final = "ktx2-encoder"
_SCRIPT: Final = Path(__file__).with_name("ktx2.mjs")
_SECONDS: Final = 600
_MAX_PIXELS: Final = 12 << 20  # the encoder's own limit
_HEADER_BYTES: Final = 80
_SIZE_OFFSET: Final = 20
_BLOCK: Final = 4
"""KHR_texture_basisu demands that both sides are multiples of it."""


def encode_ktx2(pixels: NDArray[np.uint8], kind: Kind, quality: int) -> bytes:
    """A KTX2 file with mipmaps of 8-bit pixels (H, W, C), whose sides are multiples of 4.

    `quality` from 1 to 100 is that of ETC1S; 0 is UASTC with Zstandard, larger and more accurate. Raises `ExportError`
    where node, the package or memory is missing and where the image is too large.
    """
    height, width = pixels.shape[:2]
    assert height % _BLOCK == 0 and width % _BLOCK == 0, (height, width)
    if height * width > _MAX_PIXELS:
        raise ExportError(
            f"an image has {width} × {height} pixels, and the KTX2 encoder takes {_MAX_PIXELS >> 20} million at most; "
            "set max_texture_size=2048"
        )
    level = 0 if quality == 0 else max(1, round(2.55 * quality))
    try:
        return _run(["encode", str(width), str(height), kind, str(level)], _rgba(pixels).tobytes())
    except Ktx2Error as error:
        raise ExportError(f"image_format 'ktx2': {error}") from error


def decode_ktx2(data: bytes) -> NDArray[np.uint8]:
    """Pixels (H, W, 4) of the finest level. Raises `InputError` where they cannot be decoded."""
    check_ktx2(data, "an image")
    try:
        answer = _run(["decode"], data)
    except Ktx2Error as error:
        raise InputError(f"a KTX2 image was not read: {error}") from error
    width, height = (int(side) for side in np.frombuffer(answer, "<u4", 2))
    return np.frombuffer(answer, np.uint8, offset=8).reshape(height, width, 4)


def check_ktx2(data: bytes, name: str) -> None:
    """Raises `InputError` where the header names no image of a size that is read."""
    width, height = struct.unpack_from("<2I", data, _SIZE_OFFSET) if len(data) >= _HEADER_BYTES else (0, 0)
    if not 0 < width * height <= _MAX_PIXELS:
        raise InputError(
            f"{name} is a KTX2 image of {width} x {height} pixels; from 1 to {_MAX_PIXELS} in all are read: encode it "
            "again"
        )


def block_size(size: tuple[int, int]) -> tuple[int, int]:
    """The next larger height and width that are multiples of 4."""
    height, width = (-(-side // _BLOCK) * _BLOCK for side in size)
    return height, width


def require_encoder() -> None:
    """Raises `ExportError` where node or the npm package is missing."""
    try:
        _command()
    except Ktx2Error as error:
        raise ExportError(f"image_format 'ktx2': {error}") from error


class Ktx2Error(HirError):
    """Node, its package or the image is at fault; callers say what they wanted to do."""


def _command() -> list[str]:
    node = shutil.which("node")
    if node is None:
        raise Ktx2Error("node is not installed (version 18 or newer), which runs the npm package ktx2-encoder")
    folder = os.environ.get(MODULES_VARIABLE, "")
    module = Path(folder).absolute() / _PACKAGE / "dist" / "basis" / "basis_encoder.js"
    if not folder or not module.is_file():
        where = f"{folder} has no npm package {_PACKAGE}" if folder else f"the npm package {_PACKAGE} is not there"
        raise Ktx2Error(
            f"{where}; run `npm install {_PACKAGE}@0.6` and set the environment variable {MODULES_VARIABLE} to the "
            "folder node_modules that this makes"
        )
    return [node, str(_SCRIPT), str(module)]


def _run(arguments: list[str], data: bytes) -> bytes:
    try:
        process = subprocess.run(
            [*_command(), *arguments], input=data, capture_output=True, timeout=_SECONDS, check=False
        )
    except subprocess.TimeoutExpired:
        raise Ktx2Error(f"node did not finish within {_SECONDS} s; set a smaller max_texture_size") from None
    if process.returncode:
        lines = process.stderr.decode(errors="replace").strip().splitlines()
        message = next((line for line in lines if "Error" in line), f"exit code {process.returncode}")
        raise Ktx2Error(f"node failed with {message[:300]}")
    return process.stdout


def _rgba(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Grey, grey with alpha, RGB or RGBA as RGBA."""
    height, width, channels = pixels.shape
    result = np.full((height, width, 4), 255, np.uint8)
    result[..., :3] = pixels[..., :3] if channels >= 3 else pixels[..., :1]
    if channels in (2, 4):
        result[..., 3] = pixels[..., -1]
    return result
