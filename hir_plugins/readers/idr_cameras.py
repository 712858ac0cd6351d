"""IDR, NeuS and DTU captures: `cameras.npz` with `world_mat_i` and `scale_mat_i`, folders `image` and `mask`."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final, final

import numpy as np

from hir_core.capture import Capture, similarity_scale
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.camera_axes import MAX_DISTANCE
from hir_plugins.readers.parsing.capture_paths import photos_in_first_folder, unique_names
from hir_plugins.readers.parsing.lens_camera import LensCamera, make_view
from hir_plugins.readers.parsing.mask_files import find_mask, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.pose_files import decompose_projection, load_arrays
from hir_plugins.readers.parsing.upright import upright_rotation

_FILES: Final = ("cameras.npz", "cameras_sphere.npz", "cameras_large.npz", "cameras_hd.npz")
_FOLDERS: Final = ("image", "images", "rgb")


@final
class IdrCamerasReader(CaptureReader):
    """Projection matrices `world_mat`; `scale_mat` maps the unit sphere to a sphere around the object."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with one of the usual camera files."""
        return path.is_dir() and _file(path) is not None

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Photographs in the order of their names, cameras by number; the world is rotated upright."""
        source = _file(path)
        if source is None or split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of cameras.npz")
        arrays = load_arrays(source)
        numbers = sorted(int(m[1]) for name in arrays if (m := re.fullmatch(r"world_mat_(0|[1-9]\d{0,8})", name)))
        photos = photos_in_first_folder(path, _FOLDERS)
        if not numbers or len(photos) != len(numbers):
            raise CaptureError(
                f"{source} has {len(numbers)} cameras (world_mat_<i>) and {path} {len(photos)} images; give one each"
            )
        views, poses = [], []
        for number, photo, name in zip(numbers, photos, unique_names(photos, path), strict=True):
            owner = f"{source}, world_mat_{number}"
            matrix = arrays[f"world_mat_{number}"]
            if matrix.shape not in ((4, 4), (3, 4)):
                raise CaptureError(f"{owner} has the shape {matrix.shape}; write a 4×4 matrix")
            k, pose = decompose_projection(matrix[:3], owner)
            views.append(
                make_view(
                    name, photo, LensCamera(k[0, 0], k[1, 1], k[0, 2], k[1, 2]), pose, owner, find_mask(photo, path)
                )
            )
            poses.append(pose)
        warn_of_mask_names(matches_of(views), path)
        capture = Capture(path=path, views=tuple(views), world_from_source=np.eye(4), reader="idr_cameras")
        capture = capture.transformed(upright_rotation(poses))
        scale = arrays.get(f"scale_mat_{numbers[0]}")
        if scale is None or scale.shape != (4, 4) or not similarity_scale(scale) > 1e-12:
            return capture
        if not similarity_scale(scale) < MAX_DISTANCE or np.abs(scale).max() > MAX_DISTANCE:
            raise CaptureError(f"{source}, scale_mat_{numbers[0]}: its sphere is not finite; export the cameras again")
        # the sphere around the object becomes the unit sphere at the origin
        center = capture.world_from_source @ [*scale[:3, 3], 1.0]
        move = np.diag([1 / similarity_scale(scale)] * 3 + [1.0])
        move[:3, 3] = -center[:3] / similarity_scale(scale)
        return capture.transformed(move)


def _file(path: Path) -> Path | None:
    return next((path / name for name in _FILES if (path / name).is_file()), None)
