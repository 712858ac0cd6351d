"""Reads untrusted USD files in a subprocess, because OpenUSD aborts the process on some damaged files.

One such abort is "Dereferenced an invalid SdfPrimSpec"; no `except` catches it.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from hir_exporters.errors import InputError
from hir_exporters.files.subprocess_call import Arrays, Limits, SubprocessCrashError, run_in_subprocess
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.reading.readback import ReadBack
from hir_exporters.reading.usd_reading.usd_readback import read_usd
from hir_exporters.usd_library import require_usd

LIMITS: Final = Limits(seconds=300, memory_bytes=8 << 30)
"""A few lines of USD may compose to millions of prims."""

_WARNINGS: Final = "sentences"
"""Name of the array of warnings, which no field of a `ReadBack` has."""


def read_untrusted_usd(path: Path) -> ReadBack:
    """`read_usd` in metres and in a subprocess, which takes 0.5 s more.

    Its warnings are repeated in this process. A file that crashes it raises `InputError`.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist")
    require_usd(path, InputError)
    try:
        target = "hir_exporters.reading.usd_reading.usd_import:read_usd_arrays"
        arrays = run_in_subprocess(target, {"path": os.fspath(path)}, LIMITS)
    except SubprocessCrashError as error:
        raise InputError(
            f"{path} cannot be read as USD: OpenUSD ended without a result ({error}); the file is damaged or too "
            "large, write it again"
        ) from error
    for sentence in arrays.pop(_WARNINGS):
        warnings.warn(str(sentence), stacklevel=3)
    return _read_back(arrays)


def read_usd_arrays(path: object) -> Arrays:
    """Target of the subprocess: the fields of a `ReadBack` as arrays by name, those of surfaces with a prefix, and the
    sentences of warnings.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default", UserWarning)
        back = read_usd(Path(str(path)), in_meters=True)
    sentences = [str(warning.message) for warning in caught if issubclass(warning.category, UserWarning)]
    return {**dict(_named_arrays(back, "")), _WARNINGS: np.asarray(list(dict.fromkeys(sentences)), np.str_)}


def _named_arrays(value: ReadBack | MetallicSurface | SpecularSurface, prefix: str) -> Iterator[tuple[str, Any]]:
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(part, MetallicSurface | SpecularSurface):
            yield from _named_arrays(part, f"{prefix}{field.name}.")
        elif part is not None:
            yield f"{prefix}{field.name}", part


def _read_back(arrays: Arrays) -> ReadBack:
    """Inverse of `_named_arrays`."""
    groups: dict[str, dict[str, Any]] = {"": {}, "surface": {}, "specular_surface": {}}
    for name, values in arrays.items():
        group, _, field = name.rpartition(".")
        groups[group][field] = values
    specular = groups["specular_surface"]
    return ReadBack(
        **{"normal": None, **groups[""]},
        surface=MetallicSurface(**_without_arrays(groups["surface"])),
        specular_surface=SpecularSurface(**_without_arrays(specular)) if specular else None,
    )


def _without_arrays(values: dict[str, Any]) -> dict[str, Any]:
    """A surface's fields with numbers and strings in place of the arrays that .npz makes of them."""
    numbers: dict[str, Any] = {name: float(values[name]) for name in ("ior", "residual") if name in values}
    return {**values, **numbers, "warnings": tuple(map(str, values["warnings"]))}
