"""What silhouettes are compared by, and the sRGB curve that colours are compared on."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hir_exporters import conventions

from hir_core.capture import Camera, Pixels, View
from hir_core.errors import CaptureError
from hir_core.scene.silhouette_targets import SilhouetteTargets, intersection_over_union
from hir_core.scene.srgb import linear_to_srgb, srgb_slope, srgb_to_linear

INTRINSICS = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
CAMERA = Camera(INTRINSICS, np.eye(4), 8, 6)


def view(name: str, mask: np.ndarray | None, camera: Camera | None = CAMERA) -> View:
    pixels = Pixels(np.zeros((6, 8, 3), np.float32), mask, np.zeros((6, 8), bool))
    return View(name, camera, lambda: pixels)


def test_overlap_is_judged_by_intersection_over_union() -> None:
    area, shared, mask = (
        torch.tensor(v, dtype=torch.float64) for v in ([6.0, 4, 0, 5], [3.0, 4, 0, 0], [5.0, 4, 0, 0])
    )
    found = intersection_over_union(area, shared, mask)
    torch.testing.assert_close(found, torch.tensor([3 / 8, 1.0, 1.0, 0.0], dtype=torch.float64), rtol=0, atol=1e-6)
    assert bool((found <= 1).all())


def test_its_slopes_are_those_of_the_formula_and_an_empty_mask_shrinks() -> None:
    area = torch.tensor([6.0, 5.0], dtype=torch.float64, requires_grad=True)
    shared = torch.tensor([3.0, 0.0], dtype=torch.float64, requires_grad=True)
    mask = torch.tensor([5.0, 0.0])
    intersection_over_union(area, shared, mask).sum().backward()
    assert area.grad is not None and shared.grad is not None
    # I / (A + M − I): −I / U² and (U + I) / U²
    assert area.grad[0].item() == pytest.approx(-3 / 64, rel=1e-5)
    assert shared.grad[0].item() == pytest.approx((8 + 3) / 64, rel=1e-5)
    assert -1e-6 < area.grad[1].item() < 0


def test_targets_are_masks_with_their_cameras() -> None:
    rng = np.random.default_rng(0)
    masks = [rng.uniform(-0.5, 1.5, (6, 8)).astype(np.float32) for _ in range(3)]
    targets = SilhouetteTargets.from_views([view(str(i), m) for i, m in enumerate(masks)])
    assert len(targets) == 3 and targets.masks[0].dtype == torch.float32
    for found, mask in zip(targets.masks, masks, strict=True):
        np.testing.assert_array_equal(found, mask.clip(0, 1))
    np.testing.assert_allclose(targets.areas, [m.clip(0, 1).astype(np.float64).sum() for m in masks], rtol=1e-12)
    assert targets.areas.dtype == torch.float64
    some = targets[[2, 0]]
    assert (
        len(some) == 2 and torch.equal(some.masks[0], targets.masks[2]) and torch.equal(some.masks[1], targets.masks[0])
    )
    assert targets[[]].areas.shape == (0,) and targets[[]].areas.dtype == torch.float64
    moved = targets.to(torch.device("meta"))
    assert moved.masks[0].device.type == "meta" and moved.cameras == targets.cameras


def test_smaller_targets_have_smaller_cameras() -> None:
    mask = np.zeros((6, 8), np.float32)
    mask[:2, :2] = 1
    mask[2, 2] = 1
    half = SilhouetteTargets.from_views([view("a", mask)], downsample=2)
    assert half.masks[0].shape == (3, 4) and (half.cameras[0].width, half.cameras[0].height) == (4, 3)
    assert half.masks[0][0, 0] == 1 and half.masks[0][1, 1] == 0.25 and float(half.masks[0].sum()) == 1.25
    np.testing.assert_allclose(half.cameras[0].intrinsics, [[4, 0, 2], [0, 4, 1.5], [0, 0, 1]])


def test_what_cannot_be_compared_is_named() -> None:
    full = np.ones((6, 8), np.float32)
    with pytest.raises(CaptureError, match=r"^view b has no camera; run an initializer that finds cameras first$"):
        SilhouetteTargets.from_views([view("a", full), view("b", full, None)])
    with pytest.raises(CaptureError, match=r"^view c has no mask; set mask sources with --set"):
        SilhouetteTargets.from_views([view("c", None)])
    sick = full.copy()
    sick[1, 1] = np.inf
    with pytest.raises(CaptureError, match=r"^the mask of view d holds values that are not finite; write it again$"):
        SilhouetteTargets.from_views([view("d", sick)])


def test_the_curve_on_tensors_is_the_curve_on_arrays() -> None:
    linear = torch.tensor([-1.0, 0.0, 1e-4, 0.0031308, 0.0032, 0.05, 0.5, 1.0, 7.0], dtype=torch.float64)
    wanted = conventions.linear_to_srgb(linear.clamp_min(0).numpy())
    np.testing.assert_allclose(linear_to_srgb(linear), wanted, rtol=1e-12)
    encoded = torch.tensor([0.0, 0.02, 0.04045, 0.041, 0.3, 1.0, 2.0], dtype=torch.float64)
    np.testing.assert_allclose(srgb_to_linear(encoded), conventions.srgb_to_linear(encoded.numpy()), rtol=1e-12)


def test_its_slope_is_its_derivative_and_finite_at_black() -> None:
    x = torch.tensor([0.0, 1e-4, 0.0031, 0.0033, 0.2, 1.0, 5.0], dtype=torch.float64, requires_grad=True)
    linear_to_srgb(x).sum().backward()
    assert x.grad is not None
    np.testing.assert_allclose(srgb_slope(x.detach()), x.grad, rtol=1e-12)
    step = 1e-7
    there = [linear_to_srgb(x.detach() + sign * step) for sign in (-1, 1)]
    np.testing.assert_allclose(x.grad[1:], ((there[1] - there[0]) / (2 * step))[1:], rtol=1e-5)
    assert x.grad[0].item() == pytest.approx(12.92)
    y = torch.tensor([0.0, 0.02, 0.5], dtype=torch.float64, requires_grad=True)
    srgb_to_linear(y).sum().backward()
    assert y.grad is not None
    np.testing.assert_allclose(y.grad, [1 / 12.92, 1 / 12.92, 2.4 / 1.055 * (0.555 / 1.055) ** 1.4], rtol=1e-12)
