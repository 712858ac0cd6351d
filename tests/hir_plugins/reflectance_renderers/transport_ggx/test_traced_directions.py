"""Directions that one kernel draws and traces, against the same in torch."""

from __future__ import annotations

from dataclasses import replace

import mitsuba as mi
import numpy as np
import pytest
import torch
from torch import Tensor
from torch.nn.functional import normalize

from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import Pyramid, texel_directions
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.spiral import spiral_points
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.traced_directions import (
    DirectionFrames,
    light_texels,
    traced_hemispheres,
    traced_lobes,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import tangent_frame
from tests.fixtures.meshes import icosphere
from tests.hir_plugins.reflectance_renderers.transport_ggx import torch_directions

mitsuba_on("cpu")

POINTS, DIRECTIONS = 2000, 16
PYRAMID = Pyramid(32, 64)


def random_unit(count: int, seed: int) -> Tensor:
    return normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(seed)), dim=1)


def rotations(count: int) -> Tensor:
    return torch.linalg.qr(torch.randn(count, 3, 3, generator=torch.Generator().manual_seed(9)))[0]


def beside_a_ball() -> tuple[RayTracer, np.ndarray, DirectionFrames]:
    """A ball that hides a part of the light of points around it, and of points on it."""
    positions, faces = icosphere(3)
    tracer = RayTracer(positions.astype(np.float32), faces.astype(np.int32))
    normal = random_unit(POINTS, 1)
    radius = 1.001 + 1.5 * torch.rand(POINTS, 1, generator=torch.Generator().manual_seed(2)).square()
    axes = torch.stack([*tangent_frame(normal), normal], dim=1)
    view = torch.arange(POINTS) % 5
    return tracer, np.arange(len(faces)) // 7, DirectionFrames(random_unit(POINTS, 3) * radius, axes, view)


def eyes(least_cosine: float) -> Tensor:
    eye = random_unit(POINTS, 4)
    return normalize(torch.cat([eye[:, :2], eye[:, 2:].abs().clamp_min(least_cosine)], dim=1), dim=1)


def agreement(found: tuple[Tensor, Tensor], expected: tuple[Tensor, Tensor]) -> float:
    """Share of the directions that read the same texels, whose weights must be equal. A direction at the border of two
    texels, levels or facets may read either.
    """
    columns, weights = (part.reshape(-1, 4) for part in found)
    true_columns, true_weights = (part.reshape(-1, 4) for part in expected)
    same = (columns == true_columns).all(dim=1)
    torch.testing.assert_close(weights[same], true_weights[same], atol=4e-4, rtol=0)
    return float(same.float().mean())


@pytest.mark.parametrize("alpha", [0.001, 0.05, 0.3, 1.0])
@pytest.mark.parametrize("rotated", [False, True])
def test_lobes_are_those_of_torch_in_float64(alpha: float, rotated: bool) -> None:
    """The formula of the reference loses four digits in float32 at the end of a narrow lobe. The kernel's largest error
    is 7e-7 of the direction at α = 0.001 and 0.05, and 2e-5 at 1, where two vectors of the last point cancel."""
    tracer, cells, frames = beside_a_ball()
    rotation = rotations(5) if rotated else None
    square, eye = spiral_points(POINTS, DIRECTIONS, 0, torch.device("cpu")), eyes(0.05)
    width = torch.full((POINTS, 1), alpha)
    found = traced_lobes(tracer, frames, eye, width, square, cells, PYRAMID, rotation)
    exact = replace(frames, origin=frames.origin.double(), axes=frames.axes.double())
    turned = None if rotation is None else rotation.double()
    # the float32 width: 0.001 itself would be another lobe
    arguments = eye.double(), width.double(), square.double(), cells, PYRAMID, turned
    expected = torch_directions.lobes(tracer, exact, *arguments)
    weights = expected.bilinear.float()
    assert agreement((found.columns, found.bilinear), (expected.columns, weights)) > 0.9995
    assert 0.05 < float((expected.columns >= PYRAMID.texels).float().mean()) < 0.95, "rays hit the ball and miss it"
    for name in ("n_wi", "n_h", "h_wo", "toward_light"):
        torch.testing.assert_close(
            getattr(found, name), getattr(expected, name).float(), atol=4e-6 if alpha < 0.1 else 4e-5, rtol=0
        )
    torch.testing.assert_close(found.sin2_h, expected.sin2_h.float(), atol=1e-7, rtol=1e-3)
    lit = (found.inverse_pdf > 0) & (expected.inverse_pdf > 0)
    assert float(((found.inverse_pdf > 0) == (expected.inverse_pdf > 0)).float().mean()) > 0.9995
    torch.testing.assert_close(found.inverse_pdf[lit], expected.inverse_pdf[lit].float(), atol=0, rtol=2e-5)


def test_hemispheres_are_those_of_torch() -> None:
    tracer, _, frames = beside_a_ball()
    square = spiral_points(POINTS, 96, 0, torch.device("cpu"))
    arguments = tracer, frames, square, PYRAMID, rotations(5)
    found, expected = traced_hemispheres(*arguments), torch_directions.hemispheres(*arguments)
    assert agreement(found, expected) > 0.9995
    visible = expected[1].reshape(POINTS, -1).sum(dim=1)
    torch.testing.assert_close(found[1].sum(dim=1), visible, atol=1.1 * np.pi / 96, rtol=0)  # one direction
    assert float((visible < 0.8 * np.pi).float().mean()) > 0.1 and float(visible.max()) > 0.99 * np.pi


def test_hard_cases_are_finite() -> None:
    """Grazing eyes, the ends of the unit square, the narrowest lobe, an eye along the normal."""
    tracer, cells, frames = beside_a_ball()
    square = torch.rand(POINTS, DIRECTIONS, 2, generator=torch.Generator().manual_seed(5))
    square[:, 0], square[:, 1], square[:, 2] = 0.0, 1.0, torch.tensor([0.5, 1.0])
    along = torch.tensor([0.0, 0.0, 1.0]).expand(POINTS, 3)
    for eye in (eyes(0.0), eyes(1e-3), along):
        for alpha in (0.0, 1e-4, 1.0):
            found = traced_lobes(
                tracer, frames, eye, torch.full((POINTS, 1), alpha), square, cells, PYRAMID, rotations(5)
            )
            assert all(bool(torch.isfinite(part).all()) for part in found)
            assert int(found.columns.min()) >= 0 and int(found.columns.max()) <= PYRAMID.texels + cells.max()
    columns, weights = traced_hemispheres(tracer, frames, square, PYRAMID, rotations(5))
    assert bool(torch.isfinite(weights).all()) and 0 <= int(columns.min()) <= int(columns.max()) < PYRAMID.texels


@pytest.mark.parametrize("points", [0, 1])
@pytest.mark.parametrize("directions", [1, 16])
def test_few_points(points: int, directions: int) -> None:
    tracer, cells, frames = beside_a_ball()
    few = DirectionFrames(frames.origin[:points], frames.axes[:points], frames.view[:points])
    square = spiral_points(points, directions, 0, torch.device("cpu"))
    arguments = (tracer, few, eyes(0.1)[:points], torch.full((points, 1), 0.1), square, cells, PYRAMID, rotations(5))
    found, expected = traced_lobes(*arguments), torch_directions.lobes(*arguments)
    for own, reference in zip(found, expected, strict=True):
        assert own.shape == reference.shape and own.dtype == reference.dtype
    columns, weights = traced_hemispheres(tracer, few, square, PYRAMID, rotations(5))
    assert columns.shape == weights.shape == (points, 4 * directions) and columns.dtype == torch.int32


def looked_up(pyramid: Pyramid, directions: Tensor, solid_angle: Tensor) -> tuple[Tensor, Tensor]:
    columns, weights = light_texels(
        pyramid, mi.Vector3f(*directions.T.contiguous().numpy()), mi.Float(solid_angle.numpy())
    )
    return torch.from_numpy(np.array(columns).T.copy()).long(), torch.from_numpy(np.array(weights).T.copy())


def test_weights_of_a_lookup_sum_to_one() -> None:
    index, weight = looked_up(PYRAMID, random_unit(500, 1), torch.logspace(-6, 1, 500))
    torch.testing.assert_close(weight.sum(1), torch.ones(500))
    assert int(index.min()) >= 0 and int(index.max()) < PYRAMID.texels


def test_lookup_of_a_texel_centre_is_that_texel() -> None:
    pyramid = Pyramid(16, 32)
    index, weight = looked_up(pyramid, texel_directions(16, 32), torch.full((512,), 1e-9))
    dense = torch.zeros(512, pyramid.texels).scatter_add_(1, index, weight)
    torch.testing.assert_close(dense[:, :512], torch.eye(512), atol=1e-4, rtol=0)


def test_a_level_offset_reads_coarser_texels(monkeypatch: pytest.MonkeyPatch) -> None:
    """The constant that the study of directions varies."""
    from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes import traced_directions

    fine, _ = looked_up(PYRAMID, random_unit(200, 6), torch.full((200,), 1e-9))
    monkeypatch.setattr(traced_directions, "LEVEL_OFFSET", 30.0)
    coarse, _ = looked_up(PYRAMID, random_unit(200, 6), torch.full((200,), 1e-9))
    assert int(fine.max()) < 32 * 64 and int(coarse.min()) >= PYRAMID.texels - 2 * 4
