"""Mitsuba's `direct_projective` on a white emitter: the projective sampling of Zhang et al. 2023."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Camera

SAMPLES: Final = 4


def projective_gradients(
    positions: NDArray[np.float64], faces: NDArray[np.int64], cameras: list[Camera]
) -> Callable[[], tuple[list[NDArray[np.float64]], list[float]]]:
    """A function that returns the gradient of the silhouette's area (V, 3) and the area in pixels, for each camera."""
    import drjit as dr
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    mi.set_log_level(mi.LogLevel.Error)

    def run() -> tuple[list[NDArray[np.float64]], list[float]]:
        gradients, areas = [], []
        for camera in cameras:
            shape = mi.Mesh("m", len(positions), len(faces), props=_white_emitter(mi))
            parameters = mi.traverse(shape)
            parameters["vertex_positions"] = positions.astype(np.float32).ravel()
            parameters["faces"] = faces.astype(np.uint32).ravel()
            parameters.update()
            scene = mi.load_dict({"type": "scene", "mesh": shape, "sensor": sensor(mi, camera)})
            integrator = mi.load_dict({"type": "direct_projective", "sppi": 0, "sppp": SAMPLES, "sppc": SAMPLES})
            parameters = mi.traverse(scene)
            key = next(k for k, _ in parameters if k.endswith("vertex_positions"))
            dr.enable_grad(parameters[key])
            parameters.update()
            image = mi.render(scene, parameters, integrator=integrator, spp=SAMPLES, seed=cast(Any, 1))
            total = dr.sum(image.array) / 3
            dr.backward(total)
            gradients.append(np.array(dr.grad(parameters[key]), dtype=np.float64).reshape(-1, 3))
            areas.append(float(np.array(dr.detach(total)).ravel()[0]))
        return gradients, areas

    return run


def sensor(mi: Any, camera: Camera, filter_: str = "box") -> dict[str, Any]:
    """Mitsuba's description of a camera with square pixels and the principal point at the image centre."""
    # Mitsuba's cameras look along +z with x to the left and y up
    to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([-1.0, -1.0, 1.0, 1.0])
    fov = float(np.rad2deg(2 * np.arctan(0.5 * camera.width / camera.intrinsics[0, 0])))
    film = {"type": "hdrfilm", "width": camera.width, "height": camera.height, "rfilter": {"type": filter_}}
    return {
        "type": "perspective",
        "fov": fov,
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(to_world),
        "film": film | {"pixel_format": "rgba"} if filter_ != "box" else film,
    }


def _white_emitter(mi: Any) -> Any:
    properties = mi.Properties()
    properties["emitter"] = mi.load_dict({"type": "area", "radiance": {"type": "rgb", "value": 1.0}})
    return properties
