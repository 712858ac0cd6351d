"""What the transport renderer costs and how wrong it is: `python -m benchmarks.reflectance bias` or `… fit CAPTURE`.

`bias` compares cached transport with path tracing (which shares no code with it but the BRDF) by width and concavity.
`fit` gives a capture's true mesh (`reference.obj`) to the reflectance stage and measures pixels of unseen views after
growing numbers of steps: seconds against error, without the error of a fitted mesh. Both print Markdown tables.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
import trimesh

from hir_core.atlas import texture_size, unwrap_mesh
from hir_core.capture import Capture, Pixels, View
from hir_core.config import ReflectanceSettings
from hir_core.manager import PluginManager
from hir_core.pixel_cache import PixelCache
from hir_core.readers import read_capture
from hir_core.reflectance import starting_scene
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_core.selection import Rung
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.pyramid import texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX
from tests.reflectance.shapes import icosphere, looking_at

SIZE = 48
PATHS = 2048


def bias() -> None:
    """A sphere, and a sphere with a smaller one in front of it, under a smooth light and under one with a sun."""
    print("| scene | light | α | mean error | bias |\n|---|---|---|---|---|")
    large, small = icosphere(4), icosphere(3, 0.45)
    positions = torch.cat([large.positions, small.positions + torch.tensor([0.3, 1.2, 0.9])])
    both = Mesh(positions, Topology(torch.cat([large.faces, small.faces + len(large.positions)])))
    for scene_name, mesh in {"convex": large, "concave": both}.items():
        for light_name, light in lights().items():
            for alpha in (0.03, 0.1, 0.3, 0.6):
                material = Material("dielectric", torch.full((3,), 0.4), torch.full((3,), 0.2), torch.tensor([alpha]))
                error, offset = compare(Scene(mesh, material, light))
                print(f"| {scene_name} | {light_name} | {alpha} | {100 * error:.2f} % | {100 * offset:+.2f} % |")


def compare(scene: Scene) -> tuple[float, float]:
    """Mean absolute and mean signed difference to path tracing, relative to the mean radiance."""
    assert scene.material is not None and scene.environment is not None
    blank = Pixels(
        np.zeros((SIZE, SIZE, 3), np.float32), np.ones((SIZE, SIZE), np.float32), np.zeros((SIZE, SIZE), bool)
    )
    capture = Capture(Path("made"), (View("0", looking_at((0, 1, 4), SIZE, SIZE), lambda: blank),))
    pixels = torch.tensor([(0, x, y) for y in range(SIZE) for x in range(SIZE)])
    torch.manual_seed(0)
    tracer = MitsubaGGX(MitsubaGGXOptions(samples=PATHS, max_depth=2)).prepare(scene, capture)
    truth = tracer.radiance(scene.material, scene.environment, pixels)
    options = TransportGGXOptions(vertices=0)
    shown = TransportGGX(options).prepare(scene, capture).radiance(scene.material, scene.environment, pixels)
    seen = (truth.sum(1) > 0) & (shown.sum(1) > 0)
    difference = (shown - truth)[seen]
    mean = truth[seen].mean()
    return float(difference.abs().mean() / mean), float(difference.mean() / mean)


def lights() -> dict[str, EnvironmentMap]:
    """A smooth sky, and the same with a sun of radiance 500 in one texel of 32 rows."""
    d = texel_directions(32, 64)
    sky = (0.6 + 0.5 * d[:, 1:2] + 0.3 * torch.sin(2 * d[:, :1] + d[:, 2:])).clamp_min(0.05)
    smooth = (sky * torch.tensor([1.0, 0.8, 0.6])).reshape(32, 64, 3)
    sunny = smooth.clone()
    sunny[8, 30] = 500.0
    return {"smooth": EnvironmentMap(smooth), "sun": EnvironmentMap(sunny)}


def fit(path: Path, steps: list[int]) -> None:
    """Seconds and error on unseen views, on the true mesh."""
    plugins = PluginManager.discover()
    train, test = (PixelCache().wrap(read_capture(path, split, plugins)) for split in ("train", "test"))
    scene = starting_scene(true_scene(path, train), train, ReflectanceSettings())
    print("| model | steps | seconds | train dB | unseen dB | ρs | α |\n|---|---|---|---|---|---|---|")
    for rung in (
        Rung(),
        Rung("paper", "uniform"),
        Rung("dielectric", "uniform"),
        Rung("dielectric", "uniform", bounces=1),
    ):
        for count in steps:
            began = time.perf_counter()
            renderer = TransportGGX(TransportGGXOptions(steps=count))
            solver = renderer.prepare(scene, train)
            found = solver.fit(rung, None, range(len(train.views)), 1.0, lambda share: None)
            seconds = time.perf_counter() - began
            unseen = renderer.prepare(scene, test)
            figures = [
                float(np.mean(-10 * np.log10(s.errors(found, range(len(c.views))))))
                for s, c in ((solver, train), (unseen, test))
            ]
            values = found.unknowns
            lobe = (
                "– | –"
                if values.width is None
                else f"{float(values.specular_albedo.mean()):.3f} | {float(values.alpha.mean()):.3f}"
            )
            print(
                f"| {rung.name} | {count} | {seconds:.1f} | {figures[0]:.2f} | {figures[1]:.2f} | {lobe} |", flush=True
            )


def true_scene(path: Path, capture: Capture) -> Scene:
    """The capture's `reference.obj` in the capture's world, unwrapped, mid-grey."""
    found = trimesh.load(path / "reference.obj", force="mesh", process=False)
    plain = trimesh.Trimesh(found.vertices, found.faces, process=False)
    plain.merge_vertices()
    move = capture.world_from_source
    positions = np.asarray(plain.vertices) @ move[:3, :3].T + move[:3, 3]
    faces = torch.from_numpy(np.asarray(plain.faces, dtype=np.int64))
    mesh = Mesh(torch.from_numpy(positions.astype(np.float32)), Topology(faces))
    size = texture_size(mesh, capture.cameras)
    mesh, _ = unwrap_mesh(mesh, size)
    grey = Material("paper", torch.full((size, size, 3), 0.5), torch.zeros(3), torch.ones(1))
    return replace(Scene(mesh), material=grey)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("bias")
    command = commands.add_parser("fit")
    command.add_argument("capture", type=Path)
    command.add_argument("--steps", type=int, nargs="+", default=[50, 100, 200, 400])
    arguments = parser.parse_args()
    if arguments.command == "bias":
        bias()
    else:
        fit(arguments.capture, arguments.steps)


if __name__ == "__main__":
    main()
