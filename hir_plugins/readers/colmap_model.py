"""Captures solved by COLMAP: a sparse model and its images (docs/captures.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import numpy as np

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.capture_paths import find_photo, unique_names
from hir_plugins.readers.parsing.colmap_format.colmap_files import read_cameras, read_images, read_points
from hir_plugins.readers.parsing.lens_camera import make_view
from hir_plugins.readers.parsing.mask_files import find_mask, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.takes_file import with_takes
from hir_plugins.readers.parsing.upright import upright_rotation_of

_MODELS: Final = ("sparse/0", "sparse", "colmap/sparse/0", "colmap/sparse", "dense/sparse", "colmap", "model", ".")
_IMAGES: Final = ("images", "image", "input", "rgb", "photos", ".")


@final
class ColmapModelReader(CaptureReader):
    """Reads cameras.{bin,txt}, images.{bin,txt} and points3D.{bin,txt}; the world is rotated upright."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder with a model in one of the usual subfolders."""
        return _model_folder(path) is not None

    def splits(self, path: Path) -> list[str]:
        """Only "train": a model has no splits."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Registered images with their cameras, the takes that takes.toml lists, and the sparse points."""
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of a COLMAP model")
        model = _model_folder(path)
        if model is None:
            raise CaptureError(f"{path} has no COLMAP model; put cameras and images (.bin or .txt) into 'sparse/0'")
        cameras, images = read_cameras(model), read_images(model)
        folder = _image_folder(path, images[0].name)
        photos = [find_photo(folder, image.name, model) for image in images]
        views = []
        for image, photo, name in zip(images, photos, unique_names(photos, folder), strict=True):
            if image.camera_id not in cameras:
                raise CaptureError(
                    f"{model}: the image {image.name!r} has camera {image.camera_id}, which is missing; export the "
                    "model "
                    "again"
                )
            owner = f"{model}, image {image.name!r}"
            mask = find_mask(photo, path)
            views.append(make_view(name, photo, cameras[image.camera_id], image.world_to_camera, owner, mask))
        warn_of_mask_names(matches_of(views), path)
        capture = Capture(
            path=path,
            views=with_takes(views, path),
            points=read_points(model),
            world_from_source=np.eye(4),
            reader="colmap_model",
        )
        return capture.transformed(upright_rotation_of(capture.views))


def _model_folder(path: Path) -> Path | None:
    for name in _MODELS:
        folder = path / name
        for suffix in (".bin", ".txt"):
            if (folder / f"cameras{suffix}").is_file() and (folder / f"images{suffix}").is_file():
                return folder
    return None


def _image_folder(path: Path, first: str) -> Path:
    for name in _IMAGES:
        if (path / name / first).is_file():
            return path / name
    raise CaptureError(
        f"{path}: the image {first!r} of the COLMAP model is in none of the folders {', '.join(_IMAGES)}; put the "
        "images "
        "into the folder 'images'"
    )
