"""Bilateral means: the definition, the fast sum against all pairs, its bound, its gradients, its cost, hard inputs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from hir_exporters.conventions import direction_to_latlong_uv
from torch import Tensor

from hir_core.errors import StageError
from hir_core.scene import Material, Scene, Topology
from hir_core.stages.atlas import unwrap_mesh
from hir_plugins.regularizers.bilateral.bilateral_grid import Cubes, cells_of, cubes_of, tiles_of
from hir_plugins.regularizers.bilateral.bilateral_pairs import deviation_of_pairs, weight_error
from hir_plugins.regularizers.bilateral.bilateral_specular import BilateralSpecular
from hir_plugins.regularizers.bilateral.grid_deviation import absolute_deviation
from hir_plugins.regularizers.bilateral.joint_bilateral import JointBilateral
from hir_plugins.regularizers.material_options import BilateralSpecularOptions, JointBilateralOptions
from hir_plugins.regularizers.surface_samples import sample_surface
from tests.fixtures.scenes import bumpy_sphere

DEFAULTS = BilateralSpecularOptions()
CUTOFF, CELL = DEFAULTS.cutoff, DEFAULTS.cell_size


def textured(subdivisions: int = 2, size: int = 16, dtype: torch.dtype = torch.float64) -> Scene:
    """Two diffuse colours with noise, specular and roughness noise."""
    torch.manual_seed(0)
    mesh = bumpy_sphere(subdivisions)
    uvs = torch.from_numpy(direction_to_latlong_uv(mesh.positions.numpy())).float()
    mesh = replace(mesh, uvs=uvs, topology=Topology(mesh.faces, mesh.faces))
    stripes = (torch.arange(size) // 4 % 2).to(dtype)[None, :, None] * 0.4 + 0.3
    diffuse = stripes + 0.05 * torch.rand(size, size, 3, dtype=dtype)
    specular = 0.04 + 0.2 * torch.rand(size, size, 3, dtype=dtype)
    return Scene(mesh, Material("paper", diffuse, specular, 0.2 + 0.3 * torch.rand(size, size, 1, dtype=dtype)))


def surface(count: int, per_width: float, noise: float) -> tuple[Tensor, Tensor, Tensor]:
    """Samples on a sphere, `per_width` to a square σ1, two colours with noise in σ2, values of white noise; float64."""
    generator = torch.Generator().manual_seed(0)
    x = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator, dtype=torch.float64), dim=1)
    radius = (count / per_width / (4 * np.pi)) ** 0.5
    colors = 4 + 2 * torch.sign(torch.sin(6 * x[:, :1])) * torch.tensor([1.0, 0.6, 0.3], dtype=torch.float64)
    guide = colors + noise * torch.randn(count, 3, generator=generator, dtype=torch.float64)
    return radius * x, guide, 0.04 + 0.1 * torch.rand(count, 3, generator=generator, dtype=torch.float64)


def deviation_by_grid(cubes: Cubes, guide: Tensor, values: Tensor, edge: float) -> Tensor:
    return absolute_deviation(cubes, guide, values, edge)[1]


def definition(positions: np.ndarray, diffuse: np.ndarray, specular: np.ndarray, s1: float, s2: float) -> float:
    """METHOD: a loop over p, nothing shared with the code."""
    total = 0.0
    for p in range(len(positions)):
        k = np.exp(
            -((positions[p] - positions) ** 2).sum(1) / (2 * s1**2) - ((diffuse[p] - diffuse) ** 2).sum(1) / (2 * s2**2)
        )
        total += np.abs(specular[p] - (k[:, None] * specular).sum(0) / k.sum()).sum()
    return total


def with_maps(scene: Scene, diffuse: Tensor, specular: Tensor) -> Scene:
    assert scene.material is not None
    return replace(scene, material=replace(scene.material, diffuse_albedo=diffuse, specular_albedo=specular))


def assert_gradient_close(value: Callable[..., Tensor], leaves: list[Tensor], rtol: float) -> None:
    """Central differences along a random direction of each leaf."""
    tracked = [leaf.clone().requires_grad_() for leaf in leaves]
    gradients = torch.autograd.grad(value(*tracked), tracked)
    for which, gradient in enumerate(gradients):
        direction = torch.randn(gradient.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(which))
        sides = []
        for sign in (1, -1):
            moved = list(leaves)
            moved[which] = moved[which] + sign * 1e-7 * direction
            sides.append(float(value(*moved)))
        assert float(gradient.abs().max()) > 0
        assert float((gradient * direction).sum()) == pytest.approx((sides[0] - sides[1]) / 2e-7, rel=rtol)


@pytest.mark.parametrize("samples", ["vertices", "texels"])
@pytest.mark.parametrize("method", ["all_pairs", "grid"])
def test_bilateral_is_the_papers_sum(samples: str, method: str) -> None:
    """The reference to the rounding of float32 positions; the fast sum, of few samples in small cells, nearly."""
    scene = textured()
    assert scene.material is not None
    options = BilateralSpecularOptions(0.1, samples, method, cutoff=7.0, cell_size=0.01, sigma_albedo=0.2)  # type: ignore[arg-type]
    value = float(BilateralSpecular(options).prepare(scene)(scene))
    spots = sample_surface(scene.mesh, samples, (16, 16))  # type: ignore[arg-type]
    positions = spots.positions.double().numpy()
    diagonal = float(np.linalg.norm(positions.max(0) - positions.min(0)))
    maps = [spots.values(m).numpy() for m in (scene.material.diffuse_albedo, scene.material.specular_albedo)]
    assert value == pytest.approx(definition(positions, maps[0], maps[1], 0.1 * diagonal, 0.2), rel=1e-5)


@pytest.mark.parametrize("method", ["all_pairs", "grid"])
@pytest.mark.parametrize("samples", ["vertices", "texels"])
def test_gradients_match_finite_differences(method: str, samples: str) -> None:
    scene = textured()
    assert scene.material is not None
    material = scene.material
    paper = BilateralSpecular(BilateralSpecularOptions(0.1, samples, method, sigma_albedo=0.2)).prepare(scene)  # type: ignore[arg-type]
    joint = JointBilateral(JointBilateralOptions(0.1, samples, method)).prepare(scene)  # type: ignore[arg-type]
    maps = [material.diffuse_albedo, material.specular_albedo]
    assert_gradient_close(lambda *m: paper(with_maps(scene, *m)), maps, 1e-5)
    maps.append(material.roughness)

    def joined(diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Tensor:
        there = with_maps(scene, diffuse, specular)
        assert there.material is not None
        return joint(replace(there, material=replace(there.material, roughness=roughness)))

    assert_gradient_close(joined, maps, 1e-5)


@pytest.mark.parametrize(
    ("per_width", "noise", "value", "deviation", "by_guide", "by_value"),
    [
        pytest.param(8, 0.3, 1e-3, 0.006, 0.15, 0.08, id="vertices"),
        pytest.param(60, 0.3, 2e-4, 0.004, 0.25, 0.06, id="texels"),
        pytest.param(60, 4.0, 3e-4, 0.003, 0.04, 0.01, id="albedo of white noise"),
    ],
)
def test_error_against_all_pairs(
    per_width: float, noise: float, value: float, deviation: float, by_guide: float, by_value: float
) -> None:
    """The contract of docs/regularizers.md on white noise, the worst case: of the sum, of deviations relative to the
    spread of the values (root mean square), of both gradients as vectors. An L1 sum's gradient is one of signs: a
    deviation of nearly 0 that changes its sign counts fully.
    """
    positions, guide, values = surface(2000, per_width, noise)
    leaves = [guide.requires_grad_(), values.requires_grad_()]
    cubes = cubes_of(positions, CUTOFF, CELL)
    total, found = absolute_deviation(cubes, guide, values, CELL)
    assert not found.requires_grad
    assert float(total.detach()) == pytest.approx(float(found.abs().sum()), rel=1e-12)
    true = deviation_of_pairs(positions, guide, values)
    ratio = (found.abs().sum() / true.abs().sum()).detach()
    assert abs(float(ratio) - 1) < value
    assert float(((found - true).square().mean().sqrt() / values.std()).detach()) < deviation
    pairs = [torch.autograd.grad(sum_, leaves) for sum_ in (total, true.abs().sum())]
    for ours, exact, most in zip(*pairs, (by_guide, by_value), strict=True):
        assert float((ours - exact).norm() / exact.norm()) < most


@pytest.mark.parametrize(("per_width", "noise"), [(8, 0.3), (60, 0.3), (60, 4.0)])
def test_no_mean_leaves_its_bound(per_width: float, noise: float) -> None:
    """At every sample; for noise, for values that follow the guide, and for waves that no cell resolves."""
    positions, guide, values = surface(1200, per_width, noise)
    cubes = cubes_of(positions, CUTOFF, CELL)
    bound = weight_error(cubes, guide, CELL)
    against = (guide - guide.roll(1, 0) > 0).double()
    waves = (torch.sin(3 * positions) > 0).double()
    for held in (values, against, waves):
        found = held - deviation_by_grid(cubes, guide, held, CELL)
        error = (found - (held - deviation_of_pairs(positions, guide, held))).abs()
        reach = torch.maximum(held.amax(0) - found, found - held.amin(0))
        assert (error <= bound[:, None] * reach + 1e-12).all()
    assert float(bound.max()) < 0.08, "the stated bound, in parts of the range of the values"


def test_narrow_cells_and_a_far_cutoff_are_all_pairs() -> None:
    positions, guide, values = surface(1000, 4, 0.5)
    true = deviation_of_pairs(positions, guide, values)
    errors = []
    for cell, cutoff in ((1.0, 3.0), (0.5, 4.0), (0.25, 5.0), (0.01, 8.0)):
        found = deviation_by_grid(cubes_of(positions, cutoff, cell), guide, values, cell)
        errors.append(float((found - true).abs().max()))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-12


def test_the_order_of_samples_does_not_matter() -> None:
    positions, guide, values = surface(1000, 20, 0.5)
    shuffled = torch.randperm(1000, generator=torch.Generator().manual_seed(0))
    one = deviation_by_grid(cubes_of(positions, CUTOFF, CELL), guide, values, CELL)
    other = deviation_by_grid(cubes_of(positions[shuffled], CUTOFF, CELL), guide[shuffled], values[shuffled], CELL)
    assert torch.allclose(one[shuffled], other, rtol=0, atol=1e-12)


def test_pairs_grow_linearly() -> None:
    """Four times the texels of one surface make four times the pairs of sample and cell, not sixteen."""
    pairs = []
    for count in (8_000, 32_000):
        positions, guide, values = surface(count, count / 200, 0.1)
        cubes = cubes_of(positions, CUTOFF, CELL)
        pairs.append(
            sum(
                int(tile.is_cell.sum(1) @ tile.is_sample.sum(1))
                for tile in tiles_of(cubes, cells_of(cubes, guide, values, CELL))
            )
        )
    assert 4 <= pairs[1] / pairs[0] < 6
    assert pairs[1] < 0.05 * 32_000**2


@pytest.mark.parametrize("method", ["grid", "all_pairs"])
def test_flat_maps_cost_exactly_nothing(method: str) -> None:
    scene = textured()
    assert scene.material is not None
    energy = BilateralSpecular(BilateralSpecularOptions(0.1, "texels", method)).prepare(scene)  # type: ignore[arg-type]
    flat = torch.full((16, 16, 3), 0.04, dtype=torch.float64, requires_grad=True)
    diffuse = scene.material.diffuse_albedo.clone().requires_grad_()
    value = energy(with_maps(scene, diffuse, flat))
    assert float(value.detach()) == 0
    for gradient in torch.autograd.grad(value, (flat, diffuse)):
        assert float(gradient.abs().max()) == 0
    joint = JointBilateral(JointBilateralOptions(0.1, method=method)).prepare(scene)  # type: ignore[arg-type]
    even = replace(scene.material, diffuse_albedo=flat, specular_albedo=flat, roughness=flat[..., :1])
    assert float(joint(replace(scene, material=even)).detach()) == 0


def test_specular_that_follows_edges_of_colour_costs_little() -> None:
    scene = textured()
    stripes = (torch.arange(16) // 4 % 2).double()[None, :, None].expand(16, 16, 3)
    for energy in (
        BilateralSpecular(BilateralSpecularOptions(0.1, sigma_albedo=0.05)).prepare(scene),
        JointBilateral(JointBilateralOptions(0.1, diffuse_albedo=0.0, roughness=0.0, sigma_specular=1.0)).prepare(
            scene
        ),
    ):
        follows = float(energy(with_maps(scene, stripes * 0.4 + 0.3, stripes * 0.2)))
        alone = float(energy(with_maps(scene, torch.full_like(stripes, 0.5), stripes * 0.2)))
        assert follows < 0.3 * alone


@pytest.mark.parametrize("method", ["grid", "all_pairs"])
@pytest.mark.parametrize("joint", [False, True])
def test_near_has_the_value_and_gradient_of_the_term_at_its_scene(method: str, joint: bool) -> None:
    """And the paper's is closer to the term than a linear function where values have crossed their means."""
    scene = textured()
    assert scene.material is not None
    term = (
        JointBilateral(JointBilateralOptions(0.1, method=method))  # type: ignore[arg-type]
        if joint
        else BilateralSpecular(BilateralSpecularOptions(0.1, "texels", method, average=True))  # type: ignore[arg-type]
    )
    energy: Any = term.prepare(scene)
    near = energy.near(scene)
    maps = [scene.material.diffuse_albedo, scene.material.specular_albedo]
    values, gradients = [], []
    for function in (energy, near):
        leaves = [each.clone().requires_grad_() for each in maps]
        value = function(with_maps(scene, *leaves))
        values.append(float(value.detach()))
        gradients.append(torch.autograd.grad(value, leaves))
    assert values[1] == pytest.approx(values[0], rel=1e-12)
    for one, other in zip(*gradients, strict=True):
        assert torch.allclose(one, other, rtol=1e-9, atol=1e-15)
    step = -0.3 * scene.material.specular_albedo.std() * gradients[0][1].sign()
    moved = with_maps(scene, maps[0], maps[1] + step)
    exact, close = float(energy(moved)), float(near(moved))
    linear = values[0] + float((gradients[0][1] * step).sum())
    if not joint:  # whose maps are guides too: their change moves the means
        assert abs(close - exact) < 0.5 * abs(linear - exact)


@pytest.mark.parametrize("samples", ["vertices", "texels"])
def test_a_grey_map_has_the_value_and_gradient_of_three_channels(samples: str) -> None:
    """Which are computed once; the gradient still belongs to each channel."""
    scene = textured()
    assert scene.material is not None
    grey = scene.material.specular_albedo[..., :1].expand(-1, -1, 3)
    found = []
    for method in ("grid", "all_pairs"):
        config = BilateralSpecularOptions(0.1, samples, method, cutoff=7.0, cell_size=0.01, sigma_albedo=0.2)  # type: ignore[arg-type]
        energy = BilateralSpecular(config).prepare(scene)
        for tint in (0.0, 1e-9):
            maps = [scene.material.diffuse_albedo, grey + tint * torch.tensor([0.0, 1.0, 2.0], dtype=torch.float64)]
            leaves = [each.clone().requires_grad_() for each in maps]
            value = energy(with_maps(scene, *leaves))
            found.append((value.detach()[None], *torch.autograd.grad(value, leaves)))
    for other in found[1:]:
        for one, another in zip(found[0], other, strict=True):
            assert torch.allclose(one, another, rtol=1e-5, atol=1e-7), "a channel of its own for each"


def test_joint_bilateral_smooths_noise_and_keeps_edges_of_any_map() -> None:
    """Descent on the term alone: noise of ρd goes, an edge that only the roughness shows stays where it was."""
    scene = textured(3)
    generator = torch.Generator().manual_seed(2)
    edge = (torch.arange(16) >= 8).double()[None, :, None].expand(16, 16, 3)
    clean = 0.4 + 0.2 * edge
    start = clean + 0.03 * torch.randn(16, 16, 3, generator=generator, dtype=torch.float64)
    rough = 0.2 + 0.5 * edge[..., :1]
    energy = JointBilateral(JointBilateralOptions(0.15, specular_albedo=0.0, roughness=0.0)).prepare(scene)
    leaf = start.clone().requires_grad_()
    optimizer = torch.optim.Adam([leaf], lr=3e-3)
    assert scene.material is not None
    for _ in range(60):
        optimizer.zero_grad()
        material = replace(
            scene.material, diffuse_albedo=leaf, specular_albedo=torch.zeros(3).double(), roughness=rough
        )
        energy(replace(scene, material=material)).backward()
        optimizer.step()
    seen = sample_surface(scene.mesh, "texels", (16, 16)).values(torch.ones(16, 16, 1).double())[:, 0] > 0
    assert bool(seen.all())
    before, after = (start - clean).square().mean(), (leaf.detach() - clean).square().mean()
    assert float(after) < 0.5 * float(before)
    left, right = leaf.detach()[:, :8].mean(), leaf.detach()[:, 8:].mean()
    assert float(right - left) == pytest.approx(0.2, abs=0.01)


def test_one_sample_no_sample_and_many_at_one_point() -> None:
    values = torch.rand(6, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    guide = torch.zeros(6, 3, dtype=torch.float64)
    for count in (0, 1):
        found = deviation_by_grid(cubes_of(torch.zeros(count, 3), CUTOFF, CELL), guide[:count], values[:count], CELL)
        assert found.shape == (count, 3)
        assert not found.any(), "an isolated sample is its own mean"
    found = deviation_by_grid(cubes_of(torch.ones(6, 3), CUTOFF, CELL), guide, values, CELL)
    assert torch.allclose(found, values - values.mean(0), atol=1e-15), "duplicates are averaged"


def test_what_is_not_finite_is_refused_or_shows() -> None:
    """Broken positions are an error that says so; broken albedo makes a term that is not finite, which fits skip."""
    positions = torch.rand(50, 3)
    positions[7, 1] = float("nan")
    with pytest.raises(StageError, match="not finite"):
        cubes_of(positions, CUTOFF, CELL)
    cubes = cubes_of(torch.rand(50, 3), CUTOFF, CELL)
    for broken in (float("nan"), float("inf")):
        guide = torch.rand(50, 3)
        guide[3] = broken
        assert not torch.isfinite(deviation_by_grid(cubes, guide, torch.rand(50, 3), CELL).sum())


def test_a_width_that_resolves_nothing_is_named() -> None:
    cubes = cubes_of(torch.rand(4, 3), CUTOFF, CELL)
    guide = torch.tensor([[0.0], [1e6], [2.0], [3.0]])
    with pytest.raises(StageError, match="larger sigma"):
        deviation_by_grid(cubes, guide, torch.rand(4, 3), CELL)


def test_over_texels_of_an_atlas_it_stays_finite() -> None:
    mesh, _ = unwrap_mesh(bumpy_sphere(3), 64)
    diffuse, specular = torch.zeros(64, 64, 3, requires_grad=True), torch.rand(64, 64, 3, requires_grad=True)
    scene = Scene(mesh, Material("dielectric", diffuse, specular, torch.ones(1)))
    value = BilateralSpecular(BilateralSpecularOptions(samples="texels", average=True)).prepare(scene)(scene)
    assert torch.isfinite(value)
    for gradient in torch.autograd.grad(value, (diffuse, specular)):
        assert torch.isfinite(gradient).all()


@pytest.mark.parametrize("regularizer", [BilateralSpecular(DEFAULTS), JointBilateral(JointBilateralOptions())])
def test_a_term_without_effect_causes_a_warning(regularizer: BilateralSpecular | JointBilateral) -> None:
    scene = textured()
    assert scene.material is not None
    constant = Material("paper", torch.full((3,), 0.5), torch.full((3,), 0.04, requires_grad=True), torch.ones(1))
    constant = replace(constant, diffuse_albedo=constant.diffuse_albedo.requires_grad_())
    plain = replace(scene, material=constant)
    with pytest.warns(UserWarning, match="has no effect"):
        energy = regularizer.prepare(plain)
    value = energy(plain)
    assert float(value.detach()) == 0
    value.backward()


@pytest.mark.slow
def test_a_million_samples_stay_within_two_gigabytes() -> None:
    """In a process of its own: the peak is that of the term, with what importing torch takes."""
    code = (
        "import torch\n"
        "from hir_core.run.machine import peak_memory_bytes\n"
        "from tests.hir_plugins.regularizers.test_bilateral import surface, cubes_of, absolute_deviation\n"
        "from tests.hir_plugins.regularizers.test_bilateral import CUTOFF, CELL\n"
        "positions, guide, values = (t.float() for t in surface(1_000_000, 300, 0.1))\n"
        "before = peak_memory_bytes()\n"
        "guide.requires_grad_(), values.requires_grad_()\n"
        "total = absolute_deviation(cubes_of(positions, CUTOFF, CELL), guide, values, CELL)[0]\n"
        "total.backward()\n"
        "assert torch.isfinite(guide.grad).all() and torch.isfinite(values.grad).all()\n"
        "print((peak_memory_bytes() - before) / 2**20)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert float(done.stdout) < 2048
