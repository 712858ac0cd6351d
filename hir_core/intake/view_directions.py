"""The focus of a capture's cameras, and the share of viewing directions that they cover."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hir_core.capture import Array, Camera


def directions_covered(cameras: Sequence[Camera]) -> float | None:
    """Share of the directions from the cameras' focus that are within 30° of a camera; None for fewer than two."""
    if len(cameras) < 2:
        return None
    focus, _ = camera_focus(cameras)
    toward = np.array([c.center - focus for c in cameras])
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-300)
    i = np.arange(2000) + 0.5
    y, turn = 1 - i / 1000, np.pi * (3 - np.sqrt(5)) * i
    r = np.sqrt(1 - y * y)
    sphere = np.stack([r * np.cos(turn), y, r * np.sin(turn)], axis=1)
    return float(((sphere @ toward.T).max(axis=1) > np.cos(np.radians(30))).mean())


def camera_focus(cameras: Sequence[Camera]) -> tuple[Array, float]:
    """The point (3,) nearest to the cameras' optical axes (least squares), and their median distance from it."""
    o = np.array([c.center for c in cameras])
    d = np.array([c.world_to_camera[2, :3] for c in cameras])
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    focus = np.linalg.lstsq(across.sum(axis=0), np.einsum("vij,vj->i", across, o), rcond=None)[0]
    return focus, float(np.median(np.linalg.norm(o - focus, axis=1)))
