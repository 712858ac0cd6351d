"""Archives of arrays (.npz) that a run keeps, read without pickle; damaged ones are refused in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hir_core.errors import InputError


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an archive by name; `InputError` where there is none, it is damaged, or holds objects."""
    try:
        # a file that is no archive, numpy leaves open
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}
    except Exception as error:  # zip, zlib and numpy's headers, which are parsed as Python, raise whatever they like
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path} cannot be read ({reason}); run without --resume") from error
