"""Linear maps and the ray tracer, against NumPy."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hir_core.optimization.linear_maps import LARGE_MATRIX, LinearMap, SparsityPattern
from hir_plugins.reflectance_renderers import ray_tracer

ROWS, WIDTH, ENTRIES = 50, 30, 7


def random_rows() -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Columns, values, and the same matrix with all entries; some columns occur twice in a row."""
    generator = torch.Generator().manual_seed(0)
    columns = torch.randint(0, WIDTH, (ROWS, ENTRIES), generator=generator, dtype=torch.int32)
    values = torch.rand(ROWS, ENTRIES, generator=generator)
    full = torch.zeros(ROWS, WIDTH).index_put_(
        (torch.arange(ROWS)[:, None].expand(-1, ENTRIES), columns.long()), values, accumulate=True
    )
    return columns, values, full


@pytest.mark.parametrize("stored", ["all entries", "rows"])
@pytest.mark.parametrize("channels", [1, 3, 9])
def test_value_and_gradient_of_a_map(stored: str, channels: int) -> None:
    columns, values, full = random_rows()
    linear = LinearMap(full) if stored == "all entries" else LinearMap.from_rows(columns, values, WIDTH)
    assert linear.is_dense == (stored == "all entries")
    generator = torch.Generator().manual_seed(1)
    dense = torch.rand(WIDTH, channels, generator=generator, requires_grad=True)
    weight = torch.rand(ROWS, channels, generator=generator)
    product = linear @ dense
    (product * weight).sum().backward()
    assert torch.allclose(product, full @ dense, atol=1e-5)
    assert dense.grad is not None and torch.allclose(dense.grad, full.T @ weight, atol=1e-5)
    assert torch.allclose(linear.T @ weight, full.T @ weight, atol=1e-5)


@pytest.mark.parametrize("size", [(1600, 1500), (70, 40_000)])
def test_a_large_map_is_the_sum_of_its_parts(size: tuple[int, int]) -> None:
    """Against float64; neither number of rows is a multiple of the parts'."""
    rng = np.random.default_rng(0)
    full, right, weight = rng.random(size), rng.random((size[1], 3)), rng.random((size[0], 3))
    linear = LinearMap(torch.from_numpy(full).float())
    dense = torch.from_numpy(right).float().requires_grad_()
    product = linear @ dense
    (product * torch.from_numpy(weight).float()).sum().backward()
    assert full.size > LARGE_MATRIX and dense.grad is not None
    np.testing.assert_allclose(product.detach().numpy(), full @ right, rtol=1e-5)
    np.testing.assert_allclose(dense.grad.numpy(), full.T @ weight, rtol=1e-5)


def test_a_transpose_is_made_only_where_it_is_needed() -> None:
    columns, values, _ = random_rows()
    linear = LinearMap.from_rows(columns, values, WIDTH)
    product = linear @ torch.ones(WIDTH, 3)
    assert product.shape == (ROWS, 3) and linear._transposed is None
    assert linear.transposed is linear.transposed, "and made once"


def test_a_pattern_transposes_other_values() -> None:
    columns, values, full = random_rows()
    pattern = SparsityPattern(columns, WIDTH)
    assert torch.allclose(pattern.matrix(values).to_dense(), full, atol=1e-6)
    assert torch.allclose(pattern.transposed(2 * values).to_dense(), 2 * full.T, atol=1e-6)


def test_rays_are_traced_once_for_all_results(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each array that is read before an evaluation would launch a kernel of its own."""
    import drjit as dr

    triangle = np.array([[-1, -1, 0], [1, -1, 0], [0, 1, 0]], np.float32)
    tracer = ray_tracer.RayTracer(triangle, np.array([[0, 1, 2]], np.int32))
    origins = np.array([[0, 0, 2], [5, 5, 2], [0, 0.5, 2]], np.float32)
    directions = np.tile(np.array([[0, 0, -1]], np.float32), (3, 1))
    tracer.closest(origins, directions)  # compiles
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        dr.kernel_history_clear()
        hits = tracer.closest(origins, directions)
        launched = [entry for entry in dr.kernel_history() if entry["type"] == dr.KernelType.JIT]
    assert len(launched) == 1
    assert hits.face.tolist() == [0, -1, 0]
    corners = np.concatenate([1 - hits.barycentric.sum(axis=1, keepdims=True), hits.barycentric], axis=1)
    assert np.allclose((corners @ triangle)[[0, 2]], [[0, 0, 0], [0, 0.5, 0]], atol=1e-6)
