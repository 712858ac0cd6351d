"""Initializer: cameras and points from photographs alone."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, final

import numpy as np
import pycolmap
from hir_exporters.conventions import srgb_to_linear

from hir_core.capture import Array, Camera, Capture, OrientedPoints, View
from hir_core.capture.lens import camera_lens, resample
from hir_core.errors import CaptureError
from hir_core.plugins.interfaces import Initializer
from hir_core.run.determinism import threads
from hir_core.scene import Scene
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.metric_scale import MetricScale, read_marks, scale_of_bar, scale_of_gps
from hir_plugins.initializers.sfm.sfm_images import SfmImage, write_images
from hir_plugins.initializers.sfm.structure_from_motion import largest_reconstruction
from hir_plugins.initializers.sfm.triangulation import triangulate
from hir_plugins.initializers.surface.object_bounds import object_bounding_sphere
from hir_plugins.readers.parsing.colmap_lenses import lens_camera
from hir_plugins.readers.parsing.upright import upright_rotation

_MIN_CONTRAST = 2.0 / 255


@final
class Colmap(Initializer):
    """Solves cameras with COLMAP, or the points that known cameras see.

    A solved world is turned up-right, centred on the object and brought to its size in metres.
    """

    def __init__(self, config: ColmapOptions) -> None:
        # COLMAP's threads meet in any order, and its random numbers are each thread's own
        self._config = replace(config, threads=threads(config.threads))
        self._report: dict[str, Any] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture with cameras where they were found, and sparse points.

        Views that could not be placed keep `camera` None and are named in a warning. A capture whose views all have
        cameras keeps them, unless the options ask for new ones. Fewer than three photographs that fit together raise
        `CaptureError`.
        """
        _check_photographs(capture)
        posed = all(view.camera is not None for view in capture.views)
        if posed and self._config.known_cameras == "triangulate":
            return self._with_points(capture, workspace), scene
        given = capture
        capture = replace(capture, views=tuple(replace(v, camera=None, distortion=()) for v in capture.views))
        images, masked = write_images(capture.views, workspace, self._config.max_image_size, known=False)
        model = largest_reconstruction(images, masked and self._config.use_masks, workspace, self._config)
        if model is None or model.num_reg_images() < 3:
            raise CaptureError(
                f"{capture.path}: COLMAP could not place the photographs. Take more of them, with much "
                "overlap, from places a few degrees apart, sharp, and with texture in sight"
            )
        solved = solved_capture(capture, images, model)
        lost = [view.name for view in solved.views if view.camera is None]
        if lost:
            warnings.warn(
                f"{len(lost)} of {len(solved.views)} photographs could not be placed: {', '.join(lost[:10])}",
                stacklevel=2,
            )
        if posed:
            solved = replace(solved, world_from_source=_solved_from_source(solved, given))
        turn, radius = _object_frame(solved)
        scale = self._scale(solved) or MetricScale(self._config.size / (2 * radius), f"size {self._config.size:g} m")
        self._report = {
            "cameras": f"{len(solved.views) - len(lost)} of {len(solved.views)} solved",
            "scale_from": scale.source,
        }
        move = np.diag([scale.metres, scale.metres, scale.metres, 1.0]) @ turn
        return solved.transformed(move), scene

    def files(self, capture: Capture) -> list[Path]:
        """The scale bar's marks, where the options name them."""
        path = Path(self._config.scale_bar)
        return [path if path.is_absolute() else capture.path / path] if self._config.scale_bar else []

    def report(self) -> Mapping[str, Any]:
        """What was solved, and what told the size."""
        return self._report

    def _scale(self, solved: Capture) -> MetricScale | None:
        if self._config.scale_bar:
            return scale_of_bar(read_marks(self.files(solved)[0]), self._config.scale_bar_length, solved.views)
        return scale_of_gps(solved.views) if self._config.gps else None

    def _with_points(self, capture: Capture, workspace: Path) -> Capture:
        images, masked = write_images(capture.views, workspace, self._config.max_image_size, known=True)
        model = triangulate(images, capture.cameras, masked and self._config.use_masks, workspace, self._config)
        cloud = sparse_points(model)
        if cloud is None:
            warnings.warn(
                "no feature of the photographs fits the capture's cameras, so that there are no points; "
                "hir check shows whether cameras and masks agree",
                stacklevel=2,
            )
        count = 0 if cloud is None else len(cloud.positions)
        self._report = {"cameras": "kept as given", "points": count}
        return replace(capture, points=cloud)


def solved_capture(capture: Capture, images: Sequence[SfmImage], model: Any) -> Capture:
    """The capture with a reconstruction's cameras, lenses and points, in the reconstruction's world."""
    by_file = {image.name: image for image in model.images.values() if image.has_pose}
    views = []
    for image in images:
        view = capture.views[image.view]
        placed = by_file.get(image.file)
        views.append(view if placed is None else _solved_view(view, image, placed, model.cameras[placed.camera_id]))
    return replace(capture, views=tuple(views), points=sparse_points(model))


def sparse_points(model: Any) -> OrientedPoints | None:
    """The points of a reconstruction that three pictures see within two pixels."""
    points = [(p.xyz, p.color) for p in model.points3D.values() if p.track.length() >= 3 and p.error < 2]
    if not points:
        return None
    colors = srgb_to_linear(np.array([color for _, color in points], dtype=np.float64) / 255)
    return OrientedPoints(positions=np.array([xyz for xyz, _ in points]), colors=colors)


def _solved_view(view: View, image: SfmImage, placed: Any, solved: Any) -> View:
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
        raise CaptureError(
            f"{capture.path} has {len(capture.views)} photographs; finding cameras needs at least "
            "three, better 30 from all sides"
        )
    flat = []
    for view in capture.views:
        image = view.read().color_linear[::4, ::4]
        if float(np.ptp(image)) < _MIN_CONTRAST:
            flat.append(view.name)
    if len(flat) > len(capture.views) - 3:
        raise CaptureError(
            f"{capture.path}: {len(flat)} of {len(capture.views)} photographs are of one colour, such "
            f"as {flat[0]}; there is nothing to match"
        )


def _object_frame(capture: Capture) -> tuple[Array, float]:
    """4×4 motion after which up is up and the object lies at the origin, and the object's radius."""
    poses = [view.camera.world_to_camera for view in capture.views if view.camera is not None]
    turn = upright_rotation(poses)
    center, radius = object_bounding_sphere(capture)
    move = np.eye(4)
    move[:3, 3] = -(turn[:3, :3] @ center)
    return move @ turn, radius


def _solved_from_source(solved: Capture, given: Capture) -> Array:
    """4×4 from the files' world to the solved one, by the cameras' places: held-out views and a true mesh still fit."""
    pairs = [
        (a.camera.center, b.camera.center)
        for a, b in zip(given.views, solved.views, strict=True)
        if a.camera is not None and b.camera is not None
    ]
    old, new = (np.array(places) for places in zip(*pairs, strict=True))
    options = pycolmap.RANSACOptions()
    options.max_error, options.random_seed = 0.05 * float(np.ptp(new, axis=0).max()), 0
    fit: Any = pycolmap.estimate_sim3d_robust(old, new, options)
    if fit is None:
        warnings.warn(
            "the cameras that were solved do not resemble those that the capture has; held-out views "
            "cannot be compared with this run",
            stacklevel=3,
        )
        return np.eye(4)
    similarity = np.eye(4)
    similarity[:3] = fit["tgt_from_src"].matrix()
    return similarity @ given.world_from_source
