"""How well single photographs, projected onto a finished run's mesh, predict an unseen view, before and after shifts.

Each test view is predicted from the nearest photographs, one at a time: by the mesh; with every pixel shifted by the
optical flow against the true picture; and with the component of that shift that another depth of the surface would
explain. The shifts gain more than a better mesh could, because the flow uses the truth and is separate for each
photograph. The remaining error has two parts: colours that change with the angle, and what the flow does not find
(detail finer than its window, blur of interpolation).

    python -m benchmarks.shifted_photographs CAPTURE RUN [VIEWS]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.scene_format import load_scene
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from skimage.registration import optical_flow_ilk

from benchmarks.observed_points import MIN_COVERAGE, RAY_OFFSET, observe, surface_under_pixels
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager

Array = NDArray[np.floating]

NEAREST = 6
MIN_KNOWN_SHARE = 0.9
"""Least share of a pixel's interpolation neighbourhood that the photograph must observe."""
FLOW_RADIUS_PX = 6
"""Pixels to each side within which the flow is constant."""
ALL_VIEWS = 10_000
VARIANTS = ("by the mesh", "shifted", "shifted in depth")


def main() -> None:
    capture, run = map(Path, sys.argv[1:3])
    plugins = PluginManager.discover()
    train, test = (read_capture(capture, split, plugins) for split in ("train", "test"))
    mesh = load_scene(run / "scene").mesh
    rays, size = MeshQueries(mesh.positions, mesh.faces), float(np.ptp(mesh.positions, axis=0).max())
    photographs = [view.pixels() for view in train.views]
    centers = np.stack([camera.center for camera in train.cameras])
    errors: list[Array] = []
    max_views = int(sys.argv[3]) if len(sys.argv) > 3 else ALL_VIEWS
    for view, camera in list(zip(test.views, test.cameras, strict=True))[:max_views]:
        pixels = view.pixels()
        assert pixels.mask is not None
        true = linear_to_srgb(np.clip(pixels.color_linear, 0, 1)) * pixels.mask[..., None]
        rows, columns = np.nonzero(pixels.mask >= MIN_COVERAGE)
        hit, _, points, _, flat = surface_under_pixels(camera, rows, columns, mesh, rays)
        rows, columns, above = rows[hit], columns[hit], points + RAY_OFFSET * size * flat
        angles = _angles(centers - points.mean(axis=0), camera.center - points.mean(axis=0))
        blends, total = np.zeros((len(VARIANTS), *true.shape)), np.zeros(true.shape[:2])
        for number in np.argsort(angles)[:NEAREST]:
            source = photographs[number]
            color, direction, observed = observe(
                points, above, flat, train.cameras[number], source.color_linear, source.mask, rays
            )
            shown, known = true.copy(), np.zeros(true.shape[:2], bool)
            shown[rows[observed], columns[observed]] = linear_to_srgb(np.clip(color[observed], 0, 1))
            known[rows[observed], columns[observed]] = True
            flow = np.stack(
                optical_flow_ilk(true.mean(2), shown.mean(2), radius=FLOW_RADIUS_PX, gaussian=True), axis=-1
            )
            nearer = camera.project(points + RAY_OFFSET * size * direction)[0] - camera.project(points)[0]
            in_depth = np.zeros_like(flow)
            in_depth[rows, columns] = nearer[:, ::-1] / np.maximum(np.linalg.norm(nearer, axis=1), 1e-9)[:, None]
            in_depth *= (flow * in_depth).sum(axis=-1, keepdims=True)
            moves = (np.zeros_like(flow), flow, in_depth)
            pictures = np.stack([_resampled(shown, by) for by in moves])
            # where nothing is observed `shown` is the true picture
            known &= np.stack([_resampled(known[..., None] * 1.0, by)[..., 0] > MIN_KNOWN_SHARE for by in moves]).all(
                axis=0
            )
            line = ", ".join(
                f"{variant} {_decibels((p - true)[known]):.2f}" for variant, p in zip(VARIANTS, pictures, strict=True)
            )
            print(f"{view.name}, a photograph {np.degrees(angles[number]):.0f}° away: {line} dB", flush=True)
            weight = known / angles[number] ** 2
            blends, total = blends + pictures * weight[..., None], total + weight
        known = total > 0
        errors.append(np.stack([b[known] / total[known][:, None] - true[known] for b in blends]))
    whole = np.concatenate(errors, axis=1)
    print(
        "blended:", ", ".join(f"{variant} {_decibels(e):.2f}" for variant, e in zip(VARIANTS, whole, strict=True)), "dB"
    )


def _angles(vectors: Array, other: Array) -> Array:
    """Radians between vectors (N, 3) and another (3,)."""
    cosine = vectors @ other / (np.linalg.norm(vectors, axis=1) * np.linalg.norm(other))
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


def _resampled(picture: Array, by: Array) -> Array:
    """Every pixel (H, W, C) read `by` (rows, columns) pixels away."""
    coordinates = np.moveaxis(np.indices(by.shape[:2]).transpose(1, 2, 0) + by, -1, 0)
    read = [map_coordinates(channel, coordinates, order=3, mode="nearest") for channel in np.moveaxis(picture, -1, 0)]
    return np.clip(np.stack(read, axis=-1), 0, 1)


def _decibels(difference: Array) -> float:
    return float(-10 * np.log10(np.square(difference).mean()))


if __name__ == "__main__":
    main()
