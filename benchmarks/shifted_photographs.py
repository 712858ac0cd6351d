"""What single photographs show of an unseen view when they are laid on a finished run's mesh, before and after shifts.

Each test view is drawn from the photographs nearest to it, one at a time: as the mesh says, with every pixel moved to
where optical flow against the true picture says, and with the part of that move which another depth of the surface
would make: more than a better mesh could gain, for the flow knows the truth and each photograph has its own. What is
left are colours that change with the angle, and what neither finds: detail finer than the flow's window, the blur of
reading between pixels.

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

from benchmarks.seen_points import INSIDE, OFFSET, on_mesh, photographed
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager

Array = NDArray[np.floating]

NEAREST = 6
KNOWN = 0.9
"""Of a pixel's surroundings; they count where the photograph shows them."""
WINDOW = 6
"""Pixels to each side within which the flow is constant."""
EVERY_VIEW = 10_000
WAYS = ("as the mesh says", "shifted", "shifted in depth")


def main() -> None:
    capture, run = map(Path, sys.argv[1:3])
    plugins = PluginManager.discover()
    train, test = (read_capture(capture, split, plugins) for split in ("train", "test"))
    mesh = load_scene(run / "scene").mesh
    rays, size = MeshQueries(mesh.positions, mesh.faces), float(np.ptp(mesh.positions, axis=0).max())
    photographs = [view.pixels() for view in train.views]
    centers = np.stack([camera.center for camera in train.cameras])
    errors: list[Array] = []
    most = int(sys.argv[3]) if len(sys.argv) > 3 else EVERY_VIEW
    for view, camera in list(zip(test.views, test.cameras, strict=True))[:most]:
        pixels = view.pixels()
        assert pixels.mask is not None
        true = linear_to_srgb(np.clip(pixels.color_linear, 0, 1)) * pixels.mask[..., None]
        rows, columns = np.nonzero(pixels.mask >= INSIDE)
        hit, _, points, _, flat = on_mesh(camera, rows, columns, mesh, rays)
        rows, columns, above = rows[hit], columns[hit], points + OFFSET * size * flat
        angles = _angles(centers - points.mean(axis=0), camera.center - points.mean(axis=0))
        blends, total = np.zeros((len(WAYS), *true.shape)), np.zeros(true.shape[:2])
        for number in np.argsort(angles)[:NEAREST]:
            source = photographs[number]
            color, direction, seen = photographed(
                points, above, flat, train.cameras[number], source.color_linear, source.mask, rays
            )
            shown, known = true.copy(), np.zeros(true.shape[:2], bool)
            shown[rows[seen], columns[seen]] = linear_to_srgb(np.clip(color[seen], 0, 1))
            known[rows[seen], columns[seen]] = True
            flow = np.stack(optical_flow_ilk(true.mean(2), shown.mean(2), radius=WINDOW, gaussian=True), axis=-1)
            nearer = camera.project(points + OFFSET * size * direction)[0] - camera.project(points)[0]
            in_depth = np.zeros_like(flow)
            in_depth[rows, columns] = nearer[:, ::-1] / np.maximum(np.linalg.norm(nearer, axis=1), 1e-9)[:, None]
            in_depth *= (flow * in_depth).sum(axis=-1, keepdims=True)
            moves = (np.zeros_like(flow), flow, in_depth)
            pictures = np.stack([_moved(shown, by) for by in moves])
            # elsewhere `shown` is the true picture
            known &= np.stack([_moved(known[..., None] * 1.0, by)[..., 0] > KNOWN for by in moves]).all(axis=0)
            line = ", ".join(f"{way} {_decibels((p - true)[known]):.2f}" for way, p in zip(WAYS, pictures, strict=True))
            print(f"{view.name}, a photograph {np.degrees(angles[number]):.0f}° aside: {line} dB", flush=True)
            weight = known / angles[number] ** 2
            blends, total = blends + pictures * weight[..., None], total + weight
        known = total > 0
        errors.append(np.stack([b[known] / total[known][:, None] - true[known] for b in blends]))
    whole = np.concatenate(errors, axis=1)
    print("blended:", ", ".join(f"{way} {_decibels(e):.2f}" for way, e in zip(WAYS, whole, strict=True)), "dB")


def _angles(vectors: Array, other: Array) -> Array:
    """Radians between vectors (N, 3) and another (3,)."""
    cosine = vectors @ other / (np.linalg.norm(vectors, axis=1) * np.linalg.norm(other))
    return np.asarray(np.arccos(np.clip(cosine, -1, 1)))


def _moved(picture: Array, by: Array) -> Array:
    """Every pixel (H, W, C) read `by` (rows, columns) pixels away."""
    coordinates = np.moveaxis(np.indices(by.shape[:2]).transpose(1, 2, 0) + by, -1, 0)
    read = [map_coordinates(channel, coordinates, order=3, mode="nearest") for channel in np.moveaxis(picture, -1, 0)]
    return np.clip(np.stack(read, axis=-1), 0, 1)


def _decibels(difference: Array) -> float:
    return float(-10 * np.log10(np.square(difference).mean()))


if __name__ == "__main__":
    main()
