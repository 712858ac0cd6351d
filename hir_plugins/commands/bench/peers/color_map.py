"""Photogrammetry without materials: open3d averages the photographs to vertex colours of the true mesh.

The light is baked into the colours, so another light does not change the rendered image.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear

from hir_core.capture import Capture
from hir_core.intake.reader_lookup import find_reader, read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.metrics import OBJECT_COVERAGE, composite, mean, psnr, unassociate
from hir_core.rendering.unlit_renderer import UnlitRenderer
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.scene import Scene, Topology
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.measurement import Stopwatch
from hir_plugins.commands.bench.results.bench_result import Case, Row

PHOTOGRAPHS: Final = 40
DOWNSAMPLE: Final = 1
TRIANGLES: Final = 80_000
"""The mesh is subdivided to about so many triangles, because the colours are stored at vertices."""
EVALUATED_VIEWS: Final = 4


def color_map_rows(
    scene: Scene, train: Capture, test: Capture, case: Case, path: Path, bench_options: BenchOptions
) -> Iterator[Row]:
    """One row with the error on unseen views under the same light and under each other light of the capture."""
    stopwatch = Stopwatch(memory=False)
    colored = color_mapped(scene, train)
    timing = stopwatch.timing()
    errors = {"unseen dB": mean_unlit_psnr(colored, test)}
    _, reader = find_reader(path, bench_options.plugins)
    for split in reader.splits(path):
        if split.startswith("relight"):
            errors[f"{split} dB"] = mean_unlit_psnr(colored, read_capture(path, split, bench_options.plugins))
    budget = {**case, "budget": f"{PHOTOGRAPHS} photographs"}
    yield Row(budget, "open3d colour mapping: baked light", "peer", timing, errors, "other lights unscaled, object")


def color_mapped(scene: Scene, train: Capture) -> Scene:
    """The mesh with vertex colours from open3d's `run_rigid_optimizer`; the cameras are not optimised."""
    import open3d as o3d

    mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(scene.mesh.positions.numpy().astype(np.float64)),
        o3d.utility.Vector3iVector(scene.mesh.faces.numpy().astype(np.int32)),
    )
    while len(mesh.triangles) * 4 <= 2 * TRIANGLES:
        mesh = mesh.subdivide_midpoint(1)
    mesh.compute_vertex_normals()
    rays = MeshQueries(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.triangles))
    images, cameras = [], []
    for i in evenly_spaced_indices(len(train.views), PHOTOGRAPHS):
        image, camera = _rgbd_and_camera(o3d, train, i, rays, mesh)
        images.append(image)
        cameras.append(camera)
    trajectory = o3d.camera.PinholeCameraTrajectory()
    trajectory.parameters = cameras
    options = o3d.pipelines.color_map.RigidOptimizerOption(
        maximum_iteration=0,
        maximum_allowable_depth=1e3,
        half_dilation_kernel_size_for_discontinuity_map=1,
        image_boundary_margin=2,
    )
    colored, _ = o3d.pipelines.color_map.run_rigid_optimizer(mesh, images, trajectory, options)
    colors = np.asarray(srgb_to_linear(np.asarray(colored.vertex_colors)), np.float32)
    fine = replace(
        scene.mesh,
        positions=torch.from_numpy(np.asarray(mesh.vertices, np.float32)),
        topology=Topology(torch.from_numpy(np.asarray(mesh.triangles, np.int64))),
        uvs=None,
        vertex_colors=torch.from_numpy(colors),
    )
    return Scene(fine)


def _rgbd_and_camera(o3d: Any, train: Capture, i: int, rays: MeshQueries, mesh: Any) -> tuple[Any, Any]:
    """Photograph and true depth of one view, and its camera, as types of open3d."""
    camera = train.cameras[i].downsampled(DOWNSAMPLE)
    pixels = train.views[i].pixels().downsampled(DOWNSAMPLE)
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    origins, directions = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    face, weights = rays.first_hits(origins.astype(np.float32), directions.astype(np.float32))
    corners = np.asarray(mesh.vertices)[np.asarray(mesh.triangles)[np.maximum(face, 0)]]
    points = (corners * weights[..., None]).sum(axis=1)
    depth = points @ camera.world_to_camera[2, :3] + camera.world_to_camera[2, 3]
    depth = np.where(face >= 0, depth, 0).reshape(camera.height, camera.width).astype(np.float32)
    color = (np.clip(linear_to_srgb(pixels.color_linear), 0, 1) * 255 + 0.5).astype(np.uint8)
    rgbd = o3d.geometry.RGBDImage.create_from_color_and_depth(
        o3d.geometry.Image(np.ascontiguousarray(color)),
        o3d.geometry.Image(depth),
        depth_scale=1.0,
        depth_trunc=1e3,
        convert_rgb_to_intensity=False,
    )
    parameters = o3d.camera.PinholeCameraParameters()
    k = camera.intrinsics
    # open3d has pixel centres at integer coordinates
    parameters.intrinsic = o3d.camera.PinholeCameraIntrinsic(
        camera.width, camera.height, k[0, 0], k[1, 1], k[0, 2] - 0.5, k[1, 2] - 0.5
    )
    parameters.extrinsic = camera.world_to_camera
    return rgbd, parameters


def mean_unlit_psnr(scene: Scene, capture: Capture) -> float:
    """Mean PSNR over object pixels of a few views, rendered without light."""
    unlit = UnlitRenderer(scene)
    values: list[float | None] = []
    for i in evenly_spaced_indices(len(capture.views), EVALUATED_VIEWS):
        pixels = capture.views[i].pixels().downsampled(DOWNSAMPLE)
        fit = unlit.render(capture.cameras[i].downsampled(DOWNSAMPLE))
        assert pixels.mask is not None
        truth = composite(pixels.color_linear, pixels.mask)
        values.append(psnr(composite(*unassociate(fit)), truth, pixels.mask > OBJECT_COVERAGE))
    return mean(values) or 0.0
