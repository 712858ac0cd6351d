"""A function called in a process of its own, arrays in, arrays out.

For native code that ends the whole process on some inputs, which no `except` sees, or that keeps Python's lock for so
long that neither Ctrl-C nor a progress bar gets through. The child starts in 0.2 s and imports what the function needs.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import HirError, InputError

Arrays = dict[str, NDArray[Any]]

_REFUSED = 3
"""Exit code of a child whose last line is the sentence of a `HirError`; Python's own is 1, a signal's below 0."""


class ChildError(HirError):
    """The child ended without a result: by a signal, by native code, or by an error that is not ours."""


def call_apart(target: str, arrays: Mapping[str, Any]) -> Arrays:
    """What `target`, `module:function`, gives for these arrays, numbers and words by name: again arrays by name.

    Raises `InputError` with the sentence of a `HirError` that the function raised, `ChildError` where it gave nothing.
    """
    with tempfile.TemporaryDirectory(prefix="hir-apart-") as folder:
        given, result = Path(folder) / "given.npz", Path(folder) / "result.npz"
        np.savez(given, **arrays)
        # -P: the folder that a user stands in may hold a numpy.py; the child finds modules where this process does
        done = subprocess.run(
            [sys.executable, "-P", "-m", "hir_exporters.files.subprocess_call", target, str(given), str(result)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(place for place in sys.path if place)},
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
        if done.returncode == _REFUSED:
            raise InputError(done.stdout.strip().splitlines()[-1])
        if done.returncode:
            said = done.stderr.strip().splitlines() if done.returncode == 1 else []
            raise ChildError(said[-1][:300] if said else f"exit code {done.returncode}")
        return _read(result)


def _read(file: Path) -> Arrays:
    with np.load(file, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def main() -> int:
    """The child's: a target, an .npz of what it is given, the .npz to write."""
    target, given, result = sys.argv[1:4]
    module, _, name = target.partition(":")
    try:
        found = getattr(import_module(module), name)(**_read(Path(given)))
    except HirError as error:
        print(error)
        return _REFUSED
    np.savez(result, **found)
    return 0


if __name__ == "__main__":
    sys.exit(main())
