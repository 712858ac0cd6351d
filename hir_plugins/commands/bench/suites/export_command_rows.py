"""The whole command `hir export` on assets with large textures: processor time of the process, start included."""

from __future__ import annotations

import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial
from hir_exporters.scene_format import save_scene
from hir_exporters.textures.texture_maps import resize
from numpy.typing import NDArray

from hir_core.errors import HirError
from hir_core.testing.assets import ball
from hir_plugins.commands.bench.results.bench_result import Row, Timing

SIDES: Final = (2048, 4096)
"""Sides of the textures in texels."""

_OCTAVES: Final = 6
_SMALLEST_CELLS: Final = 4
_FALLOFF: Final = 0.6
"""Amplitude of an octave relative to the one before, which is twice as coarse."""

_COMMANDS: Final = (
    (2048, ("-f", "glb", "-f", "usdz", "--no-verify")),
    (2048, ("-f", "glb", "-f", "usdz")),
    (2048, ("-f", "glb", "--lod", "10k,3k,1k")),
    (4096, ("-f", "glb", "-f", "usdz")),
)


def export_command_rows(repeats: int) -> Iterator[Row]:
    """A row for each command, on a metallic and on a dielectric asset."""
    for kind in ("metallic", "dielectric"):
        for side in SIDES:
            with tempfile.TemporaryDirectory() as folder:
                asset = grained_asset(kind, side)
                save_scene(asset, Path(folder) / "scene")
                for wanted, arguments in _COMMANDS:
                    if wanted != side:
                        continue
                    timing, size = measured_command(Path(folder) / "scene", Path(folder) / "files", arguments, repeats)
                    yield Row(
                        {"triangles": len(asset.mesh.faces), "texture": side},
                        f"hir export {' '.join(arguments)}, {kind}",
                        "ours",
                        timing,
                        {"MB": size / 1e6},
                    )


def measured_command(scene: Path, output: Path, arguments: tuple[str, ...], repeats: int) -> tuple[Timing, int]:
    """Time of the fastest of several calls, and the bytes of all files."""
    command = [sys.executable, "-m", "hir_core.cli", "export", str(scene), *arguments, "-q", "-o", str(output)]
    wall, cpu = [], []
    for _ in range(max(1, repeats)):
        before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        wall.append(time.perf_counter() - start)
        cpu.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        if done.returncode:
            raise HirError(f"{' '.join(command)} failed: {done.stderr.strip()}")
    size = sum(file.stat().st_size for file in output.iterdir())
    return Timing(min(wall), statistics.median(wall), max(wall), len(wall), min(cpu)), size


def grained_asset(kind: str, side: int) -> Asset:
    """40,000 triangles with textures of side² that have details of all sizes and a grain, as those of fits have.

    `metallic` has a metalness map, `dielectric` a map of its reflectance; both have normals and observed texels.
    """
    color = np.clip(0.9 * _octaves(side, 3, 1) + _grain(side, 3, 0.012, 2), 0.02, 0.95)
    roughness = np.clip(0.02 + 0.5 * _octaves(side, 1, 3) + _grain(side, 1, 0.006, 4), 0.02, 1)[..., 0]
    slope = 0.5 * (_octaves(side, 2, 5) - 0.5) + _grain(side, 2, 0.02, 6)
    normal = np.concatenate([slope, np.ones((side, side, 1), np.float32)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    observed = _octaves(side, 1, 7)[..., 0] > 0.35
    if kind == "metallic":
        metalness = np.clip(12 * (_octaves(side, 1, 8)[..., 0] - 0.45), 0, 1)
        material = AssetMaterial.metallic(color, metalness, roughness, normal, observed)
    else:
        specular = np.clip(0.03 + 0.03 * _octaves(side, 1, 9) + _grain(side, 1, 0.001, 10), 0.02, 0.08)
        material = AssetMaterial("dielectric", color, specular.repeat(3, axis=-1), roughness, normal, observed)
    light = np.random.default_rng(0).gamma(0.5, 1.0, (256, 512, 3)).astype(np.float32)
    return Asset(ball(100, 200), material, AssetEnvironment(light), name=kind)


def _octaves(side: int, channels: int, seed: int) -> NDArray[np.float32]:
    """Smooth noise (side, side, channels) in 0..1: a sum of interpolated grids, each twice as fine."""
    random, total = np.random.default_rng(seed), np.zeros((side, side, channels), np.float32)
    amplitudes = [_FALLOFF**k for k in range(_OCTAVES)]
    for k, amplitude in enumerate(amplitudes):
        cells = _SMALLEST_CELLS << k
        grid = random.random((cells, cells, channels), dtype=np.float32)
        total += np.float32(amplitude) * resize(grid, side, side)
    return total / np.float32(sum(amplitudes))


def _grain(side: int, channels: int, deviation: float, seed: int) -> NDArray[np.float32]:
    return np.random.default_rng(seed).normal(0, deviation, (side, side, channels)).astype(np.float32)
