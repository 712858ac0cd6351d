"""The setting that names a light: a file, and a factor of its radiance."""

from __future__ import annotations

import math
from pathlib import Path

from hir_core.errors import InputError


def parse_light_file(text: str) -> tuple[Path, float]:
    """Path and strength of `FILE` or `FILE*STRENGTH`; the strength is 1 where none is given.

    `InputError` where the strength is not a finite number of at least 0.
    """
    name, star, strength = text.rpartition("*")
    if not star:
        return Path(text), 1.0
    try:
        value = float(strength)
    except ValueError:
        raise InputError(f"{text!r}: the strength after * must be a number, such as studio.hdr*0.5") from None
    if not (math.isfinite(value) and value >= 0):
        raise InputError(f"{text!r}: the light's strength must be a finite number of at least 0")
    return Path(name), value
