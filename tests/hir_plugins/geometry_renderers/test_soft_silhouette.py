"""`soft_silhouette` against the formula over all pairs in float64."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.contour_edges import CameraBatch
from hir_plugins.geometry_renderers.options import ContourOptions, SoftSilhouetteOptions
from hir_plugins.geometry_renderers.soft_silhouette import SoftSilhouette
from hir_plugins.geometry_renderers.soft_tiles import Kernel, gather_tiles
from tests.fixtures.meshes import bumpy_sphere, camera, facing, icosphere, mesh_of, targets_of, torus


def all_pairs(pixels: Tensor, faces: Tensor, height: int, width: int, sigma: float, cutoff: float) -> Tensor:
    """METHOD: S = 1 − Π (1 − D), D = sigmoid(δ d²/σ), D below the cutoff is nothing. Autograd does the derivative."""
    unit = 2 / max(height, width)
    y, x = torch.meshgrid(torch.arange(height).double() + 0.5, torch.arange(width).double() + 0.5, indexing="ij")
    p = torch.stack([x, y], dim=-1).reshape(-1, 1, 2)
    corners = pixels[faces]
    distances, sides = [], []
    for k in range(3):
        a, b = corners[None, :, k], corners[None, :, (k + 1) % 3]
        edge, offset = b - a, p - a
        t = ((offset * edge).sum(-1) / edge.square().sum(-1)).clamp(0, 1)
        distances.append((offset - t[..., None] * edge).square().sum(-1) * unit**2)
        sides.append(edge[..., 0] * offset[..., 1] - edge[..., 1] * offset[..., 0])
    side = torch.stack(sides)
    inside = (side > 0).all(0) | (side < 0).all(0)
    d2 = torch.stack(distances).amin(0)
    presence = torch.sigmoid(torch.where(inside, d2, -d2) / sigma)
    return (1 - (1 - torch.where(presence < cutoff, 0.0, presence)).prod(dim=1)).reshape(height, width)


@pytest.mark.parametrize("tile", [1, 4, 16])
@pytest.mark.parametrize(
    ("make", "eye"),
    [
        (lambda: bumpy_sphere(2), (3.0, 1.0, 0.5)),
        (lambda: torus(16, 8), (0.4, 0.3, 3.2)),
        (lambda: icosphere(0), (1.2, 0.3, 0.8)),
    ],
    ids=["bumpy", "torus", "close"],
)
def test_value_and_gradient_are_those_of_all_pairs(make, eye: tuple[float, float, float], tile: int) -> None:
    view = camera(48, eye, height=40)
    weight = torch.rand(40, 48, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    options = SoftSilhouetteOptions(sigma=3e-4, tile=tile)
    mesh = mesh_of(*make(), torch.float64, grad=True)
    soft = SoftSilhouette(options).render(mesh, [view])[0]
    (soft * weight).sum().backward()
    found = mesh.positions.grad.clone()
    mesh.positions.grad = None
    pixels = CameraBatch.of([view], torch.device("cpu")).project(
        mesh.positions, torch.zeros(len(mesh.positions), dtype=int)
    )
    exact = all_pairs(pixels, mesh.faces, 40, 48, options.sigma, options.cutoff)
    (exact * weight).sum().backward()
    # a tile that is taken as full may hide 1e-6 of value, and of that much gradient
    assert float((soft - exact).detach().abs().max()) < 1e-6
    assert float((found - mesh.positions.grad).abs().max()) < 1e-4 * float(mesh.positions.grad.abs().max())


def test_shared_edges_lower_the_value_by_design() -> None:
    # a pixel centre on the edge that two large triangles share: D = ½ of both, S = ¾
    square = np.array([[0, 0, 0], [32, 0, 0], [32, 32, 0], [0, 32, 0]], float)
    image = SoftSilhouette(SoftSilhouetteOptions()).render(
        mesh_of(square, np.array([[0, 1, 2], [0, 2, 3]])), [facing(32)]
    )[0]
    assert torch.diagonal(image)[8:24].numpy() == pytest.approx(0.75, abs=1e-5)


def test_tiles_are_left_out_only_when_proven() -> None:
    positions, faces = icosphere(1)
    flat = positions * [100, 100, 0] + [128, 128, 0]
    kernel = Kernel(1e-4 * 128**2, 1e-4, 4)
    tiles = gather_tiles(torch.tensor(flat[faces][:, :, :2]), 256, 256, kernel)
    assert len(tiles.full) > 0
    image = tiles.to_image(torch.full((len(tiles.open), 16), math.nan, dtype=torch.float64), full=1.0)
    coverage = Contour(ContourOptions()).render(mesh_of(flat, faces), [facing(256)])
    assert float(coverage[0][image == 1].min()) == 1.0
    # 0 stands nowhere within the kernel's reach of the silhouette
    reach = int(kernel.reach)
    near = torch.nn.functional.max_pool2d(coverage, 2 * reach + 1, 1, reach)[0] > 0
    cross = torch.zeros_like(near)
    for shift in range(-reach, reach + 1):
        cross |= torch.roll(coverage[0], shift, 0).gt(0) | torch.roll(coverage[0], shift, 1).gt(0)
    assert not bool((cross & near & (image == 0)).any())


def test_a_band_changes_the_gradient_little() -> None:
    positions, faces = bumpy_sphere(4)
    view = camera(128, (3.0, 1.0, 0.5))
    target = targets_of([view], [np.tile(np.linspace(0, 1, 128), (128, 1))])
    gradients = []
    for band in (0, 8):
        mesh = mesh_of(positions, faces, grad=True)
        _, shared = SoftSilhouette(SoftSilhouetteOptions(band=band)).overlap(mesh, target)
        shared.sum().backward()
        gradients.append(mesh.positions.grad.double())
    # what a band leaves out are the dents of S along inner edges
    assert float((gradients[1] - gradients[0]).norm() / gradients[0].norm()) < 0.2


def test_a_sharp_kernel_approaches_the_exact_silhouette() -> None:
    positions, faces = icosphere(3)
    target = targets_of([camera(128, (3.0, 1.0, 0.5))])
    exact = Contour(ContourOptions()).overlap(mesh_of(positions, faces), target)[0].item()
    errors = [
        abs(
            SoftSilhouette(SoftSilhouetteOptions(sigma=sigma)).overlap(mesh_of(positions, faces), target)[0].item()
            - exact
        )
        for sigma in (1e-4, 1e-5, 1e-6)
    ]
    assert errors[0] > errors[1] > errors[2] and errors[2] < 0.01 * exact
