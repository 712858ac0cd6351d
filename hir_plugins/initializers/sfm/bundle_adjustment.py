"""Bundle adjustment that starts at given poses, on tracks of matched features (Triggs et al. 2000).

A part of the tracks is held out: how well their points are triangulated judges the cameras.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap
from numpy.typing import NDArray

from hir_core.capture import Array, Camera
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.feature_matching import run_cancellable
from hir_plugins.initializers.sfm.sfm_images import SfmImage
from hir_plugins.initializers.sfm.structure_from_motion import attempts, build_database
from hir_plugins.initializers.sfm.triangulation import reconstruction_of_poses

_TOLERANCES_PIXELS = (16.0, 6.0, 3.0)
"""Points are triangulated within these reprojection errors, one after the other: given poses are off by pixels."""
_HELD_OUT_INTERVAL = 5
"""Every fifth track is held out."""
_MIN_OBSERVATIONS = 24
"""A pose is adjusted if its image sees so many points; others stay as they are."""
_MIN_POINTS = 100
LOSS_SCALE_PIXELS = 1.0
"""At which the robust loss (soft L1) turns from quadratic to linear."""


@dataclass(frozen=True)
class Track:
    """Matched features that show one point."""

    views: NDArray[np.int64]
    """(K,)"""
    pixels: Array
    """(K, 2), of the photographs."""


@dataclass(frozen=True)
class AdjustedCameras:
    """Result of a bundle adjustment."""

    cameras: tuple[Camera, ...]
    """Of all views, in the order of `images`, in a world that may differ from the given one by a similarity."""
    adjusted: int
    """How many of them moved; the others see too few points."""
    points: int
    held_out: tuple[Track, ...]


def adjust_bundle(
    images: Sequence[SfmImage],
    cameras: Sequence[Camera],
    masked: bool,
    workspace: Path,
    options: ColmapOptions,
    refine_focal: bool,
) -> AdjustedCameras | None:
    """The cameras and points with the least robust reprojection error; None where there are too few points.

    `cameras` are those of the photographs, of all views in the order of `images`. With `refine_focal` the focal lengths
    change too, one for the images that share intrinsics.
    """
    folder = workspace / "adjustment"
    database = build_database(images, folder, attempts(options, masked)[0], options)
    model = reconstruction_of_poses({image.file: cameras[image.view] for image in images}, database)
    held_out: tuple[Track, ...] = ()
    features: set[tuple[int, int]] = set()
    for number, tolerance in enumerate(_TOLERANCES_PIXELS):
        model = _triangulated(model, database, folder, workspace / "images", tolerance, options)
        if number == 0:
            # chosen where the initial cameras explain them: the choice does not favour the adjusted ones
            held_out, features = _hold_out(model, images)
        _delete_points_of(features, model)
        moving = _images_with_points(model)
        if model.num_points3D() < _MIN_POINTS or len(moving) < 3:
            return None
        adjust_reconstruction(model, moving, options, focal_length=refine_focal and number > 0)
    return AdjustedCameras(
        tuple(_cameras_of(model, images, cameras)), len(_images_with_points(model)), model.num_points3D(), held_out
    )


def track_errors(tracks: Sequence[Track], cameras: Sequence[Camera]) -> Array:
    """Of each track (T,): the root mean square reprojection error, in pixels, of the point that fits it best."""
    return np.array([_track_error(track, [cameras[view] for view in track.views]) for track in tracks])


def _track_error(track: Track, cameras: Sequence[Camera]) -> float:
    rows = []
    for camera, (x, y) in zip(cameras, track.pixels, strict=True):
        projection = camera.intrinsics @ camera.world_to_camera[:3]
        pair = np.stack([x * projection[2] - projection[0], y * projection[2] - projection[1]])
        rows.append(pair / np.linalg.norm(pair[:, :3], axis=1, keepdims=True))
    system = np.concatenate(rows)
    point = np.linalg.lstsq(system[:, :3], -system[:, 3], rcond=None)[0]
    miss = [
        np.sum((camera.project(point[None])[0][0] - at) ** 2) for camera, at in zip(cameras, track.pixels, strict=True)
    ]
    return float(np.sqrt(np.mean(miss)))


def _triangulated(
    model: pycolmap.Reconstruction,
    database: Path,
    folder: Path,
    images: Path,
    tolerance: float,
    options: ColmapOptions,
) -> pycolmap.Reconstruction:
    models = folder / "models"
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir()
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.num_threads = options.threads
    pipeline.random_seed = options.seed
    focal = float(np.median([camera.mean_focal_length() for camera in model.cameras.values()]))
    angle = float(np.degrees(np.arctan(tolerance / focal)))
    pipeline.triangulation.create_max_angle_error = angle
    pipeline.triangulation.continue_max_angle_error = angle
    pipeline.triangulation.merge_max_reproj_error = tolerance
    pipeline.triangulation.complete_max_reproj_error = tolerance
    pipeline.mapper.filter_max_reproj_error = tolerance
    return run_cancellable(
        lambda token: pycolmap.triangulate_points(
            model, str(database), str(images), str(models), options=pipeline, cancellation_token=token
        )
    )


def _hold_out(
    model: pycolmap.Reconstruction, images: Sequence[SfmImage]
) -> tuple[tuple[Track, ...], set[tuple[int, int]]]:
    """Every fifth track, of those with three or more observations, and its features: image and index in the image."""
    by_name = {image.file: image for image in images}
    tracks: list[Track] = []
    features: set[tuple[int, int]] = set()
    long = [key for key in sorted(model.points3D) if model.points3D[key].track.length() >= 3]
    for key in long[::_HELD_OUT_INTERVAL]:
        views, pixels = [], []
        for element in model.points3D[key].track.elements:
            seen = model.images[element.image_id]
            image = by_name[seen.name]
            views.append(image.view)
            pixels.append(np.array(seen.points2D[element.point2D_idx].xy) * image.factor)
            features.add((element.image_id, element.point2D_idx))
        tracks.append(Track(np.array(views), np.array(pixels)))
    return tuple(tracks), features


def _delete_points_of(features: set[tuple[int, int]], model: pycolmap.Reconstruction) -> None:
    """Removes the points that any of these features shows: no adjustment sees a held-out track."""
    for key in sorted(model.points3D):
        if any((e.image_id, e.point2D_idx) in features for e in model.points3D[key].track.elements):
            model.delete_point3D(key)


def _images_with_points(model: pycolmap.Reconstruction) -> list[pycolmap.Image]:
    return [image for image in model.images.values() if image.num_points3D >= _MIN_OBSERVATIONS]


def adjust_reconstruction(
    model: pycolmap.Reconstruction,
    moving: Sequence[pycolmap.Image],
    options: ColmapOptions,
    *,
    focal_length: bool,
    distortion: bool = False,
) -> None:
    """Moves poses and points of `model`, and focal lengths and distortions if asked; images outside `moving` keep their
    poses and hold the world.
    """
    settings = pycolmap.BundleAdjustmentOptions()
    settings.refine_focal_length = focal_length
    settings.refine_extra_params = distortion
    settings.refine_principal_point = False
    settings.print_summary = False
    settings.ceres.loss_function_type = pycolmap.LossFunctionType.SOFT_L1
    settings.ceres.loss_function_scale = LOSS_SCALE_PIXELS
    settings.ceres.solver_options.num_threads = options.threads
    config = pycolmap.BundleAdjustmentConfig()
    free = {image.image_id for image in moving}
    for image in model.images.values():
        config.add_image(image.image_id)
        if image.image_id not in free:
            config.set_constant_rig_from_world_pose(image.frame_id)
    if len(free) == len(model.images):
        config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(settings, config, model).solve()


def _cameras_of(model: pycolmap.Reconstruction, images: Sequence[SfmImage], given: Sequence[Camera]) -> list[Camera]:
    by_name = {image.name: image for image in model.images.values()}
    cameras = []
    for image in images:
        found = by_name[image.file]
        pose = np.eye(4)
        pose[:3] = found.cam_from_world().matrix()
        fx, fy, cx, cy = (float(value) * image.factor for value in model.cameras[found.camera_id].params)
        intrinsics = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
        old = given[image.view]
        # unchanged numbers stay bit for bit, a skew too
        kept = np.allclose(intrinsics[[0, 1], [0, 1]], old.intrinsics[[0, 1], [0, 1]], rtol=1e-9)
        cameras.append(replace(old, world_to_camera=pose, intrinsics=old.intrinsics if kept else intrinsics))
    return cameras
