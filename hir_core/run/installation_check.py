"""The checks of `hir doctor`: what is installed, what works, and how to repair the rest."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import Final, Literal

from hir_core.run.machine import processor_name, total_memory_bytes, usable_cores

TINY_RENDER: Final = """
import sys
import mitsuba as mi
mi.set_variant(sys.argv[1])
scene = mi.cornell_box()
scene["sensor"]["film"]["width"] = scene["sensor"]["film"]["height"] = 4
image = mi.render(mi.load_dict(scene), spp=1)
import numpy
assert numpy.isfinite(numpy.array(image)).all()
"""

TORCH_HAS_CUDA: Final = "import sys, torch; sys.exit(0 if torch.cuda.is_available() else 1)"

MODULES: Final = {
    "usd": {"pxr": "usd-core"},
    "reconstruct": {
        "torch": "torch",
        "jaxtyping": "jaxtyping",
        "scipy": "scipy",
        "mitsuba": "mitsuba",
        "drjit": "drjit",
        "pycolmap": "pycolmap",
        "open3d": "open3d",
        "xatlas": "xatlas",
        "cholespy": "cholespy",
        "fast_simplification": "fast-simplification",
        "cv2": "opencv-python-headless",
        "skimage": "scikit-image",
        "matplotlib": "matplotlib",
        "lzfse": "lzfse",
    },
}
"""Modules of the extras that a reconstruction needs, with the distributions that contain them. Where none of an extra
is there, it was not installed, which is no fault: the export SDK needs neither."""

OPTIONAL_MODULES: Final = {
    "evaluate": {"lpips": "lpips", "flip_evaluator": "flip-evaluator"},
    "batch": {"ray": "ray", "fsspec": "fsspec"},
    "compress": {"DracoPy": "DracoPy", "meshopt": "meshopt"},
    "collision": {"coacd": "coacd"},
}
"""As `MODULES`, of extras for single features; without them the installation is sound."""


@dataclass(frozen=True)
class Finding:
    """The result of one check."""

    name: str
    state: Literal["ok", "missing", "broken", "absent"]
    """`absent` is no fault: an optional device, such as a GPU, or a package of an optional extra."""
    detail: str
    advice: str = ""


def examine(problems: list[str]) -> list[Finding]:
    """All findings in display order; `problems` are the plugin manager's."""
    findings = [
        Finding("python", "ok" if sys.version_info >= (3, 11) else "broken", sys.version.split()[0]),
        Finding("machine", "ok", f"{processor_name()}, {usable_cores()} cores, {total_memory_bytes() / 2**30:.0f} GiB"),
    ]
    for extra, modules in MODULES.items():
        found = [examine_module(module, package, extra) for module, package in modules.items()]
        is_absent = all(finding.state == "missing" for finding in found)
        findings += [replace(finding, state="absent") if is_absent else finding for finding in found]
    for extra, modules in OPTIONAL_MODULES.items():
        for module, package in modules.items():
            finding = examine_module(module, package, extra)
            findings.append(replace(finding, state="absent") if finding.state == "missing" else finding)
    if find_spec("mitsuba") is not None:
        findings.append(examine_renderer("llvm_ad_rgb", "renderer (cpu)"))
        findings.append(examine_renderer("cuda_ad_rgb", "renderer (cuda)"))
    findings += [Finding("plugin", "broken", problem) for problem in problems]
    return findings


def examine_module(module: str, package: str, extra: str) -> Finding:
    """Imports one module in a subprocess, because a broken library may abort the process."""
    command = f"pip install 'hir[{extra}]' (in a checkout: pip install -e '.[{extra}]')"
    if find_spec(module) is None:
        return Finding(package, "missing", f"for hir[{extra}]", command)
    code, output = _try([sys.executable, "-P", "-c", f"import {module}"])
    if code != 0:
        return Finding(package, "broken", last_line(output), library_advice(output) or command)
    try:
        return Finding(package, "ok", version(package))
    except PackageNotFoundError:
        return Finding(package, "ok", "installed")


def examine_renderer(variant: str, name: str) -> Finding:
    """Renders 4×4 pixels in a subprocess, because Mitsuba aborts the process if LLVM is too old."""
    code, output = _try([sys.executable, "-P", "-c", TINY_RENDER, variant])
    if code == 0:
        return Finding(name, "ok", variant)
    if variant.startswith("cuda"):
        found_by_torch, _ = _try([sys.executable, "-P", "-c", TORCH_HAS_CUDA])
        if found_by_torch != 0:
            return Finding(name, "absent", "no CUDA device; runs use the CPU")
        advice = (
            "install NVIDIA's driver with OptiX (NVIDIA_DRIVER_CAPABILITIES=all in a container), or use --device cpu"
        )
        return Finding(name, "broken", "PyTorch finds a CUDA device that Mitsuba cannot use", advice)
    advice = "install LLVM 17 or newer: apt-get install libllvm19 (Debian 12), or set DRJIT_LIBLLVM_PATH to its library"
    return Finding(name, "broken", f"{variant}: {last_line(output) or f'ended with {code}'}", advice)


def last_line(text: str) -> str:
    """The last line that is not blank."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1][:200] if lines else ""


def library_advice(output: str) -> str:
    """The command that installs Debian's package of a shared library that could not be opened; empty if not known."""
    packages = {
        "libusb-1.0": "libusb-1.0-0",
        "libGL.so": "libgl1",
        "libgomp": "libgomp1",
        "libEGL": "libegl1",
        "libX11": "libx11-6",
        "libLLVM": "libllvm19",
    }
    found = [package for library, package in packages.items() if library in output]
    return f"apt-get install {' '.join(found)}" if found else ""


def _try(command: list[str]) -> tuple[int, str]:
    try:
        done = subprocess.run(command, capture_output=True, text=True, errors="replace", timeout=180, check=False)
    except subprocess.TimeoutExpired:
        return -1, "took more than 180 s"
    return done.returncode, done.stdout + done.stderr
