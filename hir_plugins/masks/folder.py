"""Mask source: a folder of image files."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture, View
from hir_core.capture.lens import camera_lens, resample
from hir_core.errors import CaptureError
from hir_core.plugins.interfaces import MaskSource
from hir_plugins.masks.options import FolderOptions
from hir_plugins.readers.parsing.capture_paths import contained_path, is_photo_name
from hir_plugins.readers.parsing.decoding.photo_file import read_mask
from hir_plugins.readers.parsing.mask_files import find_mask, match_mask

if TYPE_CHECKING:
    from hir_core.scene import Scene


@final
class Folder(MaskSource):
    """Matches the files of a folder with the photographs by name; antialiased edges are preserved."""

    def __init__(self, config: FolderOptions) -> None:
        self._config = config
        self._listed: dict[Path, list[Path]] = {}

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        """One mask for each view; None without a file. A named folder that matches no view raises `CaptureError`."""
        del scene
        matched = [self._file(view, capture.path) for view in capture.views]
        if self._config.path and capture.views and not any(matched):
            raise CaptureError(
                f"{capture.path / self._config.path} has no mask with the name of a photograph; name masks like "
                f"{capture.views[0].name}.png"
            )
        missing = [v.name for v, f in zip(capture.views, matched, strict=True) if f is None]
        if missing and len(missing) < len(matched):
            counts = f"{len(missing)} of {len(matched)} photographs"
            warnings.warn(f"{counts} have no mask, such as {missing[0]}", stacklevel=2)
        return [None if f is None else self._mask(v, f) for v, f in zip(capture.views, matched, strict=True)]

    def files(self, capture: Capture) -> list[Path]:
        """The mask files, except those that the reader reports as its own."""
        matched = [(view, self._file(view, capture.path)) for view in capture.views]
        return [file for view, file in matched if file is not None and file != view.mask_path]

    def _file(self, view: View, capture: Path) -> Path | None:
        if view.path is None:
            return None
        if not self._config.path:
            return find_mask(view.path, capture)
        folder = contained_path(capture, self._config.path, Path("mask_source.folder.path"))
        if not folder.is_dir():
            raise CaptureError(f"mask_source.folder.path: {folder} is not a folder; name the folder of the masks")
        if folder not in self._listed:
            self._listed[folder] = sorted(f for f in folder.rglob("*") if is_photo_name(f.name))
        mask = match_mask(view.path, self._listed[folder])
        return None if mask is None else contained_path(capture, mask.relative_to(capture).as_posix(), folder)

    def _mask(self, view: View, path: Path) -> NDArray[np.float32]:
        height, width = view.read().color_linear.shape[:2]
        mask = read_mask(path, width, height)
        if view.camera is not None and any(view.distortion):
            mask = resample(mask, camera_lens(view.camera, view.distortion))
        return 1 - mask if self._config.inverted else mask
