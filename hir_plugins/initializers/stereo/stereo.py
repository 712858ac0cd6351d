"""Initializer: multi-view stereo on CPU or GPU, which carves concavities into the visual hull."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn.functional import interpolate

from hir_core.capture import Array, Capture, OrientedPoints
from hir_core.errors import CaptureError, ConfigError, MissingExtraError, StageError
from hir_core.optimization.parallel_jobs import StopSignal, run_in_parallel
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Scene
from hir_plugins.initializers.hull.visual_hull import hull_volume
from hir_plugins.initializers.options import PoissonOptions, StereoOptions, VisualHullOptions
from hir_plugins.initializers.poisson.poisson import poisson_surface
from hir_plugins.initializers.stereo.depth_consistency import DepthMap, consistent_depths, oriented_points
from hir_plugins.initializers.stereo.depth_fusion import (
    VerifiedCarving,
    carve_depths,
    smoothed_carving,
    verify_carving,
)
from hir_plugins.initializers.stereo.patch_match import patch_match, patch_match_available
from hir_plugins.initializers.stereo.stereo_photographs import (
    choose_neighbours,
    crop_to_object,
    evenly_distributed_views,
)
from hir_plugins.initializers.stereo.surface_sweep import SweepSettings, SweptView, inverse_depth_step, sweep
from hir_plugins.initializers.stereo.tsdf import tsdf_surface
from hir_plugins.initializers.stereo.view_independence import ViewIndependence, view_independence
from hir_plugins.initializers.surface.initial_scene import make_scene
from hir_plugins.initializers.surface.isosurface import extract_surface, keep_large_components
from hir_plugins.initializers.surface.mesh_cleaning import clean_mesh, edge_length, pixel_size
from hir_plugins.initializers.surface.object_bounds import object_bounding_sphere
from hir_plugins.initializers.surface.swept_surface import SweptSurface, signed_distance_volume
from hir_plugins.initializers.surface.volume import Volume

_REFINEMENT_STEPS = (12, 6)
"""Steps inwards and outwards at the finer levels: the error of a level of half the resolution."""

_VERIFICATION_NEIGHBOURS = 4
"""Additional neighbours that verify the carving; they were not used for the depths."""

_MAX_SWEEPS_AT_ONCE = 4
"""Each has the correlations of its own depths in memory."""

_MIN_COMPONENT = 0.02
"""Connected components with less than this share of the largest component's area are removed."""

Mesh = tuple[Array, NDArray[np.int64]]


@dataclass(frozen=True)
class StereoMeasurement:
    """Depth maps of all views, and what was made of them."""

    maps: list[DepthMap]
    points: OrientedPoints | None
    mesh: Mesh | None
    """The carved surface; None without a volume to carve."""
    carving: VerifiedCarving | None
    independence: ViewIndependence | None


@final
class Stereo(Initializer):
    """Depth of each photograph, confirmed by others; a surface from hull and depths, or from depths alone."""

    def __init__(self, config: StereoOptions) -> None:
        if config.window % 2 == 0:
            raise ConfigError(f"initializer.stereo.window is {config.window}; use an odd number")
        if config.method == "patch_match" and not patch_match_available():
            raise MissingExtraError(
                "initializer.stereo.method is patch_match, which needs a COLMAP built with CUDA; "
                "install one with: pip install pycolmap-cuda12, or leave the method at auto"
            )
        self._config = config
        self._report: dict[str, object] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture with dense oriented points, and a mesh. Captures without cameras raise `CaptureError`."""
        cameras = capture.cameras
        if len(cameras) < 3:
            raise CaptureError(f"{capture.path}: stereo needs at least three photographs, there are {len(cameras)}")
        masked = sum(view.pixels().mask is not None for view in capture.views)
        # also for `tsdf`: depths measured inside a hull are more accurate than those inside a sphere
        carve = self._config.surface == "hull" or (
            self._config.surface in ("auto", "tsdf") and (masked >= 2 or scene is not None)
        )
        volume = _volume(capture, scene, self._config) if carve else None
        by_colmap = self._config.method != "sweep" and patch_match_available()
        measured = measure_depths(capture, volume, self._config, workspace if by_colmap else None)
        sweep_name = f"surface sweep in torch on {_device(self._config)}"
        self._report = {"method": "COLMAP PatchMatch on cuda" if by_colmap else sweep_name}
        if measured.points is None:
            if scene is None:
                raise StageError(
                    "stereo found no consistent depth: the object has too little texture, or the photographs too "
                    "little "
                    "overlap; leave stereo out of 'initializers'"
                )
            self._report["surface"] = "unchanged: no consistent depth"
            return capture, scene
        solved = replace(capture, points=measured.points)
        self._report["points"] = len(measured.points.positions)
        if self._config.surface == "tsdf":
            voxel = self._config.pixels_per_voxel * pixel_size(capture.cameras, measured.points.positions.mean(axis=0))
            return solved, self._finished(*tsdf_surface(measured.maps, voxel), capture, "tsdf", voxel)
        if measured.mesh is None:
            mesh = poisson_surface(measured.points, PoissonOptions())
            return solved, self._finished(*mesh, capture, "poisson")
        if measured.carving is not None:
            self._report |= {
                "carved_share": round(measured.carving.removed, 5),
                "confirmed_share": round(measured.carving.confirmed, 4),
                "correlation_gain": round(measured.carving.gain, 4),
            }
        if measured.independence is not None and measured.independence.explained is not None:
            self._report["explained_share"] = round(measured.independence.explained, 4)
        if scene is not None and measured.carving is not None and measured.carving.is_empty:
            self._report["surface"] = "unchanged: no carving is confirmed"
            return solved, scene
        spacing = 0.0 if volume is None else volume.spacing
        return solved, self._finished(*measured.mesh, capture, "hull and depths", spacing)

    def _finished(
        self, positions: Array, faces: NDArray[np.int64], capture: Capture, surface: str, spacing: float = 0.0
    ) -> Scene:
        self._report["surface"] = surface
        edge = edge_length(capture, positions, self._config.edge_pixels, spacing)
        positions, faces = clean_mesh(positions, faces, edge, _MIN_COMPONENT, self._config.seed)
        return make_scene(positions, faces, capture, self._config.vertex_colors)

    def report(self) -> Mapping[str, object]:
        """Method and device, the number of points, and the shares of the volume that were carved and confirmed."""
        return self._report


def measure_depths(
    capture: Capture, volume: Volume | None, options: StereoOptions, folder: Path | None = None
) -> StereoMeasurement:
    """Consistent depth maps of all views, from coarse to fine; each level starts from the surface of the previous one.

    Photographs are compared within their take; the depths of all takes are carved together.
    Without a volume, the sweep starts at a sphere around the object. With a `folder` for its workspace, COLMAP's
    PatchMatch replaces the sweep, at the finest level only.
    """
    device = _device(options)
    front = keep_large_components(*extract_surface(volume), min_share=_MIN_COMPONENT) if volume is not None else None
    center, radius = object_bounding_sphere(capture) if front is None else _bounding_sphere(front[0])
    if front is None:
        front = _sphere_mesh(center, 1.05 * radius)
    side = max(max(c.width, c.height) for c in capture.cameras)
    shrink = -(-side // options.max_image_size)
    take_numbers = capture.take_numbers
    used = evenly_distributed_views(capture.cameras, center, options.max_photographs, take_numbers)
    cropped = [
        (cut, take_numbers[i])
        for i in used
        if (cut := crop_to_object(capture.views[i], shrink, 2 ** (options.levels - 1), center, radius)) is not None
    ]
    photographs, takes = [cut for cut, _ in cropped], [take for _, take in cropped]
    cameras = [p.camera for p in photographs]
    near = choose_neighbours(cameras, center, options.neighbours, takes)
    more = choose_neighbours(cameras, center, options.neighbours + _VERIFICATION_NEIGHBOURS, takes)
    of_any_take = choose_neighbours(cameras, center, options.neighbours)
    bound = SweptSurface(*front)
    current, carving, mesh = bound, None, front if volume is not None else None
    independence: ViewIndependence | None = None
    dense: list[Tensor] = []
    maps: list[DepthMap] = []
    with torch.inference_mode():
        for level in [0] if folder is not None else reversed(range(options.levels)):
            if folder is not None:
                maps = [m.to(device) for m in patch_match(photographs, near, center, radius, folder)]
            else:
                views = [p.at_level(2**level, current, bound, device) for p in photographs]
                if dense:
                    views = [replace(v, inverse=_enlarged(d, v)) for v, d in zip(views, dense, strict=True)]
                steps = _steps(views, near, of_any_take, center)
                solid = bound if level == options.levels - 1 else None
                swept = _sweep_all(views, near, steps, solid, options, device)
                maps = consistent_depths(views, swept, near, steps, options.window, options.min_views)
                dense = [inverse for inverse, _ in swept] if volume is None else []
            if volume is None:
                continue
            result = carve_depths(volume, maps, min_weight=1.0)
            mesh = _carved_mesh(volume, result)
            current = SweptSurface(*mesh)
            if options.verify_carving:
                seen = [p.at_level(2**level, current, bound, device) for p in photographs]
                steps = _steps(seen, more, of_any_take, center)
                if independence is None:
                    independence = view_independence(volume, result, seen, steps, center, takes)
                carving = verify_carving(volume, result, seen, more, options.window, steps, allowed=independence.share)
                mesh = _carved_mesh(volume, carving.volume)
                current = SweptSurface(*mesh)
    point_spacing = 1.5 * pixel_size(cameras, center)
    points = oriented_points(maps, [p.color_linear for p in photographs], point_spacing)
    return StereoMeasurement(maps, points, mesh, carving, independence)


def _carved_mesh(whole: Volume, carving: Volume) -> Mesh:
    return keep_large_components(*extract_surface(smoothed_carving(whole, carving)), min_share=_MIN_COMPONENT)


def _sweep_all(
    views: list[SweptView],
    near: list[list[int]],
    steps: list[float],
    solid: SweptSurface | None,
    options: StereoOptions,
    device: str,
) -> list[tuple[Tensor, Tensor]]:
    """`_sweep_view` of every view; on the CPU several at the same time."""

    def swept(view: int) -> tuple[Tensor, Tensor]:
        with torch.inference_mode():  # a mode belongs to its thread
            return _sweep_view(views, view, near[view], steps[view], solid, options)

    at_once = min(torch.get_num_threads(), _MAX_SWEEPS_AT_ONCE) if device == "cpu" else 1
    return run_in_parallel([partial(swept, view) for view in range(len(views))], at_once, StopSignal())


def _sweep_view(
    views: list[SweptView], index: int, near: list[int], step: float, solid: SweptSurface | None, options: StereoOptions
) -> tuple[Tensor, Tensor]:
    """Inverse depth and correlation (H, W) of a view; at the first level the sweep passes through all of `solid`."""
    view = views[index]
    if not near or not view.valid.any():
        return torch.zeros_like(view.image), torch.zeros_like(view.image)
    inward, outward = _REFINEMENT_STEPS
    thickness: Tensor | None = None
    if solid is not None:
        thickness = torch.from_numpy(solid.thickness(view.camera, view.bound.cpu().numpy())).to(view.bound.device)
        reach = float(np.quantile(thickness[view.valid].cpu().numpy(), 0.98))
        # a very thick object, seen from far point_spacing, is swept in longer steps
        step = max(step, reach / options.steps)
        inward, outward = int(np.clip(np.ceil(reach / step), 4, options.steps)), 2
    return sweep(view, [views[j] for j in near], step, SweepSettings(options.window, inward, outward), thickness)


def _steps(views: list[SweptView], near: list[list[int]], of_any_take: list[list[int]], center: Array) -> list[float]:
    """Step of inverse depth for one pixel of parallax, for each view; infinite without neighbours.

    The only view of its take is not compared with others, but the surface that it sees is: its step is that of the
    neighbours of any take.
    """
    neighbours = [own or others for own, others in zip(near, of_any_take, strict=True)]
    return [
        inverse_depth_step(view.camera, [views[j].camera for j in others], center) if others else float("inf")
        for view, others in zip(views, neighbours, strict=True)
    ]


def _volume(capture: Capture, scene: Scene | None, options: StereoOptions) -> Volume:
    """Signed distances of the surface of an earlier initializer, else of the hull of the masks."""
    if scene is None:
        hull = VisualHullOptions(pixels_per_voxel=options.pixels_per_voxel, max_resolution=options.max_resolution)
        return hull_volume(capture, hull)
    positions = scene.mesh.positions.detach().cpu().numpy().astype(np.float64)
    faces = scene.mesh.faces.cpu().numpy()
    middle = 0.5 * (positions.min(axis=0) + positions.max(axis=0))
    extent = float(np.ptp(positions, axis=0).max())
    spacing = max(options.pixels_per_voxel * pixel_size(capture.cameras, middle), extent / options.max_resolution)
    return signed_distance_volume(SweptSurface(positions, faces), positions, spacing)


def _bounding_sphere(positions: Array) -> tuple[Array, float]:
    center = (positions.min(axis=0) + positions.max(axis=0)) / 2
    return center, float(np.linalg.norm(positions - center, axis=1).max())


def _sphere_mesh(center: Array, radius: float) -> Mesh:
    import open3d

    ball = open3d.geometry.TriangleMesh.create_sphere(1.0, resolution=60)
    return center + radius * np.asarray(ball.vertices), np.asarray(ball.triangles).astype(np.int64)


def _enlarged(inverse: Tensor, view: SweptView) -> Tensor:
    size = view.image.shape
    return interpolate(inverse[None, None], size=tuple(size), mode="bilinear", align_corners=False)[0, 0]


def _device(options: StereoOptions) -> str:
    if options.device != "auto":
        return options.device
    return "cuda" if torch.cuda.is_available() else "cpu"
