"""Points from photographs with known cameras, by COLMAP's triangulation of matched features."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap

from hir_core.capture import Camera
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.feature_matching import run_cancellable
from hir_plugins.initializers.sfm.sfm_images import SfmImage
from hir_plugins.initializers.sfm.structure_from_motion import attempts, build_database


def triangulate(
    images: Sequence[SfmImage],
    cameras: Sequence[Camera],
    masked: bool,
    workspace: Path,
    options: ColmapOptions,
    takes: int = 1,
) -> pycolmap.Reconstruction:
    """A reconstruction with the given cameras, one for each image of `takes`, and triangulated points."""
    folder = workspace / "triangulation"
    database = build_database(images, folder, attempts(options, masked)[0], options, takes)
    posed = reconstruction_of_poses({image.file: cameras[image.view] for image in images}, database)
    models = folder / "models"
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir()
    pipeline = pycolmap.IncrementalPipelineOptions()
    pipeline.num_threads = options.threads
    pipeline.random_seed = options.seed
    images_folder = str(workspace / "images")
    return run_cancellable(
        lambda token: pycolmap.triangulate_points(
            posed, str(database), images_folder, str(models), options=pipeline, cancellation_token=token
        )
    )


def reconstruction_of_poses(cameras: dict[str, Camera], database: Path) -> pycolmap.Reconstruction:
    """A reconstruction of the given poses, with the identifiers of the database."""
    posed = pycolmap.Reconstruction()
    opened = pycolmap.Database.open(str(database))
    try:
        for camera in opened.read_all_cameras():
            posed.add_camera(camera)
        for rig in opened.read_all_rigs():
            posed.add_rig(rig)
        images = {image.image_id: image for image in opened.read_all_images()}
        for frame in opened.read_all_frames():
            frame.rig_from_world = _rigid3d(cameras[images[next(iter(frame.image_ids)).id].name])
            posed.add_frame(frame)
        for image in images.values():
            posed.add_image(image)
        for frame in list(posed.frames.values()):
            posed.register_frame(frame.frame_id)
    finally:
        opened.close()
    return posed


def _rigid3d(camera: Camera) -> pycolmap.Rigid3d:
    pose = np.ascontiguousarray(camera.world_to_camera[:3], dtype=np.float64)
    return pycolmap.Rigid3d(pose)
