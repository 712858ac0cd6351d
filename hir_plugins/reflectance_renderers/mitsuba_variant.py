"""Which variant of Mitsuba runs, and a first look whether it can: with too old an LLVM it would abort the process."""

from __future__ import annotations

import os
import sys
from functools import lru_cache
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

from hir_core.errors import MissingExtraError
from hir_core.run.determinism import deterministic_requested


def mitsuba_on(device: str) -> ModuleType:
    """The module `mitsuba` with its variant set for a torch device (`cpu`, `cuda`, `cuda:0`).

    Sets the variant at every call, for others in this process may have changed it. Raises `MissingExtraError` where a
    tiny render in a process of its own fails.
    """
    variant = "cuda_ad_rgb" if device.startswith("cuda") else "llvm_ad_rgb"
    check_variant(variant)
    import mitsuba as mi

    if mi.variant() != variant:
        mi.set_variant(variant)
    if deterministic_requested():
        import drjit

        drjit.set_thread_count(1)  # gradients are sums by atomics, in any order
    return mi


@lru_cache(maxsize=4)
def check_variant(variant: str) -> None:
    """Tries the variant in a subprocess, once for each version of Mitsuba and its libraries; success is remembered."""
    from hir_core.run.installation_check import examine_renderer

    mark = _cache_folder() / f"mitsuba-{version('mitsuba')}-drjit-{version('drjit')}-{variant}-{_library_mark()}"
    if mark.exists():
        return
    finding = examine_renderer(variant, variant)
    if finding.state != "ok":
        advice = finding.advice or "run on the processor with --device cpu"
        raise MissingExtraError(f"Mitsuba cannot render on this machine ({finding.detail}); {advice}")
    try:
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()
    except OSError:
        pass  # a read-only home: the next process tries again


def _cache_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "hir"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hir"


def _library_mark() -> str:
    """Changes when the user chooses another LLVM."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH", "")
    return "".join(c if c.isalnum() else "_" for c in chosen)[-80:] or "default"
