"""Seconds against error of the silhouette renderers: `python -m benchmarks.geometry [--quick]`, a Markdown table.

One bumpy sphere at growing resolution, seen by two cameras. Errors are those of directional derivatives of the
silhouette's
area along smooth random directions fixed beforehand, against central differences (step 1e-5 of the object) of the exact
float64 area of the union of its projected triangles (shapely). Times are CPU milliseconds a view for value and
gradient, the best of several, kernels compiled beforehand.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions, SoftSilhouetteOptions
from hir_plugins.geometry_renderers.soft_silhouette import SoftSilhouette
from tests.geometry import polygons
from tests.geometry.shapes import bumpy_sphere, camera, mesh_of, smooth_directions, targets_of

EYES = ((3.0, 1.0, 0.5), (-1.0, 0.4, 3.2))
Gradients = Callable[[list[Camera]], list[NDArray[np.float64]]]


@dataclass(frozen=True)
class Reference:
    """Exact derivatives of the area in pixels of a 512-pixel-wide image, per camera and direction."""

    directions: list[NDArray[np.float64]]
    slopes: NDArray[np.float64]


def exact(positions: NDArray[np.float64], faces: NDArray[np.int64], step: float = 1e-5) -> Reference:
    """Central differences of shapely areas."""
    directions = smooth_directions(positions, 2)
    slopes = [
        [
            (polygons.area(positions + step * d, faces, view) - polygons.area(positions - step * d, faces, view))
            / (2 * step)
            for d in directions
        ]
        for view in (camera(512, eye) for eye in EYES)
    ]
    return Reference(directions, np.array(slopes))


def relative_error(gradients: list[NDArray[np.float64]], reference: Reference, size: int) -> float:
    """Root mean square over cameras and directions, relative to that of the exact derivatives."""
    scale = (512 / size) ** 2
    found = np.array([[(g * d).sum() * scale for d in reference.directions] for g in gradients])
    return float(np.sqrt(np.mean((found - reference.slopes) ** 2) / np.mean(reference.slopes**2)))


def best_of(work: Callable[[], object], repeats: int) -> float:
    """CPU seconds of the fastest run: other programs on the machine count less than by the wall clock."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def by_overlap(
    renderer: Contour | SoftSilhouette, positions: NDArray[np.float64], faces: NDArray[np.int64]
) -> Gradients:
    """Gradients of `overlap`'s area, all views in one batch."""
    mesh = mesh_of(positions, faces, grad=True)

    def run(views: list[Camera]) -> list[NDArray[np.float64]]:
        targets = targets_of(views)
        area, _ = renderer.overlap(mesh, targets)
        return [torch.autograd.grad(a, mesh.positions, retain_graph=True)[0].double().numpy() for a in area.unbind()]

    return run


def in_one_pass(
    renderer: Contour | SoftSilhouette, positions: NDArray[np.float64], faces: NDArray[np.int64], views: list[Camera]
) -> Callable[[], object]:
    """Value and gradient of the sum over a batch, as a step of the fit does it."""
    mesh = mesh_of(positions, faces, grad=True)
    targets = targets_of(views)

    def run() -> None:
        area, shared = renderer.overlap(mesh, targets)
        (area + shared).sum().backward()

    return run


def by_mitsuba(positions: NDArray[np.float64], faces: NDArray[np.int64], samples: int = 4) -> Gradients:
    """Mitsuba's `direct_projective` on a white emitter: the projective sampling of Zhang et al. 2023."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)

    def run(views: list[Camera]) -> list[NDArray[np.float64]]:
        gradients = []
        for view in views:
            shape = mi.Mesh("m", len(positions), len(faces), props=_white_emitter(mi))
            parameters = mi.traverse(shape)
            parameters["vertex_positions"] = positions.astype(np.float32).ravel()
            parameters["faces"] = faces.astype(np.uint32).ravel()
            parameters.update()
            scene = mi.load_dict({"type": "scene", "mesh": shape, "sensor": _sensor(mi, view)})
            integrator = mi.load_dict({"type": "direct_projective", "sppi": 0, "sppp": samples, "sppc": samples})
            parameters = mi.traverse(scene)
            key = next(k for k, _ in parameters if k.endswith("vertex_positions"))
            dr.enable_grad(parameters[key])
            parameters.update()
            image = mi.render(scene, parameters, integrator=integrator, spp=samples, seed=1)
            dr.backward(dr.sum(image.array) / 3)
            gradients.append(np.array(dr.grad(parameters[key]), dtype=np.float64).reshape(-1, 3))
        return gradients

    return run


def _white_emitter(mi: object):  # type: ignore[no-untyped-def]
    properties = mi.Properties()  # type: ignore[attr-defined]
    properties["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": 1.0}})  # type: ignore[attr-defined]
    return properties


def _sensor(mi: object, view: Camera) -> dict[str, object]:
    # Mitsuba's cameras look along +z with x to the left and y up
    to_world = np.linalg.inv(view.world_to_camera) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    fov = float(np.rad2deg(2 * np.arctan(0.5 * view.width / view.intrinsics[0, 0])))
    film = {"type": "hdrfilm", "width": view.width, "height": view.height, "rfilter": {"type": "box"}}
    return {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(to_world),  # type: ignore[attr-defined]
        "film": film,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="5k and 20k triangles at 256 only")
    parser.add_argument("--peers", action="store_true", help="Mitsuba's projective integrator too")
    parser.add_argument("--soft-triangles", type=int, default=25_000, help="soft_silhouette up to this many")
    options = parser.parse_args()
    print("| triangles | image | renderer | CPU ms a view | gradient error | peak memory, MiB |")
    print("|---|---|---|---|---|---|", flush=True)
    for level in (4, 5) if options.quick else (4, 5, 6, 7):
        positions, faces = bumpy_sphere(level)
        reference = exact(positions, faces)
        for size in (256,) if options.quick else (256, 512, 1024):
            views = [camera(size, eye) for eye in EYES]
            rows: list[tuple[str, Gradients, Callable[[], object] | None]] = []
            contour, soft = Contour(ContourOptions()), SoftSilhouette(SoftSilhouetteOptions())
            rows.append(
                ("contour", by_overlap(contour, positions, faces), in_one_pass(contour, positions, faces, views * 4))
            )
            if len(faces) <= options.soft_triangles:
                rows.append(
                    ("soft_silhouette", by_overlap(soft, positions, faces), in_one_pass(soft, positions, faces, views))
                )
            if options.peers:
                rows.append(("Mitsuba direct_projective, 4 samples", by_mitsuba(positions, faces), None))
            for name, gradients, timed in rows:
                error = relative_error(gradients(views), reference, size)
                if timed is None:
                    seconds = best_of(lambda g=gradients, v=views: g(v), 2) / len(views)
                else:
                    seconds = best_of(timed, 5 if name == "contour" else 2) / (8 if name == "contour" else 2)
                memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
                print(f"| {len(faces)} | {size} | {name} | {1000 * seconds:.1f} | {error:.4f} | {memory} |", flush=True)


if __name__ == "__main__":
    main()
