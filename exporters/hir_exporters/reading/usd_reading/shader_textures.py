"""The values of a UsdUVTexture: its picture in its colour space, with scale and bias."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError
from hir_exporters.reading.texture_decoding import Pixels, decoded_pixels, linear_color, unit_values
from hir_exporters.reading.usd_reading.shader_inputs import input_value
from hir_exporters.reading.usd_reading.usd_containment import check_inside
from hir_exporters.textures.image_files import read_hdr

if TYPE_CHECKING:
    from pxr import UsdShade

_CHANNELS: Final = {"rgb": slice(0, 3), "r": slice(0, 1), "g": slice(1, 2), "b": slice(2, 3), "a": slice(3, 4)}
_HDR_MAGIC: Final = (b"v/1\x01", b"#?")


def texture_values(node: UsdShade.Shader, output: str, is_color: bool, path: Path) -> NDArray[np.floating]:
    """Values (H, W, 3) of the output `rgb`, or (H, W) of one channel, linear.

    The colour space `auto`, which is the default, is sRGB for a colour in a picture of 8 bits with 3 or 4 channels,
    and linear otherwise. Raises `InputError` for pictures that are missing or outside of the file's folder.
    """
    kind = node.GetIdAttr().Get()
    if kind != "UsdUVTexture" or output not in _CHANNELS:
        raise InputError(
            f"{path}: the output {output} of {node.GetPath()} ({kind}) is not read; bake it to a texture first"
        )
    pixels = _picture(node, path)
    decode = linear_color if _is_srgb(node, pixels, is_color and output != "a", path) else unit_values
    chosen = _CHANNELS[output]
    if output == "a" and pixels.shape[2] not in (2, 4):
        values: NDArray[np.floating] = np.ones((*pixels.shape[:2], 1), np.float32)
    elif pixels.shape[2] < 3:  # grey, perhaps with alpha
        grey = pixels[..., 1:2] if output == "a" else pixels[..., :1]
        values = np.repeat(decode(grey), 3 if output == "rgb" else 1, axis=2)
    else:
        values = decode(pixels[..., chosen])
    for name, neutral, operation in (("scale", 1.0, np.multiply), ("bias", 0.0, np.add)):
        operand = np.asarray(input_value(node, name, path, (neutral,) * 4), np.float32)[chosen]
        if (operand != neutral).any():
            values = operation(values, operand, out=values)
    return np.asarray(values if output == "rgb" else values[..., 0])


def _is_srgb(node: UsdShade.Shader, pixels: Pixels, is_color: bool, path: Path) -> bool:
    space = str(input_value(node, "sourceColorSpace", path, "auto"))
    if space not in ("auto", "raw", "sRGB"):
        raise InputError(f"{path}: sourceColorSpace of {node.GetPath()} is {space!r}; it is raw, sRGB or auto")
    return space == "sRGB" or (space == "auto" and is_color and pixels.dtype == np.uint8 and pixels.shape[2] >= 3)


def _picture(node: UsdShade.Shader, path: Path) -> Pixels:
    from pxr import Ar

    file: Any = input_value(node, "file", path)
    if file is None or not file.path:
        raise InputError(f"{path}: the texture {node.GetPath()} names no file; connect one, or remove the texture")
    if "<UDIM>" in file.path:
        raise InputError(f"{path} names {file.path!r}, tiles of a texture; bake them to one texture first")
    if not file.resolvedPath:
        raise InputError(f"{path} names {file.path!r}, which does not exist; put the file beside it")
    check_inside(path, file.resolvedPath, file.path)
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file.resolvedPath))
    if asset is None:
        raise InputError(f"{path} names {file.path!r}, which cannot be opened; put the file beside it")
    data = bytes(asset.GetBuffer())
    if data.startswith(_HDR_MAGIC) and not Ar.IsPackageRelativePath(file.resolvedPath):
        return read_hdr(file.resolvedPath)
    try:
        return decoded_pixels(data)
    except InputError as error:
        raise InputError(f"{path} names {file.path!r}: {error}") from error
