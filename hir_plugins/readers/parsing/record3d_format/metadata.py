"""`metadata` of a recording (JSON): the pose of each frame, the intrinsics, the sizes.

`w` and `h` are those of the photographs, `dw` and `dh` of the depth maps. `K` is 3×3 by columns,
`perFrameIntrinsicCoeffs` has fx, fy, cx, cy of each frame. `poses` has a quaternion x y z w and a position of each
frame: camera to world, x right, y up, z back; the world is ARKit's, +Y up, in metres (nerfstudio's
`process_data/record3d_utils.py`, and the README of github.com/marek-simonik/record3d).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hir_core.capture import Array
from hir_core.capture.rotations import rotation_from_quaternion
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import OPENCV_FROM_OPENGL, rigid_inverse
from hir_plugins.readers.parsing.json_fields import number_field
from hir_plugins.readers.parsing.lens_camera import LensCamera

MAX_DEPTH_PIXELS = 640 * 480
"""Of a depth map: those of the front camera have as many, those of LiDAR 256 × 192."""


@dataclass(frozen=True)
class RecordingMetadata:
    """What the file says, checked."""

    owner: str
    """The file, for messages."""
    width: int
    height: int
    intrinsics: Array
    """(N, 4): fx, fy, cx, cy of each frame."""
    poses: Array
    """(N, 7): quaternion x y z w, position."""
    depth_size: tuple[int, int] | None
    """Width and height of depth maps, where the file says them."""

    def lens(self, frame: int) -> LensCamera:
        """The intrinsics of a frame, for photographs of `width` × `height`."""
        fx, fy, cx, cy = (float(value) for value in self.intrinsics[frame])
        return LensCamera(fx, fy, cx, cy, self.width, self.height)

    def world_to_camera(self, frame: int) -> Array:
        """4×4, OpenCV axes."""
        x, y, z, w = self.poses[frame, :4]
        pose = np.eye(4)
        pose[:3, :3] = rotation_from_quaternion(np.array([w, x, y, z]))
        pose[:3, 3] = self.poses[frame, 4:]
        return np.asarray(OPENCV_FROM_OPENGL @ rigid_inverse(pose))


def parse_metadata(document: Mapping[str, object], owner: str) -> RecordingMetadata:
    """The metadata of a recording; what is missing or impossible raises `CaptureError`."""
    width, height = _size(document, ("w", "h"), owner) or (0, 0)
    if not width:
        raise CaptureError(f"{owner} has no 'w' and 'h'; export the recording again as .r3d")
    poses = _numbers(document, "poses", (-1, 7), owner)
    if not (np.linalg.norm(poses[:, :4], axis=1) > 0).all():
        raise CaptureError(f"{owner} holds a camera without direction; export the recording again")
    if document.get("perFrameIntrinsicCoeffs"):
        intrinsics = _numbers(document, "perFrameIntrinsicCoeffs", (-1, 4), owner)
        if len(intrinsics) != len(poses):
            raise CaptureError(
                f"{owner} has {len(intrinsics)} intrinsics and {len(poses)} poses; export the recording again"
            )
    else:
        k = _numbers(document, "K", (3, 3), owner).T
        intrinsics = np.broadcast_to([k[0, 0], k[1, 1], k[0, 2], k[1, 2]], (len(poses), 4))
    depth_size = _size(document, ("dw", "dh"), owner)
    if depth_size is not None and depth_size[0] * depth_size[1] > MAX_DEPTH_PIXELS:
        raise CaptureError(f"{owner}: depth maps of {depth_size[0]}×{depth_size[1]} are none of Record3D")
    return RecordingMetadata(owner, width, height, intrinsics, poses, depth_size)


def _size(document: Mapping[str, object], keys: tuple[str, str], owner: str) -> tuple[int, int] | None:
    sides = [number_field(document, key, owner) for key in keys]
    if None in sides:
        return None
    width, height = (int(side or 0) for side in sides)
    if not (1 <= width <= 65535 and 1 <= height <= 65535):
        raise CaptureError(f"{owner}: {keys[0]!r} and {keys[1]!r} are {width}×{height}, which is no size of an image")
    return width, height


def _numbers(document: Mapping[str, object], key: str, shape: tuple[int, int], owner: str) -> Array:
    try:
        numbers = np.asarray(document[key], dtype=np.float64).reshape(shape)
    except (KeyError, TypeError, ValueError, OverflowError):
        raise CaptureError(f"{owner} has no list of numbers {key!r}; export the recording again as .r3d") from None
    if not np.isfinite(numbers).all():
        raise CaptureError(f"{owner}: {key!r} holds NaN or infinite values; export the recording again")
    return numbers
