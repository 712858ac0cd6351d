"""Unit vectors to float32 precision, as glTF and USD require of normals and tangents."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def unit_vectors(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Vectors (N, 3) divided by their lengths, computed in float64; none may be zero."""
    exact = vectors.astype(np.float64)
    return (exact / np.linalg.norm(exact, axis=1, keepdims=True)).astype(np.float32)


def unit_tangents(tangents: NDArray[np.float32]) -> NDArray[np.float32]:
    """Tangents (N, 4) with a unit direction; the bitangent's sign, their fourth component, is kept."""
    return np.concatenate([unit_vectors(tangents[:, :3]), tangents[:, 3:]], axis=1)
