"""Array archives (.npz) of a run, read without pickle; a damaged one raises one error that names it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.files.atomic import atomic_path
from hir_exporters.files.regular_files import refuse_special_file
from numpy.typing import NDArray

from hir_core.errors import InputError


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an archive by name; a missing or damaged archive, or one with objects, raises `InputError`."""
    refuse_special_file(path)
    try:
        # numpy does not close a file that is no archive
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except Exception as error:  # zipfile, zlib and numpy's header parser raise many types
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path} cannot be read ({reason}); run without --resume") from error


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Writes an archive of named arrays; the file is complete or as it was before."""
    with atomic_path(path) as temporary:
        np.savez(temporary, **arrays)  # type: ignore[arg-type]
