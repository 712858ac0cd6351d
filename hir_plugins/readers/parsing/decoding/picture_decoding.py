"""Decodes photographs of all formats; a file that cannot be decoded is one error that names it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from hir_exporters.files.regular_files import check_regular_file
from hir_exporters.textures.image_files import read_hdr
from hir_exporters.textures.pillow_images import MAX_PIXELS, open_image
from numpy.typing import NDArray

from hir_core.errors import CaptureError, InputError, MissingExtraError
from hir_plugins.readers.parsing.decoding.color_profiles import in_srgb, profile_name

if TYPE_CHECKING:
    from PIL import Image

_LINEAR_SUFFIXES = (".exr", ".hdr")
_RAW_SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".rw2", ".orf")
_HEIF_SUFFIXES = (".heic", ".heif")
_ORIENTATION_TAG = 0x0112


Result = TypeVar("Result")

EncodedPixels = NDArray[Any]
"""(H, W, C): uint8 or uint16 in sRGB, or float32 linear; the dtype depends on the file."""


def photo_size(path: Path, orient: bool = False) -> tuple[int, int]:
    """Width and height of a photograph, from its header; a file that is no image raises `CaptureError`."""
    if path.suffix.lower() in (*_LINEAR_SUFFIXES, *_RAW_SUFFIXES):
        pixels = read_encoded(path, orient)
        return pixels.shape[1], pixels.shape[0]
    with _pillow(path) as image:
        width, height = image.size
        turned = orient and _orientation(path, image) in (5, 6, 7, 8)
    return (height, width) if turned else (width, height)


def read_encoded(path: Path, orient: bool = False) -> EncodedPixels:
    """Pixels (H, W, C): uint8 or uint16 in sRGB, or float32 linear (.exr, .hdr, raw); C = 1, 2, 3 or 4.

    Colours of 8 bits with another profile than sRGB are converted; with 16 bits they raise `CaptureError`.
    """
    suffix = path.suffix.lower()
    if suffix in _LINEAR_SUFFIXES:
        try:
            return read_hdr(path)
        except InputError as error:
            raise CaptureError(str(error)) from None
    if suffix in _RAW_SUFFIXES:
        return _read_raw(path)
    with _pillow(path) as image:
        deep = _has_sixteen_bit_color(path, image)
        orientation = _orientation(path, image) if orient else 1
        pixels = None if deep else _decode_or_refuse(path, lambda: _decoded(image))
        if deep and (profile := _decode_or_refuse(path, lambda: profile_name(image))):
            raise CaptureError(
                f"{path} has 16 bits per channel in the colour profile {profile!r}, which is not converted; export the "
                "photographs in sRGB, or with 8 bits per channel"
            )
    if pixels is None:
        pixels = _read_sixteen_bit_color(path)
    return _apply_orientation(pixels, orientation)


def decode_picture(content: bytes, name: str) -> EncodedPixels:
    """Pixels (H, W, C) of an image of 8 bits in memory, in sRGB; `name` stands in messages."""
    try:
        with open_image(content, name=name) as image:
            return _decode_or_refuse(name, lambda: _decoded(image))
    except InputError as error:
        raise CaptureError(str(error)) from None


def _pillow(path: Path) -> Image.Image:
    """An opened image of an allowed size; its pixels are not decoded yet."""
    if path.suffix.lower() in _HEIF_SUFFIXES:
        try:
            from pillow_heif import register_heif_opener
        except ImportError:
            raise CaptureError(
                f"{path} is a HEIC image; install its reader with: pip install pillow-heif, or save the photographs "
                "as JPEG"
            ) from None
        register_heif_opener()
    try:
        return open_image(path)
    except InputError as error:
        raise CaptureError(str(error)) from None


def _orientation(path: Path, image: Image.Image) -> int:
    """The EXIF orientation, 1 if there is none. For a PNG Pillow decodes the pixels, which may be damaged."""
    return int(_decode_or_refuse(path, lambda: image.getexif().get(_ORIENTATION_TAG, 1)))


def _decoded(image: Image.Image) -> EncodedPixels:
    image.load()
    if image.mode in ("I;16", "I;16L", "I;16B", "I"):
        return np.clip(np.asarray(image.convert("I")), 0, 65535).astype(np.uint16)[..., None]
    if image.mode == "F":
        pixels = np.asarray(image, dtype=np.float32)
        if not np.isfinite(pixels).all():
            raise ValueError("it contains NaN or infinite values")
        return pixels[..., None]
    if image.mode not in ("L", "LA", "RGB", "RGBA"):
        transparent = image.mode in ("PA", "RGBa", "La") or "transparency" in image.info
        image = image.convert("RGBA" if transparent else "RGB")
    pixels = np.asarray(in_srgb(image))
    return pixels[..., None] if pixels.ndim == 2 else pixels


def _has_sixteen_bit_color(path: Path, image: Image.Image) -> bool:
    """Whether the header says 16 bits per channel: Pillow reads such colour images at 8 bits without a warning."""
    if image.format == "PNG":
        with path.open("rb") as stream:
            header = stream.read(26)
        return len(header) == 26 and header[24] == 16 and header[25] in (2, 4, 6)
    if image.format == "TIFF":
        tags: Mapping[int, Any] = image.tag_v2  # type: ignore[attr-defined] # only of Pillow's TIFF images
        bits = tags.get(258, (8,))
        samples = tags.get(277, 1)
        return samples > 1 and max(bits if isinstance(bits, tuple) else (bits,)) == 16
    return False


def _read_sixteen_bit_color(path: Path) -> EncodedPixels:
    try:
        import cv2
    except ImportError:
        raise MissingExtraError(
            f"{path} has 16 bits per channel, which needs opencv; install it with: pip install 'hir[reconstruct]'"
        ) from None
    pixels = _decode_or_refuse(path, lambda: cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED))
    if pixels is None:
        raise CaptureError(f"{path} is damaged; export the image again or remove it")
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if pixels.shape[2] >= 3:  # OpenCV's order is BGR
        pixels = pixels[..., [2, 1, 0, 3][: pixels.shape[2]]]
    return np.ascontiguousarray(pixels)


def _read_raw(path: Path) -> EncodedPixels:
    try:
        import rawpy
    except ImportError:
        raise CaptureError(
            f"{path} is a raw photograph; install its reader with: pip install rawpy, or convert all photographs with "
            "the "
            "same settings to JPEG or 16-bit TIFF"
        ) from None
    try:
        check_regular_file(path)
    except InputError as error:
        raise CaptureError(str(error)) from None
    with _decode_or_refuse(path, lambda: rawpy.imread(str(path))) as raw:
        sizes = raw.sizes
        if sizes.raw_width * sizes.raw_height > MAX_PIXELS:
            raise CaptureError(
                f"{path} is {sizes.raw_width}×{sizes.raw_height}, more than {MAX_PIXELS} pixels; reduce it"
            )
        developed = _decode_or_refuse(
            path, lambda: raw.postprocess(gamma=(1, 1), no_auto_bright=True, output_bps=16, use_camera_wb=True)
        )
    return np.asarray(developed, dtype=np.float32) / np.float32(65535)


def _decode_or_refuse(path: Path | str, decode: Callable[[], Result]) -> Result:
    try:
        return decode()
    except Exception as error:  # decoders raise many types on damaged images
        reason = error.args[0] if error.args else error
        text = reason.decode(errors="replace") if isinstance(reason, bytes) else error  # LibRaw's are bytes
        raise CaptureError(f"{path} is damaged ({text}); export the image again or remove it") from None


def _apply_orientation(pixels: EncodedPixels, orientation: int) -> EncodedPixels:
    """The image (H, W, C) in display orientation, from the EXIF orientation 1…8 (JEITA CP-3451, tag 274)."""
    if orientation in (5, 6, 7, 8):
        pixels = pixels.swapaxes(0, 1)
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return pixels
