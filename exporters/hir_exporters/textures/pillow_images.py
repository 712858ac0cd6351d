"""Opens images with Pillow, restricted to the formats that hir reads.

Pillow recognises a format by the content of a file, not by its name, and starts Ghostscript for PostScript. Every image
is therefore opened here, and nowhere else (`tests/architecture/test_image_opening.py`).
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Final

from hir_exporters.errors import InputError
from hir_exporters.files.regular_files import check_regular_file

if TYPE_CHECKING:
    from PIL.Image import Image

MAX_PIXELS: Final = 100_000_000
"""Larger images are refused unless the caller sets another limit."""

FORMATS: Final = ("PNG", "JPEG", "MPO", "TIFF", "WEBP", "BMP", "HEIF", "AVIF")
"""Pillow's names of the formats that are opened. Phones write MPO files that are named .jpg."""


def open_image(source: Path | bytes, max_pixels: int = MAX_PIXELS, name: str = "") -> Image:
    """An opened image of at most `max_pixels`, of one of `FORMATS`; its pixels are not decoded yet.

    `name` stands in messages, by default the path. Raises `InputError` for another format, a larger image, a damaged
    header, and for a path that is not a regular file.
    """
    import PIL.Image

    name = name or (str(source) if isinstance(source, Path) else "an image")
    if isinstance(source, Path):
        check_regular_file(source)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Pillow warns about large images; `max_pixels` decides instead
            image = _opened(source)
    except PIL.UnidentifiedImageError:
        raise InputError(f"{name} is not an image that can be read; save it as PNG, JPEG, TIFF or WebP") from None
    except PIL.Image.DecompressionBombError:
        raise InputError(f"{name} has far more than {max_pixels} pixels; reduce it") from None
    except Exception as error:  # decoders raise many types on damaged headers
        reason = " ".join(str(error).split())
        raise InputError(f"{name} is a damaged image ({reason}); write it again") from error
    if min(image.size) <= 0 or image.width * image.height > max_pixels:
        image.close()
        reason = "has no pixels" if min(image.size) <= 0 else f"more than {max_pixels} pixels; reduce it"
        raise InputError(f"{name} is {image.width} x {image.height}, {reason}")
    return image


def _opened(source: Path | bytes) -> Image:
    """The image by the formats that Pillow registers at once, PNG and JPEG among them, then by all of `FORMATS`.

    Registering all imports some forty modules, which takes longer than opening a PNG.
    """
    import PIL.Image

    PIL.Image.preinit()
    try:
        return _opened_as(source, set(PIL.Image.OPEN))
    except PIL.UnidentifiedImageError:
        PIL.Image.init()
        return _opened_as(source, set(PIL.Image.OPEN))


def _opened_as(source: Path | bytes, registered: set[str]) -> Image:
    import PIL.Image

    known: list[str] = [kind for kind in FORMATS if kind in registered]
    return PIL.Image.open(io.BytesIO(source) if isinstance(source, bytes) else source, formats=known)
