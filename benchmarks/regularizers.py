"""Bilateral means: time, memory and error against all pairs, and the choice of σ, on textures of spot and avocado.

`python -m benchmarks.regularizers speed RUN` takes the mesh and albedo of a finished run, and as many texels as asked
for. Specular albedo is white noise: no structure that would make a mean easy.

`python -m benchmarks.regularizers cells RUN` shows error and time by the edge of the cells and the cutoff.

`python -m benchmarks.regularizers sigma AVOCADO.gltf SPOT.obj` takes true textures, adds noise such as fits leave and
measures how much of it a bilateral mean removes from the specular albedo, by σ1 and σ2. All print Markdown tables.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from torch import Tensor

from hir_core.run.machine import peak_memory_bytes
from hir_core.scene import Mesh, Topology
from hir_core.scene.scene_store import load_stage_scene
from hir_core.scene.srgb import srgb_to_linear
from hir_plugins.regularizers.bilateral.bilateral_grid import cells_of, cubes_of
from hir_plugins.regularizers.bilateral.bilateral_pairs import (
    absolute_deviation_of_pairs,
    deviation_of_pairs,
    weight_error,
)
from hir_plugins.regularizers.bilateral.grid_deviation import absolute_deviation
from hir_plugins.regularizers.material_options import BilateralSpecularOptions
from hir_plugins.regularizers.surface_samples import SurfaceSamples, sample_surface

DEFAULTS = BilateralSpecularOptions()
MOST_PAIRS = 10_000
"""Largest number of samples for which all pairs are summed."""


def inputs(run: Path, samples: int, white: bool = False) -> tuple[Tensor, Tensor, Tensor]:
    """Positions in σ1, albedo in σ2 and specular noise at about so many texels of a run's surface."""
    scene = load_stage_scene(run / "stages" / "4-reflectance" / "scene")
    assert scene.material is not None
    side = 256
    side = round(side * (samples / len(sample_surface(scene.mesh, "texels", (side, side)).positions)) ** 0.5)
    spots = sample_surface(scene.mesh, "texels", (side, side))
    generator = torch.Generator().manual_seed(0)
    diffuse = spots.values(scene.material.diffuse_albedo)
    if white:
        diffuse = torch.rand(diffuse.shape, generator=generator)
    specular = 0.02 + 0.1 * torch.rand(diffuse.shape, generator=generator)
    extent = spots.positions.amax(0) - spots.positions.amin(0)
    scaled = spots.positions / (DEFAULTS.sigma_position * extent.norm())
    return scaled, diffuse / DEFAULTS.sigma_albedo, specular


def measured(method: str, run: Path, samples: int, white: bool) -> dict[str, float]:
    """Seconds of preparation and of value with gradients, memory above the inputs, and the results' digests."""
    _evaluated(method, *(t[:500].clone() for t in inputs(run, samples, white)))  # warm-up: loads libraries
    given = inputs(run, samples, white)
    before = peak_memory_bytes()
    prepared, stepped = _evaluated(method, *given)
    peak = peak_memory_bytes()
    return {"samples": len(given[0]), "prepare": prepared, "step": stepped, "memory": (peak - before) / 2**20}


def _evaluated(method: str, positions: Tensor, diffuse: Tensor, specular: Tensor) -> tuple[float, float]:
    """Processor seconds of preparation, and of value with gradients."""
    began = time.process_time()
    if method == "grid":
        cubes = cubes_of(positions, DEFAULTS.cutoff, DEFAULTS.cell_size)
        total = partial(absolute_deviation, cubes, edge=DEFAULTS.cell_size)
    else:
        total = partial(absolute_deviation_of_pairs, positions)
    prepared = time.process_time()
    leaves = (diffuse.requires_grad_(), specular.requires_grad_())
    torch.autograd.grad(total(*leaves)[0], leaves)
    return prepared - began, time.process_time() - prepared


def speed(run: Path, counts: list[int]) -> None:
    """One process per row, so that the memory is that of the row."""
    print("| albedo | samples | prepare ms | cells ms | MB | all pairs ms | value error | deviation error | bound ε |")
    print("|---|---|---|---|---|---|---|---|---|")
    for white in (False, True):
        for count in counts[:3] if white else counts:
            arguments = [str(run), str(count), str(white)]
            fast = _in_process("grid", *arguments)
            slow = _in_process("pairs", *arguments) if count <= MOST_PAIRS else None
            found = compared(run, count, white, DEFAULTS.cutoff, DEFAULTS.cell_size) if slow else None
            errors = (
                "– | – | –"
                if found is None
                else (f"{found['value']:.1e} | {found['deviation']:.1e} | {found['bound']:.1e}")
            )
            pairs = "–" if slow is None else f"{1e3 * slow['step']:.0f}"
            print(
                f"| {'white noise' if white else 'fitted'} | {fast['samples']:.0f} | {1e3 * fast['prepare']:.0f} | "
                f"{1e3 * fast['step']:.0f} | {fast['memory']:.0f} | {pairs} | {errors} |",
                flush=True,
            )


def _in_process(*arguments: str) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.regularizers", "one", *arguments]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)  # type: ignore[no-any-return]


def compared(run: Path, count: int, white: bool, cutoff: float, edge: float) -> dict[str, float]:
    """Errors against all pairs in float64: of the sum, of deviations relative to their spread (root mean square), of
    both gradients as vectors; and the mean of the bound ε of the deviations, relative to the range of the values.
    """
    positions, diffuse, specular = (t.double() for t in inputs(run, count, white))
    leaves = (diffuse.requires_grad_(), specular.requires_grad_())
    cubes = cubes_of(positions, cutoff, edge)
    began = time.process_time()
    total, found = absolute_deviation(cubes, *leaves, edge)
    found_gradients = torch.autograd.grad(total, leaves)
    seconds = time.process_time() - began
    true = deviation_of_pairs(positions, *leaves)
    true_gradients = torch.autograd.grad(true.abs().sum(), leaves)
    true = true.detach()
    turned = [float((f - t).norm() / t.norm()) for f, t in zip(found_gradients, true_gradients, strict=True)]
    return {
        "value": abs(float(found.abs().sum() / true.abs().sum()) - 1),
        "deviation": float((found - true).square().mean().sqrt() / specular.detach().std()),
        "by albedo": turned[0],
        "by specular": turned[1],
        "bound": float(weight_error(cubes, diffuse, edge).mean()),
        "seconds": seconds,
        "cells": len(cells_of(cubes, diffuse, specular, edge).count) / len(positions),
    }


def cells(run: Path, count: int) -> None:
    """Error and time by the edge of the cells and the cutoff."""
    print("| albedo | cutoff | cell | cells per sample | ms | value | deviation | gradient by ρs | by ρd | bound ε |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for white in (False, True):
        for cutoff in (3.0, 4.0):
            for edge in (0.5, 0.75, 1.0, 1.5):
                e = compared(run, count, white, cutoff, edge)
                print(
                    f"| {'white noise' if white else 'fitted'} | {cutoff:g} | {edge:g} | {e['cells']:.2f} | "
                    f"{1e3 * e['seconds']:.0f} | {e['value']:.1e} | {e['deviation']:.1e} | {e['by specular']:.1e} | "
                    f"{e['by albedo']:.1e} | {e['bound']:.1e} |",
                    flush=True,
                )


def sigma(avocado: Path, spot: Path, count: int = 20_000) -> None:
    """Noise that is left of a specular albedo (rms, relative to what was added) by σ1 and σ2.

    Avocado: its own textures, ρs = 0.04·(1 − metalness) + metalness·colour. Spot: its own colours; its true ρs is one
    value, which any width would serve, so here dark patches (the mean colour below 0.4) get three times the ρs.
    """
    for name, (positions, diffuse, specular) in {
        "avocado": _true_avocado(avocado, count),
        "spot, two materials": _true_spot(spot, count),
    }.items():
        generator = torch.Generator().manual_seed(1)
        noise = 0.02 * torch.randn(specular.shape, generator=generator)
        guide = diffuse + 0.03 * torch.randn(diffuse.shape, generator=generator)
        diagonal = (positions.amax(0) - positions.amin(0)).norm()
        widths = (0.025, 0.05, 0.1, 0.2, 0.4)
        true_deviation = float(specular.std())
        print(
            f"\n{name}: {len(positions)} points; noise of ρs 0.02, of ρd 0.03; deviation of ρs {true_deviation:.3f}\n"
        )
        print(f"| σ1 \\ σ2 | {' | '.join(map(str, widths))} |\n|{'---|' * 6}")
        for near in (0.01, 0.02, 0.03, 0.04, 0.06):
            cubes = cubes_of(positions / (near * diagonal), 3.0, 0.75)
            left = []
            for like in widths:
                away = absolute_deviation(cubes, guide / like, specular + noise, 0.75)[1]
                left.append(float((noise - away).square().mean().sqrt() / noise.square().mean().sqrt()))
            print(f"| {near} | {' | '.join(f'{v:.2f}' for v in left)} |", flush=True)


def _true_avocado(path: Path, count: int) -> tuple[Tensor, Tensor, Tensor]:
    mesh: Any = trimesh.load(path, force="mesh", process=False)
    material = mesh.visual.material
    picture = np.asarray(material.baseColorTexture.convert("RGB"), dtype=np.float32) / 255
    color = srgb_to_linear(torch.from_numpy(picture))
    metal = torch.from_numpy(
        np.asarray(material.metallicRoughnessTexture.convert("RGB"), dtype=np.float32)[..., 2:] / 255
    )
    samples = _texels(mesh, count)
    base, metalness = samples.values(color), samples.values(metal)
    return samples.positions, base * (1 - metalness), 0.04 * (1 - metalness) + metalness * base


def _true_spot(path: Path, count: int) -> tuple[Tensor, Tensor, Tensor]:
    from PIL import Image

    mesh: Any = trimesh.load(path, force="mesh", process=False)
    picture = Image.open(path.with_name("spot_texture.png")).convert("RGB")
    samples = _texels(mesh, count)
    diffuse = samples.values(srgb_to_linear(torch.from_numpy(np.asarray(picture, dtype=np.float32) / 255)))
    dark = (diffuse.mean(dim=1, keepdim=True) < 0.4).float()
    return samples.positions, diffuse, 0.04 + 0.08 * dark.expand(-1, 3)


def _texels(mesh: Any, count: int) -> SurfaceSamples:
    faces = torch.from_numpy(np.asarray(mesh.faces, dtype=np.int64))
    uv = np.asarray(mesh.visual.uv, dtype=np.float32) * [1, -1] + [0, 1]
    ours = Mesh(
        torch.from_numpy(np.asarray(mesh.vertices, dtype=np.float32)),
        Topology(faces, faces),
        torch.from_numpy(uv.astype(np.float32)),
    )
    side = round(256 * (count / len(sample_surface(ours, "texels", (256, 256)).positions)) ** 0.5)
    return sample_surface(ours, "texels", (side, side))


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    command = commands.add_parser("speed")
    command.add_argument("run", type=Path)
    command.add_argument("--counts", type=int, nargs="+", default=[2_500, 5_000, 10_000, 100_000, 300_000, 1_000_000])
    command = commands.add_parser("cells")
    command.add_argument("run", type=Path)
    command.add_argument("--count", type=int, default=3_000)
    command = commands.add_parser("sigma")
    command.add_argument("avocado", type=Path)
    command.add_argument("spot", type=Path)
    command = commands.add_parser("one")
    for name in ("method", "run", "count", "white"):
        command.add_argument(name)
    given = parser.parse_args()
    if given.command == "speed":
        speed(given.run, given.counts)
    elif given.command == "cells":
        cells(given.run, given.count)
    elif given.command == "sigma":
        sigma(given.avocado, given.spot)
    else:
        print(json.dumps(measured(given.method, Path(given.run), int(given.count), given.white == "True")))


if __name__ == "__main__":
    main()
