"""Calls a function in a separate process: arrays in, arrays out.

Two uses: native code that aborts the process on some inputs, which no `except` catches, and native code that holds
Python's lock for so long that neither Ctrl-C nor a progress bar works. The subprocess starts in about 0.2 s and imports
only what the function needs.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.errors import HirError, InputError

Arrays = dict[str, NDArray[Any]]
"""Arrays of any type by name."""

_INPUT_ERROR_EXIT_CODE = 3
"""Exit code of a subprocess whose last line is the message of a `HirError`. Python's own is 1, a signal's is negative.
"""


class SubprocessCrashError(HirError):
    """The subprocess gave no result: a signal, native code or an error other than `HirError` ended it."""


@dataclass(frozen=True)
class Limits:
    """What a subprocess that reads a stranger's file may use."""

    seconds: float
    memory_bytes: int
    """Of address space. Windows and macOS do not limit it."""


def run_in_subprocess(target: str, arguments: Mapping[str, ArrayLike], limits: Limits | None = None) -> Arrays:
    """Calls `target`, written `module:function`, with arrays, numbers and strings by name; returns arrays by name.

    Raises `InputError` with the message of a `HirError` that the function raised, `SubprocessCrashError` where the
    subprocess ended without a result or exceeded `limits`.
    """
    with tempfile.TemporaryDirectory(prefix="hir-subprocess-") as folder:
        input_file, result_file = Path(folder) / "arguments.npz", Path(folder) / "result.npz"
        arrays: dict[str, Any] = {name: np.asarray(value) for name, value in arguments.items()}
        np.savez(input_file, **arrays)
        # -P: the current folder may contain a numpy.py. The subprocess finds modules where this process does.
        memory = str(limits.memory_bytes) if limits else "0"
        try:
            process = subprocess.run(
                [sys.executable, "-P", "-m", __name__, target, input_file, result_file, memory],
                env={**os.environ, "PYTHONPATH": os.pathsep.join(folder for folder in sys.path if folder)},
                capture_output=True,
                text=True,
                errors="replace",
                check=False,
                timeout=limits.seconds if limits else None,
            )
        except subprocess.TimeoutExpired as error:
            raise SubprocessCrashError(f"it took more than {error.timeout:g} seconds") from None
        if process.returncode == _INPUT_ERROR_EXIT_CODE:
            raise InputError(process.stdout.strip().splitlines()[-1])
        if process.returncode:
            messages = process.stderr.strip().splitlines() if process.returncode == 1 else []
            raise SubprocessCrashError(messages[-1][:300] if messages else f"exit code {process.returncode}")
        return _load_arrays(result_file)


def _load_arrays(file: Path) -> Arrays:
    with np.load(file, allow_pickle=False) as arrays:
        return {name: arrays[name] for name in arrays.files}


def _limit_memory(size: int) -> None:
    """Lets Linux refuse memory above `size` bytes of address space; 0 changes nothing."""
    if not size or not sys.platform.startswith("linux"):
        return
    import resource

    _, most = resource.getrlimit(resource.RLIMIT_AS)
    size = size if most == resource.RLIM_INFINITY else min(size, most)
    resource.setrlimit(resource.RLIMIT_AS, (size, most))


def main() -> int:
    """Entry point of the subprocess. Arguments: the target, the .npz to read, the .npz to write, and the bytes of
    memory that it may use, 0 for all.
    """
    target, input_file, result_file, memory = sys.argv[1:5]
    _limit_memory(int(memory))
    module, _, name = target.partition(":")
    try:
        result = getattr(import_module(module), name)(**_load_arrays(Path(input_file)))
    except HirError as error:
        print(error)
        return _INPUT_ERROR_EXIT_CODE
    np.savez(result_file, **result)
    return 0


if __name__ == "__main__":
    sys.exit(main())
