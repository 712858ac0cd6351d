"""Cameras from numpy files, without pickles, and from projection matrices."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
from hir_exporters.files.regular_files import refuse_special_file

from hir_core.capture import Array
from hir_core.errors import CaptureError

_MAX_BYTES = 256 << 20


def load_arrays(path: Path) -> dict[str, Array]:
    """The numeric arrays of a .npz by name, or of a .npy as "array"; pickled objects raise `CaptureError`."""
    refuse_special_file(path)
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise CaptureError(f"{path} is larger than {_MAX_BYTES >> 20} MB; it is not a camera file")
        if path.suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                # a small zip file can decompress to gigabytes
                if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
                    raise CaptureError(
                        f"{path} decompresses to more than {_MAX_BYTES >> 20} MB; it is not a camera file"
                    )
            with np.load(path, allow_pickle=False) as arrays:
                stored = {name: np.asarray(arrays[name]) for name in arrays.files}
        else:
            stored = {"array": np.load(path, allow_pickle=False)}
    except CaptureError:
        raise
    except Exception as error:  # numpy parses headers as Python: damaged ones raise any of its tokenizer's errors
        raise CaptureError(
            f"{path} cannot be read as arrays ({' '.join(str(error).split())}); export the cameras again"
        ) from None
    numbers: dict[str, Array] = {name: a.astype(np.float64) for name, a in stored.items() if a.dtype.kind in "fiu"}
    for name, array in numbers.items():
        if not np.isfinite(array).all():
            raise CaptureError(f"{path}: {name!r} contains NaN or infinite values; export the cameras again")
    return numbers


def decompose_projection(projection: Array, owner: str) -> tuple[Array, Array]:
    """Intrinsics 3×3 and world_to_camera 4×4 of a projection matrix P = K [R | t] (3×4, any scale and sign).

    RQ decomposition (Hartley & Zisserman, section 6.2.4). A singular matrix raises `CaptureError`.
    """
    if projection.shape != (3, 4):
        raise CaptureError(f"{owner}: the projection matrix has the shape {projection.shape}; write a 3×4 matrix")
    left = projection[:, :3]
    largest = float(np.abs(left).max())
    # written so that a matrix of zeros, and one whose determinant overflows, is refused too
    if not (0 < largest < 1e50 and abs(np.linalg.det(left / largest)) > 1e-12):
        raise CaptureError(f"{owner}: the projection matrix is singular, so it is no camera; export the cameras again")
    if np.linalg.det(left) < 0:
        projection = -projection
        left = projection[:, :3]
    flip = np.eye(3)[::-1]
    q, r = np.linalg.qr((flip @ left).T)
    upper, rotation = flip @ r.T @ flip, flip @ q.T
    signs = np.diag(np.where(np.diag(upper) < 0, -1.0, 1.0))
    upper, rotation = upper @ signs, signs @ rotation
    pose = np.eye(4)
    pose[:3, :3] = rotation
    pose[:3, 3] = np.linalg.solve(upper, projection[:3, 3])
    return upper / upper[2, 2], pose
