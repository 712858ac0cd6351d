"""Initializer: cameras and sparse points from photographs, by structure from motion."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import final

import numpy as np
import pycolmap
from hir_exporters.conventions import srgb_to_linear

from hir_core.capture import Array, Camera, Capture, OrientedPoints, View
from hir_core.capture.lens import camera_lens, resample
from hir_core.errors import CaptureError, ConfigError
from hir_core.plugins.interfaces import Initializer
from hir_core.run.determinism import threads
from hir_core.scene import Scene
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.lens_selection import simplest_lens
from hir_plugins.initializers.sfm.metric_scale import MetricScale, read_marks, scale_of_bar, scale_of_gps
from hir_plugins.initializers.sfm.sfm_images import SfmImage, write_images
from hir_plugins.initializers.sfm.source_alignment import solved_from_source
from hir_plugins.initializers.sfm.structure_from_motion import largest_reconstruction
from hir_plugins.initializers.sfm.triangulation import triangulate
from hir_plugins.initializers.surface.object_bounds import object_bounding_sphere
from hir_plugins.readers.parsing.colmap_format.colmap_lenses import lens_camera
from hir_plugins.readers.parsing.upright import upright_rotation_of

_MIN_CONTRAST = 2.0 / 255
"""Range of linear values below which a photograph has one colour."""


@final
class Colmap(Initializer):
    """Estimates cameras with COLMAP, or triangulates points with known cameras.

    The estimated world is rotated upright, centred on the object and scaled to metres.
    """

    def __init__(self, config: ColmapOptions) -> None:
        # COLMAP is deterministic only with one thread: each thread has its own random numbers
        self._config = replace(config, threads=threads(config.threads))
        self._report: dict[str, object] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The capture with estimated cameras and sparse points.

        Unregistered views keep `camera` None and are named in a warning. If all views have cameras, these are kept
        unless the options request new ones. Fewer than three registered photographs raise `CaptureError`.
        """
        _check_photographs(capture)
        posed = all(view.camera is not None for view in capture.views)
        if posed and self._config.known_cameras == "triangulate":
            return self._with_points(capture, workspace), scene
        original = capture
        capture = replace(capture, views=tuple(replace(v, camera=None, distortion=()) for v in capture.views))
        images, masked = write_images(capture.views, workspace, self._config.max_image_size, known=False)
        masked = masked and self._config.use_masks
        takes = capture.takes
        if len(takes) > 1:
            _check_takes(capture, masked, self._config)
        model = largest_reconstruction(images, masked, workspace, self._config, len(takes))
        if model is None or model.num_reg_images() < 3:
            raise CaptureError(
                f"{capture.path}: COLMAP could not register the photographs; take more of them, sharp, with texture, "
                "and with large overlap: a few degrees between neighbours"
            )
        model, lens = simplest_lens(model, self._config)
        solved = solved_capture(capture, images, model)
        if any(view.depth is not None for view in capture.views):
            warnings.warn(
                "the depth maps are not used, because their unit is that of the capture's own cameras, which have been "
                "estimated again",
                stacklevel=2,
            )
        unregistered = [view.name for view in solved.views if view.camera is None]
        if unregistered:
            warnings.warn(
                f"{len(unregistered)} of {len(solved.views)} photographs could not be registered: "
                f"{', '.join(unregistered[:10])}",
                stacklevel=2,
            )
        _warn_of_missing_takes(solved)
        if posed:
            solved = replace(solved, world_from_source=solved_from_source(solved, original, self._config.seed))
        object_from_solved, radius = _object_frame(solved)
        size = self._config.object_size
        scale = self._scale(solved) or MetricScale(size / (2 * radius), f"object_size, assumed to be {size:g} m")
        self._report = {
            "cameras": f"{len(solved.views) - len(unregistered)} of {len(solved.views)} solved",
            "scale_from": scale.source,
        }
        if lens is not None:
            self._report["lens"] = lens.document()
        metres = scale.metres_per_unit
        return solved.transformed(np.diag([metres, metres, metres, 1.0]) @ object_from_solved), scene

    def files(self, capture: Capture) -> list[Path]:
        """The file of the scale bar's marks, if the options name one."""
        path = Path(self._config.scale_bar)
        return [path if path.is_absolute() else capture.path / path] if self._config.scale_bar else []

    def report(self) -> Mapping[str, object]:
        """How many cameras were estimated, and the source of the scale."""
        return self._report

    def _scale(self, solved: Capture) -> MetricScale | None:
        if self._config.scale_bar:
            return scale_of_bar(read_marks(self.files(solved)[0]), self._config.scale_bar_length, solved.views)
        # of several takes the first: the object moved between the positions of two
        first = next(view.take for view in solved.views if view.camera is not None)
        views = [view for view in solved.views if view.take == first]
        return scale_of_gps(views, self._config.seed) if self._config.gps else None

    def _with_points(self, capture: Capture, workspace: Path) -> Capture:
        images, masked = write_images(capture.views, workspace, self._config.max_image_size, known=True)
        masked = masked and self._config.use_masks
        model = triangulate(images, capture.cameras, masked, workspace, self._config, len(capture.takes))
        cloud = sparse_points(model)
        if cloud is None:
            warnings.warn(
                "no feature match agrees with the capture's cameras, so there are no points; hir check shows whether "
                "cameras and masks agree",
                stacklevel=2,
            )
        count = 0 if cloud is None else len(cloud.positions)
        self._report = {"cameras": "of the capture", "points": count}
        return replace(capture, points=cloud)


def solved_capture(capture: Capture, images: Sequence[SfmImage], model: pycolmap.Reconstruction) -> Capture:
    """The capture with a reconstruction's cameras, lenses and points, in the reconstruction's world."""
    registered = {image.name: image for image in model.images.values() if image.has_pose}
    views = []
    for image in images:
        view = capture.views[image.view]
        registered_image = registered.get(image.file)
        views.append(
            view
            if registered_image is None
            else _solved_view(view, image, registered_image, model.cameras[registered_image.camera_id])
        )
    return replace(capture, views=tuple(views), points=sparse_points(model))


def sparse_points(model: pycolmap.Reconstruction) -> OrientedPoints | None:
    """The points of a reconstruction with observations in three images and a mean error below two pixels."""
    points = [(p.xyz, p.color) for p in model.points3D.values() if p.track.length() >= 3 and p.error < 2]
    if not points:
        return None
    colors = srgb_to_linear(np.array([color for _, color in points], dtype=np.float64) / 255)
    return OrientedPoints(positions=np.array([xyz for xyz, _ in points]), colors=colors)


def _solved_view(view: View, image: SfmImage, registered_image: pycolmap.Image, solved: pycolmap.Camera) -> View:
    pose = np.eye(4)
    pose[:3] = registered_image.cam_from_world().matrix()
    lens = lens_camera(solved.model.name, list(solved.params), solved.width, solved.height, view.name)
    pixels = view.read().color_linear.shape
    f = image.factor
    intrinsics = np.array([[lens.fx * f, 0, lens.cx * f], [0, lens.fy * f, lens.cy * f], [0, 0, 1.0]])
    camera = Camera(intrinsics, pose, pixels[1], pixels[0])
    distortion = lens.coefficients if any(lens.coefficients) else ()
    mask = view.mask
    if mask is not None and distortion:
        # the mask belongs to the photograph as taken; from here on photographs are undistorted
        mask = resample(mask.astype(np.float32), camera_lens(camera, distortion)).astype(mask.dtype)
    # a measured depth is in the unit of other cameras
    return replace(view, camera=camera, distortion=distortion, mask=mask, depth=None)


def _check_photographs(capture: Capture) -> None:
    if len(capture.views) < 3:
        raise CaptureError(
            f"{capture.path} has {len(capture.views)} photographs; structure from motion needs at least three, better "
            "30 from all sides"
        )
    flat = []
    for view in capture.views:
        image = view.read().color_linear[::4, ::4]
        if float(np.ptp(image)) < _MIN_CONTRAST:
            flat.append(view.name)
    if len(flat) > len(capture.views) - 3:
        raise CaptureError(
            f"{capture.path}: {len(flat)} of {len(capture.views)} photographs have only one colour, such as {flat[0]}; "
            "remove them or take photographs with texture"
        )


def _check_takes(capture: Capture, masked: bool, options: ColmapOptions) -> None:
    """Raises where features cannot join several takes."""
    named = f"the takes {', '.join(capture.takes)}"
    if not options.use_masks:
        raise ConfigError(
            f"initializer.colmap.use_masks is false, but {named} are joined by features of the object alone; set it to "
            "true"
        )
    if not masked:
        raise CaptureError(
            f"{capture.path}: {named} are joined by features of the object alone, which needs masks of all "
            "photographs; put masks beside them (docs/captures.md), or give cameras in the axes of the object"
        )
    if options.matching == "sequential":
        raise ConfigError(
            f"initializer.colmap.matching is 'sequential', which does not compare {named} with each other; set it to "
            "'auto'"
        )


def _warn_of_missing_takes(solved: Capture) -> None:
    """A warning for each take of which no photograph has a camera."""
    for take in solved.takes:
        views = [view for view in solved.views if view.take == take]
        if len(solved.takes) > 1 and all(view.camera is None for view in views):
            warnings.warn(
                f"no photograph of the take {take} could be registered, so its {len(views)} photographs are left out; "
                "add photographs to both takes that show the same side of the object",
                stacklevel=3,
            )


def _object_frame(capture: Capture) -> tuple[Array, float]:
    """4×4 rigid transform to an upright world with the object at the origin, and the object's radius."""
    rotation = upright_rotation_of(capture.views)
    center, radius = object_bounding_sphere(capture)
    translation = np.eye(4)
    translation[:3, 3] = -(rotation[:3, :3] @ center)
    return translation @ rotation, radius
