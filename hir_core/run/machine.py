"""What a run was made with and on."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import platform
import sys
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
    """Python and the packages that decide results, those that are installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


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
    """The processor as the system names it."""
    try:
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass  # not Linux: the next line knows
    return platform.processor() or platform.machine()


def total_memory_bytes() -> int:
    """Physical memory; 0 where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 0


def return_freed_memory() -> None:
    """Gives the system back what was freed; glibc keeps it for the process, on top of what the next stage takes."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError):  # other libraries of C have no such call
        ctypes.CDLL("libc.so.6").malloc_trim(0)


def processor_seconds() -> float:
    """Seconds that processors worked for this process and its ended children, all threads added; 0 if not said.

    Where other programs have the processors too, these are the seconds to compare: the clock's hold their work as well.
    """
    spent = os.times()
    return spent.user + spent.system + spent.children_user + spent.children_system


def peak_memory_bytes() -> int:
    """Largest resident size of this process so far, without that of its children; 0 where the system does not say."""
    try:
        import resource
    except ImportError:
        return 0
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return int(peak if sys.platform == "darwin" else peak * 1024)
