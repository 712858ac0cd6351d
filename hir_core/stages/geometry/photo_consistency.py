"""Do photographs agree about a surface? A point must show the same detail in every view that sees it.

What is compared is detail, not colour: each photograph minus its local mean, over its local contrast. Highlights,
shadows that move slowly over the surface and differences of exposure drop out (as with the normalised correlation of
Vu, Labatut, Pons & Keriven 2012, *High Accuracy and Visibility-Consistent Dense Multiview Stereo*).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from torch import Tensor
from torch.nn.functional import normalize

from hir_core.capture import Camera, View
from hir_core.mesh.ray_casting import SurfaceRays
from hir_core.scene import Mesh
from hir_core.scene.srgb import linear_to_srgb

WINDOW = 7
"""Side in pixels of the box (applied twice) that local means and contrasts are taken over."""
LEAST_CONTRAST = 0.03
"""Contrast (standard deviation in sRGB) below which detail fades out: there noise rules."""
INSIDE = 0.99
MOST_BYTES = 512 << 20
"""Of the detail images of all views together; larger photographs are compared at a fraction of their resolution."""
NEIGHBOURS = 8
NEAREST_DEG, FARTHEST_DEG = 4.0, 45.0
"""Between views closer than this there is no parallax, between views farther apart surfaces look too different."""
GRAZING = 0.2
"""Cosine below which a view sees a facet too obliquely to compare."""
LIFT = 1e-3
"""Of shadow rays off the surface, as a fraction of the object's radius of 1."""


@dataclass(frozen=True, eq=False)
class Details:
    """The detail of every view at one resolution, padded to one size."""

    images: Float[Tensor, "N 3 H W"]
    """float16: as fine as what it came from, and half the memory."""
    inside: Bool[Tensor, "N H W"]
    pixels: tuple[NDArray[np.int32], ...]
    """For each view, the (x, y) of pixels whose whole window lies inside the object."""
    cameras: tuple[Camera, ...]
    names: tuple[str, ...]

    @classmethod
    def of(cls, views: Sequence[View], downsample: int) -> Details:
        """Reads the photographs; a view without a mask counts as covered everywhere."""
        cameras = tuple(view.camera.downsampled(downsample) for view in views if view.camera is not None)
        height, width = max(c.height for c in cameras), max(c.width for c in cameras)
        images = torch.zeros(len(views), 3, height, width, dtype=torch.float16)
        inside = torch.zeros(len(views), height, width, dtype=torch.bool)
        pixels = []
        for i, view in enumerate(views):  # one at a time: float32 of all of them would be twice as much again
            detail, mask = _detail(view, downsample)
            h, w = mask.shape
            images[i, :, :h, :w], inside[i, :h, :w] = detail.half(), mask
            pixels.append(np.argwhere(mask.numpy())[:, ::-1].astype(np.int32))
        return cls(images, inside, tuple(pixels), cameras, tuple(view.name for view in views))


def finest_downsample(views: Sequence[View], downsample: int) -> int:
    """The least factor, `downsample` or a multiple, at which the detail of all views fits into `MOST_BYTES`."""
    cameras = [view.camera for view in views if view.camera is not None]
    texels = len(cameras) * max((c.width * c.height for c in cameras), default=0)
    while texels * 7 / downsample**2 > MOST_BYTES:
        downsample *= 2
    return downsample


def neighbours(cameras: Sequence[Camera], allowed: Sequence[int]) -> list[list[int]]:
    """For each view the nearest of the `allowed` ones that look at the origin from another side."""
    centers = np.stack([camera.center for camera in cameras])
    directions = centers / np.maximum(np.linalg.norm(centers, axis=1, keepdims=True), 1e-30)
    angles = np.degrees(np.arccos(np.clip(directions @ directions.T, -1, 1)))
    found = []
    for i in range(len(cameras)):
        near = [j for j in np.argsort(angles[i], kind="stable") if j in set(allowed) and j != i]
        found.append([int(j) for j in near if NEAREST_DEG < angles[i, j] < FARTHEST_DEG][:NEIGHBOURS])
    return found


@dataclass(frozen=True, eq=False)
class PixelPairs:
    """Pixels of some views, each with another view that is asked about the same point of the surface."""

    view: NDArray[np.int64]
    other: NDArray[np.int64]
    pixel: NDArray[np.int64]
    """(P, 2): x, y in `view`."""


def draw_pairs(
    details: Details, near: Sequence[Sequence[int]], views: Sequence[int], count: int, generator: np.random.Generator
) -> PixelPairs:
    """About `count` pixels of each view named, drawn at random, with a random neighbour each."""
    parts: list[tuple[NDArray[np.int64], ...]] = []
    for view in views:
        pixels = details.pixels[view]
        if len(pixels) == 0 or not near[view]:
            continue
        chosen = pixels[generator.integers(len(pixels), size=count)]
        others = generator.choice(np.array(near[view]), size=count)
        parts.append((np.full(count, view), others, chosen.astype(np.int64)))
    if not parts:
        empty = np.empty(0, np.int64)
        return PixelPairs(empty, empty, empty.reshape(0, 2))
    return PixelPairs(*(np.concatenate([part[k] for part in parts]) for k in range(3)))


def disagreement(mesh: Mesh, details: Details, pairs: PixelPairs) -> tuple[Float[Tensor, "Q 3"], NDArray[np.int64]]:
    """Detail in the other view minus detail in the pixel's own, for the pairs that both see the surface, and their
    rows in `pairs`. Differentiable in the positions: a point slides along its pixel's ray as its facet moves.
    """
    positions = mesh.positions
    tracer = SurfaceRays(positions.detach().cpu().numpy(), mesh.faces.cpu().numpy())
    origins, directions = _rays(details.cameras, pairs)
    face = tracer.first_faces(origins, directions)
    rows = np.flatnonzero(face >= 0)
    to = positions.device
    origin, direction = (torch.from_numpy(a[rows]).to(positions) for a in (origins, directions))
    a, b, c = positions[mesh.faces[torch.from_numpy(face[rows]).to(to)]].unbind(1)
    normal = normalize(torch.linalg.cross(b - a, c - a), dim=1, eps=1e-30)
    cosine = (normal * direction).sum(1)
    faced = cosine.detach() < -GRAZING
    points = origin + ((normal * (a - origin)).sum(1) / torch.where(faced, cosine, -1.0))[:, None] * direction
    with torch.no_grad():
        centers = np.stack([camera.center for camera in details.cameras]).astype(np.float32)
        to_other = normalize(torch.from_numpy(centers[pairs.other[rows]]).to(positions) - points, dim=1, eps=1e-30)
        seen = faced & ((normal * to_other).sum(1) > GRAZING) & torch.isfinite(points).all(dim=1)
        start = torch.where(seen[:, None], points + LIFT * normal, 0.0).cpu().numpy()
        seen &= ~torch.from_numpy(tracer.hidden(start, to_other.cpu().numpy())).to(to)
    points, rows = points[seen], rows[seen.cpu().numpy()]
    place = _project(details.cameras, points, pairs.other[rows])
    found, within = _look_up(details, place, torch.from_numpy(pairs.other[rows]).to(to))
    rows = rows[within.cpu().numpy()]
    x, y = pairs.pixel[rows].T
    own = details.images[torch.from_numpy(pairs.view[rows]), :, torch.from_numpy(y), torch.from_numpy(x)]
    return found - own.to(found), rows


def _detail(view: View, downsample: int) -> tuple[Float[Tensor, "3 H W"], Bool[Tensor, "H W"]]:
    pixels = view.pixels(downsample)
    color = torch.from_numpy(np.ascontiguousarray(pixels.color_linear, dtype=np.float32))
    known = torch.isfinite(color).all(dim=2)  # what is not a colour is not compared
    color = linear_to_srgb(torch.where(known[..., None], color, 0.0).clamp(0, 1)).permute(2, 0, 1)
    mask = torch.ones(color.shape[1:]) if pixels.mask is None else torch.from_numpy(pixels.mask.astype(np.float32))
    mask = mask * known
    covered = (mask >= INSIDE).float()[None]
    weight = _blurred(covered).clamp_min(1e-3)
    detail = (color - _blurred(color * covered) / weight) * covered
    contrast = _blurred(detail.square().mean(dim=0, keepdim=True)) / weight
    # a pixel beside the outline looks at half a window: what it holds depends on the view
    whole = -torch.nn.functional.max_pool2d(-covered, 5, 1, 2)
    return detail / (contrast + LEAST_CONTRAST**2).sqrt(), whole[0] > 0.5


def _blurred(image: Float[Tensor, "C H W"]) -> Float[Tensor, "C H W"]:
    """Means over boxes, twice; a box that reaches over the border is cut there."""
    values = image.numpy()
    for _ in range(2):
        for axis in (1, 2):
            counted = uniform_filter1d(np.ones(values.shape[axis], np.float32), WINDOW, mode="constant")
            summed = uniform_filter1d(values, WINDOW, axis, mode="constant")
            values = summed / (counted[:, None] if axis == 1 else counted)
    return torch.from_numpy(values)


def _rays(cameras: Sequence[Camera], pairs: PixelPairs) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    origins = np.empty((len(pairs.view), 3), np.float32)
    directions = np.empty((len(pairs.view), 3), np.float32)
    for view in np.unique(pairs.view):
        rows = pairs.view == view
        origins[rows], directions[rows] = cameras[int(view)].rays(pairs.pixel[rows].astype(np.float64) + 0.5)
    return origins, directions


def _project(cameras: Sequence[Camera], points: Float[Tensor, "Q 3"], view: NDArray[np.int64]) -> Float[Tensor, "Q 2"]:
    matrices = np.stack([camera.intrinsics @ camera.world_to_camera[:3] for camera in cameras]).astype(np.float32)
    matrix = torch.from_numpy(matrices[view]).to(points)
    homogeneous = (matrix[:, :, :3] @ points[..., None])[..., 0] + matrix[:, :, 3]
    depth = homogeneous[:, 2:]
    return homogeneous[:, :2] / torch.where(depth.abs() < 1e-12, 1e-12, depth)


def _look_up(
    details: Details, place: Float[Tensor, "Q 2"], view: Tensor
) -> tuple[Float[Tensor, "R 3"], Bool[Tensor, " Q"]]:
    """Bilinear detail at pixel coordinates, differentiable in them, where all four pixels are inside the object."""
    _, _, height, width = details.images.shape
    corner = (place.detach() - 0.5).floor()
    within = ((corner >= 0) & (corner < torch.tensor([width - 1, height - 1], device=place.device))).all(dim=1)
    x, y = torch.where(within[:, None], corner, 0.0).long().unbind(1)
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        within = within & details.inside[view, (y + dy).clamp_max(height - 1), (x + dx).clamp_max(width - 1)]
    place, x, y, view = place[within], x[within], y[within], view[within]
    fx, fy = (place - 0.5 - torch.stack([x, y], dim=1)).unbind(1)

    def at(dx: int, dy: int) -> Tensor:
        return details.images[view, :, y + dy, x + dx].to(place)

    top = at(0, 0) * (1 - fx)[:, None] + at(1, 0) * fx[:, None]
    bottom = at(0, 1) * (1 - fx)[:, None] + at(1, 1) * fx[:, None]
    return top * (1 - fy)[:, None] + bottom * fy[:, None], within
