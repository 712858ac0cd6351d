"""BlendedMVS and MVSNet captures: `cams/<number>_cam.txt` and `blended_images/<number>.jpg`."""

from __future__ import annotations

from pathlib import Path
from typing import Final, final

import numpy as np
from hir_exporters.files.regular_files import refuse_special_file

from hir_core.capture import Array, Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.parsing.camera_axes import rigid_transform
from hir_plugins.readers.parsing.capture_paths import contained_path, find_photo, unique_names
from hir_plugins.readers.parsing.lens_camera import HALF_PIXEL, LensCamera, make_view
from hir_plugins.readers.parsing.mask_files import find_mask, matches_of, warn_of_mask_names
from hir_plugins.readers.parsing.upright import upright_rotation

_FOLDERS: Final = ("blended_images", "images", "image")


@final
class BlendedMvsReader(CaptureReader):
    """Text files `extrinsic` (4×4, world to camera) and `intrinsic` (3×3); OpenCV axes, pixel centres at .0."""

    def __init__(self, config: NoOptions) -> None:
        del config

    def matches(self, path: Path) -> bool:
        """A folder `cams` with *_cam.txt."""
        return (path / "cams").is_dir() and any((path / "cams").glob("*_cam.txt"))

    def splits(self, path: Path) -> list[str]:
        """Only "train"."""
        return ["train"]

    def read(self, path: Path, split: str = "train") -> Capture:
        """Images of all camera files, by name; the world is rotated upright."""
        if split != "train":
            raise CaptureError(f"{path} has no split {split!r}; read 'train', the only split of a BlendedMVS capture")
        folder = next((path / name for name in _FOLDERS if (path / name).is_dir()), None)
        if folder is None:
            raise CaptureError(f"{path} has none of the folders {', '.join(_FOLDERS)}; put the images into one of them")
        sources = sorted((path / "cams").glob("*_cam.txt"))
        # masked versions of the same images end in _masked
        photos = [find_photo(folder, s.name.removesuffix("_cam.txt"), s) for s in sources]
        views, poses = [], []
        for source, photo, name in zip(sources, photos, unique_names(photos, folder), strict=True):
            contained_path(path, source.relative_to(path).as_posix(), path)
            pose, k = _camera(source)
            # pixel centres are integers in the files and at .5 in `Camera`
            lens = LensCamera(k[0, 0], k[1, 1], k[0, 2] + HALF_PIXEL, k[1, 2] + HALF_PIXEL)
            views.append(make_view(name, photo, lens, pose, str(source), find_mask(photo, path)))
            poses.append(pose)
        warn_of_mask_names(matches_of(views), path)
        capture = Capture(path=path, views=tuple(views), world_from_source=np.eye(4), reader="blended_mvs")
        return capture.transformed(upright_rotation(poses))


def _camera(source: Path) -> tuple[Array, Array]:
    refuse_special_file(source)
    tokens = source.read_text(encoding="utf-8", errors="replace")[:10000].split()
    try:
        first, second = tokens.index("extrinsic") + 1, tokens.index("intrinsic") + 1
        extrinsic = np.array(tokens[first : first + 16], dtype=np.float64).reshape(4, 4)
        intrinsic = np.array(tokens[second : second + 9], dtype=np.float64).reshape(3, 3)
    except ValueError:
        raise CaptureError(f"{source} needs 'extrinsic' with 16 numbers and 'intrinsic' with 9 numbers") from None
    return rigid_transform(extrinsic, str(source)), intrinsic
