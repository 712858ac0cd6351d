"""Mitsuba's variant for a device, and a test that it can render: with a too old LLVM it would abort the process."""

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

    Sets the variant at every call, because other code may have changed it. Raises `MissingExtraError` if a tiny render
    in a subprocess fails.
    """
    variant = "cuda_ad_rgb" if device.startswith("cuda") else "llvm_ad_rgb"
    check_variant(variant)
    import mitsuba as mi

    if mi.variant() != variant:
        mi.set_variant(variant)
    if deterministic_requested():
        import drjit

        drjit.set_thread_count(1)  # gradients are sums by atomic additions, whose order varies with threads
    return mi


@lru_cache(maxsize=4)
def check_variant(variant: str) -> None:
    """Tests the variant in a subprocess, once for each version of Mitsuba and its libraries; success is cached."""
    from hir_core.run.installation_check import examine_renderer

    success_file = _cache_folder() / f"mitsuba-{version('mitsuba')}-drjit-{version('drjit')}-{variant}-{_llvm_id()}"
    if success_file.exists():
        return
    finding = examine_renderer(variant, variant)
    if finding.state != "ok":
        advice = finding.advice or "run on the processor with --device cpu"
        raise MissingExtraError(f"Mitsuba cannot render on this machine ({finding.detail}); {advice}")
    try:
        success_file.parent.mkdir(parents=True, exist_ok=True)
        success_file.touch()
    except OSError:
        pass  # a read-only home: the next process tests again


def _cache_folder() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA", Path.home())) / "hir"
    return Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "hir"


def _llvm_id() -> str:
    """Identifies the LLVM library that the user chose."""
    chosen = os.environ.get("DRJIT_LIBLLVM_PATH", "")
    return "".join(c if c.isalnum() else "_" for c in chosen)[-80:] or "default"
