"""The reference for `operator/lobes/traced_directions.py`: the same directions in torch, one operation at a time."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.scene.bilinear import axis_neighbours, bilinear_weights
from hir_plugins.reflectance_renderers.brdf_torch import ggx_d
from hir_plugins.reflectance_renderers.ray_tracer import RayTracer
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid import Pyramid
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.traced_directions import (
    DirectionFrames,
    TracedLobes,
)


def lobes(
    tracer: RayTracer,
    frames: DirectionFrames,
    toward_eye: Tensor,
    alpha: Tensor,
    square: Tensor,
    face_cells: np.ndarray,
    pyramid: Pyramid,
    rotation: Tensor | None,
) -> TracedLobes:
    """`traced_lobes`."""
    count, samples, _ = square.shape
    h = visible_normal(toward_eye[:, None].expand(-1, samples, -1), alpha, square)
    h_wo = (h * toward_eye[:, None]).sum(-1).clamp(0, 1)
    light = 2 * h_wo[..., None] * h - toward_eye[:, None]
    sine = h[..., 0].square() + h[..., 1].square()
    cosine = toward_eye[:, 2:]
    smith = cosine + (alpha.square() + (1 - alpha.square()) * cosine.square()).sqrt()
    density = ggx_d(h[..., 2], alpha, sine) / (2 * smith)
    inverse = 1 / (samples * density.clamp_min(1e-12))
    above = light[..., 2] > 0
    world = light @ frames.axes
    origin = frames.origin[:, None].expand(-1, samples, -1)
    face = np.full(above.shape, -1)
    face[above.numpy()] = tracer.closest(origin[above].numpy(), world[above].numpy()).face
    columns, weights = lookup(pyramid, in_frame_of_light(world, frames, rotation).reshape(-1, 3), inverse.reshape(-1))
    columns, weights = columns.reshape(count, samples, 4), weights.reshape(count, samples, 4)
    columns[face >= 0] = pyramid.texels + torch.from_numpy(face_cells[face[face >= 0]])[:, None]
    weights[face >= 0] = 0.25
    flat = columns.reshape(count, 4 * samples).int(), weights.reshape(count, 4 * samples)
    return TracedLobes(*flat, light[..., 2], h[..., 2], sine, h_wo, inverse * above, light)


def hemispheres(
    tracer: RayTracer, frames: DirectionFrames, square: Tensor, pyramid: Pyramid, rotation: Tensor
) -> tuple[Tensor, Tensor]:
    """`traced_hemispheres`."""
    count, samples, _ = square.shape
    radius, turn = square[..., 1].sqrt(), 2 * math.pi * square[..., 0]
    height = (1 - square[..., 1]).clamp_min(0).sqrt()
    world = torch.stack([radius * turn.cos(), radius * turn.sin(), height], dim=-1) @ frames.axes
    origin = frames.origin[:, None].expand(-1, samples, -1)
    hidden = torch.from_numpy(tracer.occluded(origin.reshape(-1, 3).numpy(), world.reshape(-1, 3).numpy()))
    solid_angle = math.pi / (samples * height.clamp_min(0.05))
    columns, weights = lookup(
        pyramid, in_frame_of_light(world, frames, rotation).reshape(-1, 3), solid_angle.reshape(-1)
    )
    weights = weights * (~hidden * math.pi / samples)[:, None]
    return columns.reshape(count, 4 * samples).int(), weights.reshape(count, 4 * samples)


def in_frame_of_light(world: Tensor, frames: DirectionFrames, rotation: Tensor | None) -> Tensor:
    """Directions (P, K, 3) rotated by the rotation of each point's view."""
    return world if rotation is None else (rotation[frames.view][:, None] @ world[..., None])[..., 0]


def visible_normal(eye: Tensor, alpha: Tensor, square: Tensor) -> Tensor:
    """Normals visible from local directions, by the spherical cap of Dupuy and Benyoub (2023)."""
    stretched = normalize(torch.stack([alpha * eye[..., 0], alpha * eye[..., 1], eye[..., 2]], dim=-1), dim=-1)
    turn = 2 * math.pi * square[..., 0]
    z = (1 - square[..., 1]) * (1 + stretched[..., 2]) - stretched[..., 2]
    radius = (1 - z * z).clamp_min(0).sqrt()
    half = torch.stack([radius * turn.cos(), radius * turn.sin(), z], dim=-1) + stretched
    return normalize(
        torch.stack([alpha * half[..., 0], alpha * half[..., 1], half[..., 2].clamp_min(1e-9)], -1), dim=-1
    )


def lookup(pyramid: Pyramid, directions: Tensor, solid_angle: Tensor) -> tuple[Tensor, Tensor]:
    """`light_texels`."""
    shapes = pyramid.shapes
    x, y, z = directions.unbind(-1)
    u, v = 0.5 - torch.atan2(x, z) / (2 * math.pi), torch.atan2(torch.hypot(x, z), y) / math.pi
    texel = 2 * math.pi**2 / (pyramid.height * pyramid.width) * torch.sin(math.pi * v).clamp_min(1e-3)
    level = (0.5 * torch.log2((solid_angle / texel).clamp_min(1e-12))).round().clamp(0, len(shapes) - 1).long()
    heights, widths = (torch.tensor([shape[axis] for shape in shapes])[level] for axis in range(2))
    first = torch.tensor([0] + [h * w for h, w in shapes]).cumsum(0)[level]
    columns = axis_neighbours(u * widths - 0.5, widths, "repeat")
    rows = axis_neighbours(v * heights - 0.5, heights, "extend")
    index, weight = bilinear_weights(columns, rows, widths)
    return index + first[:, None], weight
