"""USD files of strangers, read by a process of its own: OpenUSD ends the whole process on some damaged files.

"Dereferenced an invalid SdfPrimSpec" is such an end; no `except` sees it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

from hir_exporters.errors import InputError
from hir_exporters.files.subprocess_call import Arrays, SubprocessCrashError, run_in_subprocess
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.reading.readback import ReadBack, read_usd


def read_untrusted_usd(path: Path) -> ReadBack:
    """`read_usd` by a child process, 0.5 s more; a file that ends the child is an `InputError`, too."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} is not there")
    try:
        return _unpacked(
            run_in_subprocess("hir_exporters.reading.usd_import:read_usd_arrays", {"path": os.fspath(path)})
        )
    except SubprocessCrashError as error:
        raise InputError(
            f"{path} cannot be read as USD: it ended the process that read it ({error}); the file is damaged, "
            "write it again"
        ) from error


def read_usd_arrays(path: Any) -> Arrays:
    """The child's part of `read_untrusted_usd`: a `ReadBack` as arrays by name."""
    return dict(_packed(read_usd(Path(str(path))), ""))


def _packed(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(part, MetallicSurface | SpecularSurface):
            yield from _packed(part, f"{name}{field.name}.")
        elif part is not None:
            yield f"{name}{field.name}", part


def _unpacked(arrays: Arrays) -> ReadBack:
    whole: dict[str, dict[str, Any]] = {"": {}, "surface": {}, "legacy": {}}
    for name, values in arrays.items():
        part, _, field = name.rpartition(".")
        whole[part][field] = values
    surfaces = {
        name: kind(**{**whole[name], **_plain(whole[name])}) if whole[name] else None
        for name, kind in (("surface", MetallicSurface), ("legacy", SpecularSurface))
    }
    return ReadBack(**{"normal": None, **whole[""], **surfaces})


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Numbers and words that an .npz made arrays of."""
    plain: dict[str, Any] = {name: float(values[name]) for name in ("ior", "residual") if name in values}
    return plain | {"warnings": tuple(map(str, values["warnings"]))}
