"""Reads and writes image files: PNG, JPEG and others in their own encoding; Radiance and OpenEXR as linear float32.

Readers check the size in the header before they decode, refuse images of more than `max_pixels`, and name the file in
every error. Writers give the same bytes for the same pixels; when they fail, no file is written.
"""

from __future__ import annotations

import io
import os
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import ExportError, InputError
from hir_exporters.files.atomic import atomic_path, write_bytes_atomic
from hir_exporters.files.native_output import suppress_native_output
from hir_exporters.files.regular_files import check_regular_file
from hir_exporters.textures.ktx2 import IDENTIFIER, check_ktx2, decode_ktx2
from hir_exporters.textures.pillow_images import MAX_PIXELS, open_image
from hir_exporters.textures.pillow_pixels import image_codes
from hir_exporters.textures.png_encoding import png_bytes
from hir_exporters.textures.rgbe import RgbeError, decode_rgbe, encode_rgbe, read_size

if TYPE_CHECKING:
    from PIL.Image import Image

_EXR_LAYOUTS: Final = {1: "Y", 3: "RGB", 4: "RGBA"}


def read_ldr(path: str | os.PathLike[str], max_pixels: int = MAX_PIXELS) -> NDArray[np.float32]:
    """Pixels (H, W, C) in [0, 1], in the file's own encoding (nearly always sRGB); C is 1 grey, 2 grey+alpha, 3 or 4.

    The EXIF orientation is not applied. Palettes and CMYK become RGB. 16-bit grey keeps 16 bits; Pillow reads 16-bit
    colour as 8 bits. Raises `InputError` naming the file.
    """
    source = check_regular_file(path)
    try:
        with open_image(source, max_pixels) as image, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata that is not used
            image.load()
            return _pillow_pixels(image)
    except InputError:
        raise
    except Exception as error:  # Pillow's decoders raise many types on broken data
        raise InputError(f"{source} is a broken image ({error}); write it again") from error


def read_rgb8(source: Path | bytes, max_pixels: int = MAX_PIXELS, name: str = "") -> NDArray[np.uint8]:
    """Codes (H, W, 3) of 8 bits in the image's own encoding, without alpha; of a file, or of the bytes of one.

    KTX2 is read from bytes alone. `name` stands in messages, by default the path. Raises `InputError` naming it.
    """
    name = name or str(source)
    if isinstance(source, bytes) and source.startswith(IDENTIFIER):
        check_ktx2(source, name)
        return decode_ktx2(source)[..., :3]
    try:
        with open_image(source, max_pixels, name) as image, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about metadata that is not used
            image.load()
            if image.mode == "F" or image.mode.startswith("I"):  # Pillow would clip them to 8 bits
                return quantize(_pillow_pixels(image)).astype(np.uint8).repeat(3, axis=2)
            return np.asarray(image.convert("RGB"))
    except InputError:
        raise
    except Exception as error:  # Pillow's decoders raise many types on broken data
        raise InputError(f"{name} is a broken image ({error}); write it again") from error


def read_hdr(path: str | os.PathLike[str], max_pixels: int = MAX_PIXELS) -> NDArray[np.float32]:
    """Linear pixels (H, W, 3), row 0 at the top, of a .hdr or .exr file; its first bytes decide which it is.

    One channel (Y) is repeated three times; alpha and further layers are ignored. Raises `InputError` naming the file,
    also where a pixel is NaN or infinite.
    """
    source = check_regular_file(path)
    with _opened(source) as stream:
        magic = stream.read(4)
    if magic == b"v/1\x01":
        return read_exr(source, max_pixels, channels=3)
    if magic.startswith(b"#?"):
        return _read_radiance(source, max_pixels)
    raise InputError(f"{source} is neither a Radiance .hdr nor an OpenEXR file")


def read_exr(
    path: str | os.PathLike[str], max_pixels: int = MAX_PIXELS, channels: int | None = None
) -> NDArray[np.float32]:
    """Pixels (H, W, C) of an OpenEXR file's first part: C = 1, 3 or 4 as stored, or exactly `channels` = 1 or 3.

    Grey is repeated where 3 channels are required. Raises `InputError` naming the file.
    """
    import OpenEXR

    source = check_regular_file(path)
    try:
        header = OpenEXR.File(str(source), header_only=True).header()
        low, high = header["dataWindow"]
        width, height = (int(edge) for edge in high.astype(np.int64) - low.astype(np.int64) + 1)
        _check_size(source, height, width, max_pixels)
        channels_of_file = len(header["channels"])
        if height * width * channels_of_file > 4 * max_pixels:  # the binding reads all of them
            raise InputError(f"{source} has {channels_of_file} channels of {width} x {height}; save RGB or RGBA alone")
        if any((c.xSampling, c.ySampling) != (1, 1) for c in header["channels"] if c.name in "RGBAY"):
            raise InputError(f"{source} has subsampled channels; save it with full-size channels")
        with suppress_native_output():  # OpenEXR prints a line for each missing row of a truncated file
            planes = _exr_planes(str(source))
    except InputError:
        raise
    except Exception as error:  # the binding raises RuntimeError, ValueError and KeyError on broken files
        raise InputError(f"{source} is a broken OpenEXR file ({error}); write it again") from error
    layout = next((layout for layout in ("RGBA", "RGB", "Y") if layout in planes), None)
    if layout is None:
        raise InputError(f"{source} has the channels {', '.join(sorted(planes)) or 'none'}; R, G, B or Y are needed")
    if channels == 1 and layout != "Y":
        raise InputError(f"{source} has colour where one channel (Y) is expected")
    pixels = planes[layout].astype(np.float32, copy=False).reshape(height, width, len(layout))
    if channels == 3:
        pixels = pixels.repeat(3, axis=-1) if layout == "Y" else pixels[..., :3]
    return _finite(source, np.ascontiguousarray(pixels))


def encode_png(image: NDArray[np.generic], bits: int = 8) -> bytes:
    """PNG bytes of (H, W) or (H, W, C), C = 1..4: uint8 and uint16 unchanged, floats in [0, 1] rounded to `bits`.

    No transfer function is applied: encode sRGB first. Raises `ExportError` for other shapes and types and for
    non-finite values.
    """
    pixels = quantize(image, bits) if np.issubdtype(image.dtype, np.floating) else image
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if (
        pixels.ndim != 3
        or not 1 <= pixels.shape[2] <= 4
        or pixels.size == 0
        or pixels.dtype not in (np.uint8, np.uint16)
    ):
        raise ExportError(f"a PNG needs (H, W, 1 to 4) of uint8, uint16 or float, not {image.shape} of {image.dtype}")
    if pixels.dtype == np.uint8:
        return png_bytes(pixels.astype(np.uint8, copy=False))
    return png_bytes(pixels.astype(np.uint16, copy=False))


def quantize(image: NDArray[np.generic], bits: int = 8) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Floats clipped to [0, 1] and rounded to the nearest of 2^bits codes, bits 8 or 16; NaN raises `ExportError`."""
    if bits not in (8, 16):
        raise ExportError(f"images are written with 8 or 16 bits, not {bits}")
    if not np.isfinite(image).all():
        raise ExportError("an image to be written contains NaN or infinite values")
    largest = (1 << bits) - 1
    scaled = np.clip(image, 0.0, 1.0) * np.asarray(largest, image.dtype) + np.asarray(0.5, image.dtype)
    return scaled.astype(np.uint8 if bits == 8 else np.uint16)


def write_png(path: str | os.PathLike[str], image: NDArray[np.generic], bits: int = 8) -> None:
    """Writes `encode_png` into a file."""
    write_bytes_atomic(path, encode_png(image, bits))


def write_exr(path: str | os.PathLike[str], image: NDArray[np.generic]) -> None:
    """(H, W), (H, W, 1), (H, W, 3) or (H, W, 4) as float32 OpenEXR, ZIP compressed; one channel is named Y."""
    import OpenEXR

    pixels = np.asarray(image, dtype=np.float32)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.ndim != 3 or pixels.shape[2] not in _EXR_LAYOUTS or pixels.size == 0:
        raise ExportError(f"{path}: an EXR needs (H, W) or (H, W, 1, 3 or 4), not {image.shape}")
    if not np.isfinite(pixels).all():
        raise ExportError(f"{path}: the image contains NaN or infinite values")
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    layout = _EXR_LAYOUTS[pixels.shape[2]]
    channels = {name: np.ascontiguousarray(pixels[..., index]) for index, name in enumerate(layout)}
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header, channels).write(str(temporary))
        except RuntimeError as error:
            raise OSError(str(error)) from error


def write_hdr(path: str | os.PathLike[str], radiance: NDArray[np.generic]) -> None:
    """Finite radiance (H, W, 3) as Radiance RGBE; negative values become 0."""
    pixels = np.asarray(radiance, dtype=np.float64)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or pixels.size == 0:
        raise ExportError(f"{path}: a .hdr needs radiance (H, W, 3), not {pixels.shape}")
    if not np.isfinite(pixels).all():
        raise ExportError(f"{path}: the radiance contains NaN or infinite values")
    write_bytes_atomic(path, encode_rgbe(pixels))


def _opened(source: Path) -> io.BufferedReader:
    try:
        return open(source, "rb")
    except OSError as error:
        raise InputError(f"{source} cannot be opened: {error.strerror}") from error


def _check_size(source: Path, height: int, width: int, max_pixels: int) -> None:
    if height <= 0 or width <= 0:
        raise InputError(f"{source} has no pixels")
    if height * width > max_pixels:
        raise InputError(f"{source} is {width} x {height}, more than {max_pixels} pixels; make it smaller")


def _exr_planes(source: str) -> dict[str, NDArray[np.generic]]:
    """Pixels (H, W) of each channel of an OpenEXR file, RGB or RGBA as one (H, W, 3 or 4)."""
    import OpenEXR

    try:
        joined = {name: channel.pixels for name, channel in OpenEXR.File(source).channels().items()}
    except ValueError:  # the binding cannot join channels of different types
        joined = {}
    # Before version 3.5 the binding joined them wrongly, but only where the result is not float32.
    if joined and all(pixels.dtype == np.float32 for pixels in joined.values()):
        return joined
    channels = OpenEXR.File(source, separate_channels=True).channels()
    planes = {name: channel.pixels for name, channel in channels.items()}
    for layout in ("RGBA", "RGB"):
        if all(name in planes for name in layout):
            return {layout: np.stack([planes[name].astype(np.float32) for name in layout], axis=-1)}
    return planes


def _finite(source: Path, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    with np.errstate(over="ignore", invalid="ignore"):
        if np.isfinite(pixels.sum()):  # one pass over most images; a sum may overflow without a bad pixel
            return pixels
    bad = pixels.size - int(np.isfinite(pixels).sum())
    if bad:
        raise InputError(f"{source} contains {bad} NaN or infinite values; replace them and write it again")
    return pixels


def _read_radiance(source: Path, max_pixels: int) -> NDArray[np.float32]:
    try:
        with _opened(source) as stream:
            head = stream.read(1 << 17)
            _check_size(source, *read_size(head), max_pixels)
            return decode_rgbe(head + stream.read())
    except RgbeError as error:
        raise InputError(f"{source} is a broken Radiance file: {error}") from error


def _pillow_pixels(image: Image) -> NDArray[np.float32]:
    pixels = image_codes(image)
    return pixels.astype(np.float32) / np.float32(255) if pixels.dtype == np.uint8 else pixels
