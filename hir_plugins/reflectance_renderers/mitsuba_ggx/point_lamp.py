"""The lamp near the camera as a point emitter, for each lane the one of its view."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from hir_core.scene import CameraLamp
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


@dataclass
class PointLamp:
    """A point of light in the unit sphere; constant, not differentiated."""

    position: DrJitArray
    """Point3f."""
    axis: DrJitArray
    """Viewing axis of its camera, about which it shines."""
    intensity: DrJitArray
    """Color3f."""
    exponent: DrJitArray

    @classmethod
    def of(cls, lamp: CameraLamp, camera: DrJitArray, center: DrJitArray, radius: float) -> PointLamp:
        """The lamp of each lane's camera: its rotation from the world (Matrix3f), its centre in the unit sphere of an
        object of `radius`.
        """
        # opaque: literals would compile another kernel for each lamp
        x, y, z = (dr.opaque(mi.Float, float(value) / radius) for value in lamp.offset.tolist())
        intensity = [dr.opaque(mi.Float, float(value) / radius**2) for value in lamp.intensity.tolist()]
        to_world = camera.T
        return cls(
            center + to_world @ mi.Vector3f(x, y, z),
            to_world @ mi.Vector3f(0, 0, 1),
            mi.Color3f(*intensity),
            dr.opaque(mi.Float, float(lamp.exponent)),
        )

    def gathered(self, lanes: DrJitArray) -> PointLamp:
        """The lamp of some of the lanes."""
        position = dr.gather(mi.Point3f, mi.Point3f(self.position), lanes)
        return PointLamp(position, dr.gather(mi.Vector3f, mi.Vector3f(self.axis), lanes), self.intensity, self.exponent)

    def toward(self, position: DrJitArray) -> tuple[DrJitArray, DrJitArray, DrJitArray]:
        """Unit direction to the lamp, distance, and irradiance (Color3f) on a surface there that faces it."""
        offset = mi.Vector3f(self.position - position)
        square = dr.maximum(dr.squared_norm(offset), 1e-12)
        distance = dr.sqrt(square)
        direction = offset / distance
        cosine = dr.maximum(-dr.dot(direction, self.axis), 1e-3)
        emission: DrJitArray = dr.power(cosine, self.exponent)
        return direction, distance, self.intensity * (emission / square)
