"""Numbers of cameras from numpy files and projection matrices, without pickles."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np

from hir_core.capture import Array
from hir_core.errors import CaptureError

_MAX_BYTES = 256 << 20


def load_arrays(path: Path) -> dict[str, Array]:
    """The float arrays of a .npy (as "array") or .npz; pickled objects are refused."""
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise CaptureError(f"{path} is larger than {_MAX_BYTES >> 20} MB; it is not a file of cameras")
        if path.suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                # a few bytes of zip can unfold to gigabytes
                if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
                    raise CaptureError(f"{path} unfolds to more than {_MAX_BYTES >> 20} MB")
            with np.load(path, allow_pickle=False) as arrays:
                found = {name: np.asarray(arrays[name]) for name in arrays.files}
        else:
            found = {"array": np.load(path, allow_pickle=False)}
    except CaptureError:
        raise
    except Exception as error:  # numpy parses headers as Python text: broken ones raise whatever its tokenizer does
        raise CaptureError(f"{path} cannot be read as numbers of cameras ({' '.join(str(error).split())})") from None
    numbers: dict[str, Array] = {name: a.astype(np.float64) for name, a in found.items() if a.dtype.kind in "fiu"}
    for name, array in numbers.items():
        if not np.isfinite(array).all():
            raise CaptureError(f"{path}: {name!r} holds NaN or infinite values")
    return numbers


def decompose_projection(projection: Array, owner: str) -> tuple[Array, Array]:
    """Intrinsics 3×3 and world_to_camera 4×4 of a projection matrix P = K [R | t] (3×4, any scale and sign).

    Hartley & Zisserman, section 6.2.4: RQ decomposition. A matrix without inverse raises `CaptureError`.
    """
    if projection.shape != (3, 4):
        raise CaptureError(f"{owner}: its projection matrix has the shape {projection.shape}; 3×4 is needed")
    left = projection[:, :3]
    if abs(np.linalg.det(left)) < 1e-12 * np.abs(left).max() ** 3:
        raise CaptureError(f"{owner}: its projection matrix is that of no camera")
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
