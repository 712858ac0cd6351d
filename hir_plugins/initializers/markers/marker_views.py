"""Photographs of a sheet of markers, or of a chart of colours, by formula, for tests."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, View
from hir_core.testing.captures import StoredPixels

SUPERSAMPLES = 4
PIXELS_PER_SIDE = 96
"""Resolution of the printed markers."""
PAPER, INK, TABLE = 0.8, 0.01, 0.1
"""Linear values of white paper, black ink and what surrounds the sheet."""


class Sheet(Protocol):
    """What is printed: a `MarkerSheet`, a `GreyCard` or a `ColorCheckerSheet`."""

    @property
    def side(self) -> float:
        """Of a marker's black square, or of a patch, in metres."""
        ...

    @property
    def size(self) -> tuple[float, float]:
        """Width and height in metres."""
        ...

    def picture(self, pixels_per_metre: float) -> NDArray[np.uint8] | Array:
        """The sheet: (H, W) of 8 bits, where 255 is paper, or (H, W, 3) of linear reflectances."""
        ...


def marker_capture(
    folder: Path, cameras: Sequence[Camera], sheet: Sheet, height: float = 0.0, turn: Array | None = None
) -> Capture:
    """Photographs of a sheet of markers on a table, without an object.

    The sheet's middle is (0, `height`, 0), its plane horizontal; `turn` (3×3) rotates it about its middle.
    """
    printed = sheet.picture(PIXELS_PER_SIDE / sheet.side)
    placed = _world_from_sheet(sheet, height, np.eye(3) if turn is None else turn)
    views = [_photograph(f"{i:02}", camera, printed, sheet, placed) for i, camera in enumerate(cameras)]
    return Capture(folder, tuple(views))


def _world_from_sheet(sheet: Sheet, height: float, turn: Array) -> Array:
    """3×3: (x, y, 1) in metres from the sheet's upper left corner, to the world."""
    width, depth = sheet.size
    axes = np.array([[1.0, 0.0, -width / 2], [0.0, 0.0, 0.0], [0.0, 1.0, -depth / 2]])
    placed: Array = turn @ axes
    placed[1, 2] += height
    return placed


def _photograph(
    name: str, camera: Camera, printed: NDArray[np.uint8] | Array, sheet: Sheet, world_from_sheet: Array
) -> View:
    shown: Array = np.full((camera.height, camera.width), TABLE)
    normal = np.cross(world_from_sheet[:, 1], world_from_sheet[:, 0])
    if normal @ (camera.center - world_from_sheet[:, 2]) > 0:  # the camera sees the printed side
        shown = _warped(printed, sheet, camera, world_from_sheet)
    color = (np.repeat(shown[..., None], 3, axis=2) if shown.ndim == 2 else shown).astype(np.float32)
    return View(name, camera, StoredPixels(color, None))


def _warped(printed: NDArray[np.uint8] | Array, sheet: Sheet, camera: Camera, world_from_sheet: Array) -> Array:
    """The sheet as the camera sees it (H, W) or (H, W, 3), linear."""
    width, height = SUPERSAMPLES * camera.width, SUPERSAMPLES * camera.height
    pose = camera.world_to_camera
    camera_from_sheet = pose[:3, :3] @ world_from_sheet
    camera_from_sheet[:, 2] += pose[:3, 3]
    metres = np.diag([sheet.side / PIXELS_PER_SIDE, sheet.side / PIXELS_PER_SIDE, 1.0])
    centres = np.array([[1, 0, 0.5], [0, 1, 0.5], [0, 0, 1.0]])  # indices of pixels to positions of their centres
    finer = np.diag([SUPERSAMPLES, SUPERSAMPLES, 1.0])
    homography = np.linalg.inv(centres) @ finer @ camera.intrinsics @ camera_from_sheet @ metres @ centres
    picture = INK + (PAPER - INK) * printed / 255.0 if printed.ndim == 2 else np.asarray(printed, np.float64)
    table = (TABLE,) * 3
    fine = cv2.warpPerspective(picture, homography, (width, height), borderMode=cv2.BORDER_CONSTANT, borderValue=table)
    return np.asarray(cv2.resize(fine, (camera.width, camera.height), interpolation=cv2.INTER_AREA), dtype=np.float64)
