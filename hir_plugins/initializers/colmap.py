"""Initializer: cameras and points from photographs alone."""


from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import numpy as np
from hir_exporters.conventions import srgb_to_linear

from hir_core.capture import Array, Camera, Capture, OrientedPoints, View
from hir_core.errors import CaptureError
from hir_core.interfaces import Initializer
from hir_core.lens import camera_lens, resample
from hir_core.scene import Scene
from hir_plugins.initializers.object_ball import object_ball
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm import best_model
from hir_plugins.initializers.sfm_images import SfmImage, write_images
from hir_plugins.readers.colmap_files import lens_camera
from hir_plugins.readers.upright import upright

_MIN_CONTRAST = 2.0 / 255


@final
class Colmap(Initializer):
    """Solves cameras with COLMAP; the world is turned up-right, centred on the object and brought to its size."""

    def __init__(self, config: ColmapOptions) -> None:
        self._config = config

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture with cameras where they were found, and sparse points.

        Views that could not be placed keep `camera` None and are named in a warning. A capture whose views all have
        cameras is given back as it is. Fewer than three photographs that fit together raise `CaptureError`.
        """
        if capture.views and all(view.camera is not None for view in capture.views):
            warnings.warn("the capture has cameras already; colmap leaves them as they are", stacklevel=2)
            return capture, scene
        _check_photographs(capture)
        images, masked = write_images(capture.views, workspace, self._config.max_image_size)
        model = best_model(images, masked and self._config.use_masks, workspace, self._config)
        if model is None or model.num_reg_images() < 3:
            raise CaptureError(f"{capture.path}: COLMAP could not place the photographs. Take more of them, with much "
                               "overlap, from places a few degrees apart, sharp, and with texture in sight")
        solved = solved_capture(capture, images, model)
        lost = [view.name for view in solved.views if view.camera is None]
        if lost:
            warnings.warn(f"{len(lost)} of {len(solved.views)} photographs could not be placed: {', '.join(lost[:10])}",
                          stacklevel=2)  # fmt: skip
        return solved.transformed(_object_frame(solved, self._config.size)), scene


def solved_capture(capture: Capture, images: Sequence[SfmImage], model: Any) -> Capture:
    """The capture with a reconstruction's cameras, lenses and points, in the reconstruction's world."""
    by_file = {image.name: image for image in model.images.values() if image.has_pose}
    views = []
    for image in images:
        view = capture.views[image.view]
        placed = by_file.get(image.file)
        views.append(view if placed is None else _placed(view, image, placed, model.cameras[placed.camera_id]))
    points = [(p.xyz, p.color) for p in model.points3D.values() if p.track.length() >= 3 and p.error < 2]
    cloud = None
    if points:
        colors = srgb_to_linear(np.array([color for _, color in points], dtype=np.float64) / 255)
        cloud = OrientedPoints(positions=np.array([xyz for xyz, _ in points]), colors=colors)
    return replace(capture, views=tuple(views), points=cloud)


def _placed(view: View, image: SfmImage, placed: Any, solved: Any) -> View:
    pose = np.eye(4)
    pose[:3] = placed.cam_from_world().matrix()
    lens = lens_camera(solved.model.name, list(solved.params), solved.width, solved.height, view.name)
    pixels = view.read().color_linear.shape
    f = image.factor
    intrinsics = np.array([[lens.fx * f, 0, lens.cx * f], [0, lens.fy * f, lens.cy * f], [0, 0, 1.0]])
    camera = Camera(intrinsics, pose, pixels[1], pixels[0])
    distortion = lens.coefficients if any(lens.coefficients) else ()
    mask = view.mask
    if mask is not None and distortion:
        # the mask was drawn on the picture as taken; from here on pictures are straight
        mask = resample(mask, camera_lens(camera, distortion))
    return replace(view, camera=camera, distortion=distortion, mask=mask)


def _check_photographs(capture: Capture) -> None:
    if len(capture.views) < 3:
        raise CaptureError(f"{capture.path} has {len(capture.views)} photographs; finding cameras needs at least "
                           "three, better 30 from all sides")
    flat = []
    for view in capture.views:
        image = view.read().color_linear[::4, ::4]
        if float(np.ptp(image)) < _MIN_CONTRAST:
            flat.append(view.name)
    if len(flat) > len(capture.views) - 3:
        raise CaptureError(f"{capture.path}: {len(flat)} of {len(capture.views)} photographs are of one colour, such "
                           f"as {flat[0]}; there is nothing to match")


def _object_frame(capture: Capture, size: float) -> Array:
    """4×4 similarity: up is up, the object at the origin, its longest side about `size`."""
    poses = [view.camera.world_to_camera for view in capture.views if view.camera is not None]
    turn = upright(poses)
    center, radius = object_ball(capture)
    scale = size / (2 * radius)
    move = np.eye(4)
    move[:3, :3] *= scale
    move[:3, 3] = -scale * (turn[:3, :3] @ center)
    return move @ turn
