"""Package versions, hardware, and the time and memory that a run uses."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import platform
import subprocess
import sys
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = (
    "hir",
    "numpy",
    "scipy",
    "torch",
    "mitsuba",
    "drjit",
    "pycolmap",
    "open3d",
    "xatlas",
    "trimesh",
    "pygltflib",
    "usd-core",
    "OpenEXR",
    "pillow",
)


def versions() -> dict[str, str]:
    """Versions of Python and of those installed packages that influence results."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


@cache
def source_commit() -> str:
    """Commit of the checkout that this program runs from, with `-dirty` where tracked files differ from it.

    Empty for an installed package, and where git is missing. Asked once: results that a program stores in the checkout
    are no change of the code that runs.
    """
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return ""
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return ""


def describe_machine(device: str) -> dict[str, Any]:
    """Processor, cores, memory, threads and accelerator of this machine."""
    described: dict[str, Any] = {
        "system": platform.platform(),
        "processor": processor_name(),
        "cores": usable_cores(),
        "memory_bytes": total_memory_bytes(),
        "device": device,
    }
    torch = sys.modules.get("torch")
    if torch is not None:
        described["threads"] = torch.get_num_threads()
        if device == "cuda":
            described["gpu"] = torch.cuda.get_device_name(0)
    return described


def usable_cores() -> int:
    """Cores that this process may use."""
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity is not None else os.cpu_count() or 1


def processor_name() -> str:
    """The processor's name."""
    try:
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass  # not Linux
    return platform.processor() or platform.machine()


def total_memory_bytes() -> int:
    """Physical memory; 0 if unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 0


def return_freed_memory() -> None:
    """Returns freed memory to the system; glibc would keep it for the process, in addition to the next stage's."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # glibc only
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def processor_seconds() -> float:
    """CPU seconds of this process and its finished children, summed over threads; 0 if unknown.

    They are comparable on a busy machine; wall-clock seconds are not.
    """
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def peak_memory_bytes() -> int:
    """Peak resident size of this process, without its children; 0 if unknown."""
    high_water = high_water_bytes()
    if high_water is not None:
        return high_water
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)


def high_water_bytes() -> int | None:
    """Peak resident size from Linux's /proc; None on other systems.

    `getrusage` is no substitute there: a new process inherits the peak of the one that started it.
    """
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii", errors="replace").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024
    except OSError:
        pass
    return None
