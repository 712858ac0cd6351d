"""The simplest lens that explains the tracks: a distortion that does not is left out.

From far away a distortion, the focal length and the distance of the object imitate each other. A distortion that the
photographs do not show takes the focal length with it: of an undistorted lens it was estimated 2 % too short.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.bundle_adjustment import LOSS_SCALE_PIXELS, adjust_reconstruction

LEAST_GAIN = 0.002
"""Relative fall of the reprojection error by which a distortion counts; one that is not there brings 0.0001 to 0.0003
(docs/studies/cameras_from_photographs.md#the-lens)."""
REQUIRED_STANDARD_ERRORS = 2.0
"""Of that fall, over photographs."""
LEAST_OBSERVATIONS = 24
"""Of a photograph that is compared."""
LARGEST_PIXELS = 3 * LOSS_SCALE_PIXELS
"""A larger reprojection error counts as this: a wrong match."""


@dataclass(frozen=True)
class LensComparison:
    """How much a distortion lowers the reprojection error of the same tracks."""

    gain: float
    """Mean relative fall over photographs."""
    standard_error: float
    distorted: bool
    """Whether the distortion is kept."""

    def document(self) -> Mapping[str, object]:
        """For run.json."""
        return {
            "distortion": "kept" if self.distorted else "left out",
            "gain": round(self.gain, 5),
            "standard_error": round(self.standard_error, 5),
        }


def simplest_lens(
    model: pycolmap.Reconstruction, options: ColmapOptions
) -> tuple[pycolmap.Reconstruction, LensComparison | None]:
    """The reconstruction without distortion where that explains its tracks as well, with a comparison.

    Only of SIMPLE_RADIAL lenses whose intrinsics are estimated; others are returned as they are.
    """
    radial = pycolmap.CameraModelId.SIMPLE_RADIAL
    if not options.refine_intrinsics or any(camera.model != radial for camera in model.cameras.values()):
        return model, None
    distorted, plain = pycolmap.Reconstruction(model), pycolmap.Reconstruction(model)
    for camera in plain.cameras.values():
        kept = list(camera.params)[:3]
        camera.model = pycolmap.CameraModelId.SIMPLE_PINHOLE
        camera.params = kept
    for each in (distorted, plain):
        moving = [image for image in each.images.values() if image.has_pose]
        adjust_reconstruction(each, moving, options, focal_length=True, distortion=True)
        each.update_point_3d_errors()
    with_distortion, without = _errors(distorted), _errors(plain)
    names = sorted(with_distortion.keys() & without.keys())
    if len(names) < 3:
        return model, None
    falls = np.array([1 - with_distortion[name] / max(without[name], 1e-12) for name in names])
    gain, error = float(falls.mean()), float(falls.std(ddof=1) / np.sqrt(len(falls)))
    is_distorted = gain > max(LEAST_GAIN, REQUIRED_STANDARD_ERRORS * error)
    return (model if is_distorted else plain), LensComparison(gain, error, is_distorted)


def _errors(model: pycolmap.Reconstruction) -> dict[str, float]:
    """Root mean square reprojection error of each photograph, by name; large ones count as `LARGEST_PIXELS`."""
    found = {}
    for image in model.images.values():
        if not image.has_pose:
            continue
        seen = [point for point in image.points2D if point.has_point3D()]
        if len(seen) < LEAST_OBSERVATIONS:
            continue
        pose = image.cam_from_world().matrix()
        points = np.stack([model.points3D[point.point3D_id].xyz for point in seen]) @ pose[:, :3].T + pose[:, 3]
        camera = model.cameras[image.camera_id]
        projected = np.stack([camera.img_from_cam(point) for point in points])
        squared = ((projected - np.stack([point.xy for point in seen])) ** 2).sum(axis=1)
        found[image.name] = float(np.sqrt(np.minimum(squared, LARGEST_PIXELS**2).mean()))
    return found
