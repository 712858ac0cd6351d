"""Whether the light moves with the camera."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hir_core.capture import Array, Camera, Pixels

_MIN_HEADLIGHT_CORRELATION = 0.4


def headlight_score(
    pixels: Sequence[Pixels], cameras: Sequence[Camera], positions: Array, normals: Array
) -> float | None:
    """0 for a static light, 1 for a light at the camera; None if fewer than 200 points are visible in three views.

    The radiance of a diffuse point is the same in all views under a static light. Under a light at the camera it is
    proportional to the cosine between normal and view direction. The score is the slope of the regression of
    log radiance on log cosine, after each point's mean is subtracted, if they correlate.
    """
    step = max(1, len(positions) // 4000)
    points, facing = positions[::step], normals[::step]
    logs = np.full((len(cameras), len(points)), np.nan)
    cosines = np.full_like(logs, np.nan)
    for row, (picture, camera) in enumerate(zip(pixels, cameras, strict=True)):
        at, depth = camera.project(points)
        toward = camera.center - points
        cosine = (facing * toward).sum(axis=1) / np.maximum(np.linalg.norm(toward, axis=1), 1e-300)
        x, y = np.floor(np.clip(at, -1, 1e6)).astype(int).T
        seen = (depth > 0) & (cosine > 0.25) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        if picture.mask is not None:
            seen[seen] = picture.mask[y[seen], x[seen]] > 0.99
        seen[seen] = ~picture.saturated[y[seen], x[seen]]
        value = picture.color_linear[y[seen], x[seen]].mean(axis=1)
        index = np.nonzero(seen)[0][value > 1e-3]
        logs[row, index] = np.log(value[value > 1e-3])
        cosines[row, index] = np.log(cosine[index])
    often = np.isfinite(logs).sum(axis=0) >= 3
    if often.sum() < 200:
        return None
    a, b = logs[:, often], cosines[:, often]
    a, b = a - np.nanmean(a, axis=0), b - np.nanmean(b, axis=0)
    known = np.isfinite(a)
    x, y = b[known], a[known]
    variance = float((x * x).sum())
    if variance < 1e-6 or float((y * y).sum()) < 1e-9:
        return 0.0
    slope = float((x * y).sum()) / variance
    correlation = float((x * y).sum()) / np.sqrt(variance * float((y * y).sum()))
    return float(np.clip(slope, 0, 1)) if correlation > _MIN_HEADLIGHT_CORRELATION else 0.0
