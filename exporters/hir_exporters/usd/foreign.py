"""USD files of strangers, read by a process of its own: OpenUSD ends the whole process on some damaged files.

"Dereferenced an invalid SdfPrimSpec" is such an end; no `except` sees it. The child hands arrays back in an .npz.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from hir_exporters.errors import HirError, InputError
from hir_exporters.materials import MetallicSurface, SpecularSurface
from hir_exporters.readback import ReadBack, read_usd

REFUSED = 3
"""Exit code of a child whose last line says why; Python's own is 1, a signal's below 0."""


def read_foreign_usd(path: Path) -> ReadBack:
    """`read_usd` by a child process, 0.5 s more; a file that ends the child is an `InputError`, too."""
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} is not there")
    with tempfile.TemporaryDirectory(prefix="hir-usd-") as folder:
        result = Path(folder) / "read.npz"
        # -P: the folder that a user stands in may hold a numpy.py; the child finds modules where this process does
        done = subprocess.run(
            [sys.executable, "-P", "-m", "hir_exporters.usd.foreign", os.fspath(path), str(result)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(place for place in sys.path if place)},
            capture_output=True, text=True, errors="replace", check=False,
        )  # fmt: skip
        if done.returncode == REFUSED:
            raise InputError(done.stdout.strip().splitlines()[-1])
        if done.returncode == 1:  # Python's own
            raise InputError(f"{path} cannot be read as USD ({(done.stderr.strip().splitlines() or ['?'])[-1][:300]})")
        if done.returncode:
            raise InputError(
                f"{path} cannot be read as USD: OpenUSD ended its process (exit code {done.returncode}); "
                "the file is damaged, write it again"
            )
        return _unpacked(result)


def main() -> int:
    """The child's: path of a USD file, path of the .npz."""
    path, result = map(Path, sys.argv[1:3])
    try:
        back = read_usd(path)
    except HirError as error:
        print(error)
        return REFUSED
    np.savez(result, **dict(_packed(back, "")))
    return 0


def _packed(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    for field in fields(value):
        part = getattr(value, field.name)
        if isinstance(part, MetallicSurface | SpecularSurface):
            yield from _packed(part, f"{name}{field.name}.")
        elif part is not None:
            yield f"{name}{field.name}", part


def _unpacked(file: Path) -> ReadBack:
    with np.load(file, allow_pickle=False) as arrays:
        whole: dict[str, dict[str, Any]] = {"": {}, "surface": {}, "legacy": {}}
        for name in arrays.files:
            part, _, field = name.rpartition(".")
            whole[part][field] = arrays[name]
    surfaces = {
        name: kind(**{**whole[name], **_plain(whole[name])}) if whole[name] else None
        for name, kind in (("surface", MetallicSurface), ("legacy", SpecularSurface))
    }
    return ReadBack(**{"normal": None, **whole[""], **surfaces})


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    """Numbers and words that an .npz made arrays of."""
    plain: dict[str, Any] = {name: float(values[name]) for name in ("ior", "residual") if name in values}
    return plain | {"warnings": tuple(map(str, values["warnings"]))}


if __name__ == "__main__":
    sys.exit(main())
