"""Operations of every fit as a formula is written in torch, and as they are computed here: seconds and difference.

    python -m benchmarks.operation_times --store FILE
    python -m benchmarks.operation_times --table FILE

Processor seconds of one thread, the fastest of `REPEATS`; run it alone on the machine. The plain form is written anew,
but for lobes of the BRDF and the points of the disc, and is the reference for the values: the largest difference, as
a share of the largest value.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.nn.functional import normalize

from benchmarks.stored_rows import add_rows, parsed, provenance
from hir_core.optimization.linear_maps import LinearMap
from hir_core.scene import CameraLamp, Scene, Topology
from hir_plugins.geometry_renderers.contour_edges import CameraBatch, EdgeTable, find_segments
from hir_plugins.reflectance_renderers.brdf_torch import schlick_weight, specular_lobe
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import (
    LampPoints,
    lamp_irradiance,
    lamp_lobe,
    turned_disc,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import build_transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.radiance_probes import (
    PROBE_COLUMNS,
    _lobes,
    build_probes,
)
from hir_plugins.regularizers.laplacian import Laplacian
from hir_plugins.regularizers.mesh_options import LaplacianOptions
from tests.fixtures.scenes import icosphere, looking_at

REPEATS = 15
Result = tuple[Tensor, ...]
Operation = tuple[str, Callable[[], Result], Callable[[], Result]]
"""Name, plain form, our form."""


def operations() -> list[Operation]:
    """All of them, on inputs of usual sizes."""
    return [laplacian(), dense_map(), outline_edges(), lamp(), radiance_probes()]


def laplacian() -> Operation:
    """Value and gradient of the Laplacian term with equal weights."""
    mesh = icosphere(6)
    count, edges = len(mesh.positions), mesh.topology.edges
    both = torch.cat([edges, edges.flip(1)])
    share = 1 / torch.bincount(both[:, 0])[both[:, 0]].float()
    diagonal = torch.arange(count)[:, None].expand(-1, 2)
    entries = torch.cat([share, -torch.ones(count)])
    matrix = torch.sparse_coo_tensor(
        torch.cat([both, diagonal]).T, entries, (count, count), check_invariants=False
    ).coalesce()
    energy = Laplacian(LaplacianOptions()).prepare(Scene(mesh))

    def gradient(value: Callable[[Tensor], Tensor]) -> Result:
        positions = mesh.positions.clone().requires_grad_()
        value(positions).backward()
        assert positions.grad is not None
        return (positions.grad,)

    return (
        f"Laplacian term of {count:,} vertices, value and gradient",
        lambda: gradient(lambda x: (matrix @ x).square().sum()),
        lambda: gradient(lambda x: energy(Scene(mesh.with_positions(x)))),
    )


def dense_map() -> Operation:
    """Irradiance of cache cells from a light, and the gradient of the light."""
    generator = torch.Generator().manual_seed(0)
    matrix, dense = torch.rand(6000, 2048, generator=generator), torch.rand(2048, 3, generator=generator)
    linear = LinearMap(matrix, matrix.T.contiguous())

    def gradient(product: Callable[[Tensor], Tensor]) -> Result:
        light = dense.clone().requires_grad_()
        found = product(light)
        found.square().mean().backward()
        assert light.grad is not None
        return found.detach(), light.grad

    return (
        "irradiance of 6,000 cells from 2,048 texels, value and gradient",
        lambda: gradient(lambda x: matrix @ x),
        lambda: gradient(lambda x: linear @ x),
    )


def outline_edges() -> Operation:
    """The edges between triangles on opposite sides, in eight views."""
    mesh = icosphere(6)
    positions = mesh.positions.double()
    positions = positions * (1 + 0.1 * (5 * positions).sin().prod(dim=1, keepdim=True))
    cameras = CameraBatch.of([looking_at((3.0, x, 1.0), 64, 64) for x in range(-4, 4)], torch.device("cpu"))
    faces, topology = mesh.faces, Topology(mesh.faces)
    table = EdgeTable.of(topology)
    edge, face = topology.edge_faces
    pair = face[torch.argsort(edge, stable=True)].reshape(-1, 2)

    def plain() -> Result:
        a, b, c = positions[faces].unbind(1)
        normals = torch.linalg.cross(b - a, c - a)
        seen = normals @ cameras.centers.T > (normals * a).sum(1, keepdim=True)
        edges, view = (seen[pair[:, 0]] != seen[pair[:, 1]]).nonzero(as_tuple=True)
        return (torch.stack([edges, view]).double(),)

    def ours() -> Result:
        segments = find_segments(positions, faces, table, cameras)
        edges = segments.ends.double() @ torch.tensor([len(positions), 1.0], dtype=torch.float64)
        known = topology.edges.double() @ torch.tensor([len(positions), 1.0], dtype=torch.float64)
        return (torch.stack([torch.searchsorted(known, edges), segments.view]).double(),)

    return f"outline edges of {len(faces):,} triangles in 8 views", plain, ours


def lamp() -> Operation:
    """Both parts of the BRDF under a disc of eight points, and the gradients of lamp and α."""
    count, generator = 62_000, torch.Generator().manual_seed(0)
    position = torch.rand(count, 3, generator=generator) - 0.5
    camera = looking_at((0.6, 1.0, 3.5), 64, 64)
    rotation = torch.from_numpy(camera.world_to_camera[:3, :3]).float()
    toward = torch.from_numpy(camera.center).float() - position
    eye = normalize(toward, dim=1)
    normal = normalize(eye + 0.5 * (torch.rand(count, 3, generator=generator) - 0.5), dim=1)
    disc = turned_disc(count, position)
    in_camera = (vector @ rotation.T for vector in (toward, normal, eye))
    axes, lit = rotation.expand(count, 3, 3), torch.ones(disc.shape[:2], dtype=torch.bool)
    points = LampPoints(*in_camera, axes, position, None, disc, lit)  # type: ignore[arg-type,call-arg]

    def parts(lamp: CameraLamp, alpha: Tensor) -> Result:
        place = lamp.offset[:2] + lamp.radius * disc
        shift = place[..., :1] * rotation[0] + place[..., 1:] * rotation[1] + lamp.offset[2] * rotation[2]
        rays = toward[:, None] + shift
        square = rays.square().sum(dim=2, keepdim=True)
        direction = rays / square.sqrt()
        emission = (-(direction * rotation[2]).sum(dim=2, keepdim=True)).clamp_min(1e-3) ** lamp.exponent
        arriving = lamp.intensity * (emission / square)
        half = normalize(direction + eye[:, None], dim=2)
        n_wi, n_h = ((normal[:, None] * v).sum(dim=2, keepdim=True) for v in (direction, half))
        n_wo = (normal * eye).sum(dim=1)[:, None, None]
        sin2 = torch.linalg.cross(normal[:, None].expand_as(half), half).square().sum(dim=2, keepdim=True)
        white = arriving * specular_lobe(alpha, n_wi, n_wo, n_h, sin2)
        grazing = white * schlick_weight((half * eye[:, None]).sum(dim=2, keepdim=True))
        return (arriving * n_wi.clamp(0, 1)).mean(dim=1), white.mean(dim=1), grazing.mean(dim=1)

    def ours(lamp: CameraLamp, alpha: Tensor) -> Result:
        rays = points.rays(lamp)
        return lamp_irradiance(rays), *lamp_lobe(rays, alpha)

    def gradients(shaded: Callable[[CameraLamp, Tensor], Result]) -> Result:
        values = [torch.tensor(v) for v in ([30.0, 20.0, 10.0], [0.1, -0.2, 0.05], 3.0, 0.3, [[0.2]])]
        leaves = [value.requires_grad_() for value in values]
        found = shaded(CameraLamp(*leaves[:4]), leaves[4])
        torch.stack([part.mean() for part in found]).sum().backward()
        return tuple(part.detach() for part in found) + tuple(leaf.grad for leaf in leaves if leaf.grad is not None)

    return (
        f"lamp with 8 points before {count:,} pixels, value and gradient",
        lambda: gradients(parts),
        lambda: gradients(ours),
    )


def radiance_probes() -> Operation:
    """The light in every lobe of a table of directions and widths, for each cell of a cache."""
    transport = build_transport(icosphere(5), 40_000, 1_000, (64, 128), 32, "cpu")
    seen, cells = (transport.diffuse.sky.matrix > 0).float(), len(transport.irradiance_cache)
    generator = torch.Generator().manual_seed(0)
    sky = torch.rand(seen.shape[1], 3, generator=generator)
    leaving = torch.rand(cells, 3, generator=generator)
    lobes = _lobes(32, 64, PROBE_COLUMNS).flatten(1).T.contiguous()

    def plain() -> Result:
        occluded = 1 - seen @ lobes
        mean = leaving.mean(dim=0)  # no cell of a sphere sees another
        return tuple((seen * sky[:, c]) @ lobes + occluded * mean[c] for c in range(3))

    def ours() -> Result:
        return build_probes(transport, sky, leaving).radiance.flatten(1, 2).float().unbind(2)

    return f"light in lobes of 7 widths and 1,152 directions, {cells:,} cells", plain, ours


def measured(operation: Operation) -> dict[str, Any]:
    """The stored line of an operation."""
    name, plain, ours = operation
    pairs = zip(plain(), ours(), strict=True)
    difference = max(float((a - b).abs().max() / a.abs().max().clamp_min(1e-30)) for a, b in pairs)
    seconds = {"plain_seconds": _seconds(plain), "seconds": _seconds(ours)}
    return {"operation": name, "difference": difference, **seconds, **provenance()}


def _seconds(run: Callable[[], Result]) -> float:
    best = float("inf")
    for _ in range(REPEATS):
        began = time.process_time()
        run()
        best = min(best, time.process_time() - began)
    return best


def table(rows: list[dict[str, Any]]) -> str:
    """One line for each operation."""
    lines = ["| operation | as written, ms | here, ms | ratio | largest difference |", "|---|---|---|---|---|"]
    for row in rows:
        plain, ours = 1000 * row["plain_seconds"], 1000 * row["seconds"]
        lines.append(
            f"| {row['operation']} | {plain:.1f} | {ours:.1f} | {plain / ours:.1f} | {row['difference']:.1g} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--store", type=Path, default=Path("operation_times.jsonl"), help="file of stored lines")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    given = parsed(parser, table)
    torch.set_num_threads(1)
    for operation in operations():
        row = measured(operation)
        print(table([row]).splitlines()[-1], flush=True)
        add_rows(given.store, [row])


if __name__ == "__main__":
    main()
