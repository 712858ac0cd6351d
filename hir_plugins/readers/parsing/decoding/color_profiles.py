"""Colour profiles (ICC) of photographs: phones write Display P3, cameras Adobe RGB; fits need sRGB."""

from __future__ import annotations

from functools import lru_cache
from io import BytesIO
from typing import TYPE_CHECKING, Final

import numpy as np
from PIL import Image, ImageCms

if TYPE_CHECKING:
    from typing import Any

MAX_PROFILE_BYTES: Final = 4 << 20
"""Largest accepted profile; those of cameras and phones have 0.5 to 10 kB."""
TESTED_LEVELS: Final = 7
"""Levels of each channel whose colours distinguish a profile from sRGB."""
MAX_CHANGE: Final = 3
"""Change of 8-bit values up to which a profile counts as sRGB: profiles of sRGB differ by rounding."""


def profile_name(image: Image.Image) -> str:
    """The description of a colour image's profile; empty where it has none, or one whose colours are those of sRGB.

    `ValueError` for a profile that is damaged.
    """
    content = image.info.get("icc_profile")
    if not isinstance(content, bytes) or not content or not {"R", "G", "B"} <= set(image.getbands()):
        return ""
    return _foreign_profile(content)


def in_srgb(image: Image.Image) -> Image.Image:
    """An image of 8 bits with its colours in sRGB; the same object where it has no other profile.

    Colours outside sRGB are clipped (relative colorimetric). Alpha stays. `ValueError` for a profile that is damaged.
    """
    if not profile_name(image):
        return image
    converted = _applied(image.info["icc_profile"], image.convert("RGB"))
    if "A" in image.getbands():
        converted.putalpha(image.getchannel("A"))
    return converted


@lru_cache(maxsize=16)
def _foreign_profile(content: bytes) -> str:
    """The description of an RGB profile that changes some of a few hundred colours; empty for one that changes none,
    and for one of other channels, such as CMYK.
    """
    if _profile(content).profile.xcolor_space.strip() != "RGB":
        return ""
    levels = np.linspace(0, 255, TESTED_LEVELS).round().astype(np.uint8)
    cube = np.stack(np.meshgrid(levels, levels, levels, indexing="ij"), axis=-1).reshape(1, -1, 3)
    changed = np.asarray(_applied(content, Image.fromarray(cube))).astype(int) - cube
    if np.abs(changed).max() <= MAX_CHANGE:
        return ""
    name = ImageCms.getProfileDescription(_profile(content)).strip()
    return "".join(character for character in name if character.isprintable())[:80] or "without a name"


def _applied(content: bytes, image: Image.Image) -> Image.Image:
    try:
        converted = ImageCms.applyTransform(image, _transform(content))
    except (ImageCms.PyCMSError, OSError, TypeError) as error:
        raise ValueError(f"its colour profile cannot be read: {error}") from None
    assert converted is not None  # only `inPlace` gives None
    return converted


@lru_cache(maxsize=16)
def _transform(content: bytes) -> Any:
    srgb = ImageCms.createProfile("sRGB")
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    return ImageCms.buildTransform(_profile(content), srgb, "RGB", "RGB", intent)


def _profile(content: bytes) -> ImageCms.ImageCmsProfile:
    if len(content) > MAX_PROFILE_BYTES:
        raise ValueError(f"its colour profile has more than {MAX_PROFILE_BYTES >> 20} MB")
    try:
        return ImageCms.ImageCmsProfile(BytesIO(content))
    except (ImageCms.PyCMSError, OSError, TypeError) as error:
        raise ValueError(f"its colour profile cannot be read: {error}") from None
