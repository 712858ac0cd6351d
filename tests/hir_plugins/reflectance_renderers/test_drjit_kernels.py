"""Dr.Jit's bilinear lookup, clipped pixels and sRGB against those of torch, and its lat-long coordinates."""

from __future__ import annotations

import numpy as np
import torch
from hir_exporters.conventions import direction_to_latlong_uv

from hir_core.optimization.clipped_pixels import without_clipped_excess
from hir_core.scene.bilinear import axis_neighbours, bilinear_values
from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.drjit_arrays import to_float, to_torch
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on

COUNT = 1000
CPU = torch.device("cpu")


def uniform(low: float, high: float) -> torch.Tensor:
    return low + (high - low) * torch.rand(COUNT, generator=torch.Generator().manual_seed(int(10 * high)))


def test_a_lookup_is_the_one_of_torch() -> None:
    mi = mitsuba_on("cpu")
    import drjit as dr

    from hir_plugins.reflectance_renderers import drjit_bilinear

    image = torch.rand(5, 8, generator=torch.Generator().manual_seed(0))
    x, y = uniform(-0.5, 7.5), uniform(-0.5, 4.5)
    values = to_float(image, mi)
    found = drjit_bilinear.bilinear(
        lambda row, column: dr.gather(mi.Float, values, mi.UInt32(row * 8 + column)),
        drjit_bilinear.repeated(to_float(x, mi), 8),
        drjit_bilinear.extended(to_float(y, mi), 5),
    )
    neighbours = axis_neighbours(x, 8, "repeat"), axis_neighbours(y, 5, "extend")
    expected = bilinear_values(image.reshape(-1, 1), *neighbours, 8)[:, 0]
    assert torch.allclose(to_torch(found, (COUNT,), CPU), expected, atol=1e-6)


def test_directions_beside_the_poles_have_the_coordinates_of_the_conventions() -> None:
    """acos of the height gives the pole itself within 3e-4 rad."""
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.drjit_latlong import latlong_coordinates

    angle = np.array([1e-6, 1e-5, 1e-4, 3e-4, 1e-3])
    d = np.stack([np.sin(angle), np.cos(angle), 0 * angle]).astype(np.float32)
    for sign, v in ((1, angle / np.pi), (-1, 1 - angle / np.pi)):
        found = latlong_coordinates(mi.Vector3f(d[0], sign * d[1], d[2]))[1]
        assert np.allclose(np.array(found), v, rtol=1e-6, atol=1e-7 if sign < 0 else 0)


def test_coordinates_are_those_of_the_conventions() -> None:
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.drjit_latlong import latlong_coordinates

    d = np.random.default_rng(0).normal(size=(COUNT, 3)).astype(np.float32)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    found = latlong_coordinates(mi.Vector3f(*np.ascontiguousarray(d.T)))
    assert np.allclose(np.array(found).reshape(2, COUNT).T, direction_to_latlong_uv(d), atol=1e-6)


def test_clipped_pixels_and_srgb_are_those_of_torch() -> None:
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers import drjit_clipped_pixels, drjit_srgb

    difference, clipped = uniform(-1.0, 1.0), torch.arange(COUNT) % 2 == 0
    found = drjit_clipped_pixels.without_clipped_excess(to_float(difference, mi), to_float(clipped.float(), mi) > 0.5)
    assert torch.equal(to_torch(found, (COUNT,), CPU), without_clipped_excess(difference, clipped))
    linear = uniform(0.0, 1.2)
    value, slope = drjit_srgb.linear_to_srgb_and_slope(to_float(linear, mi))
    assert torch.allclose(to_torch(value, (COUNT,), CPU), linear_to_srgb(linear), atol=1e-6)
    leaf = linear.double().requires_grad_()
    (expected,) = torch.autograd.grad(linear_to_srgb(leaf).sum(), leaf)
    assert torch.allclose(to_torch(slope, (COUNT,), CPU).double(), expected, rtol=1e-4)
