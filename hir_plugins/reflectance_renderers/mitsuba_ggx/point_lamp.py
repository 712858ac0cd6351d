"""The lamp near the camera as points of light on a disc, for each lane those of its view."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi

from hir_core.scene import CameraLamp
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


@dataclass
class PointLamp:
    """A disc of light in the unit sphere, of which each path sees one point; constant, not differentiated."""

    position: DrJitArray
    """Point3f: the middle."""
    axis: DrJitArray
    """Viewing axis of its camera, about which it shines."""
    right: DrJitArray
    """Vector3f along the camera's x axis, as long as the radius; 0 for a point."""
    down: DrJitArray
    """The same along its y axis."""
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
        reach = dr.opaque(mi.Float, float(lamp.radius) / radius)
        intensity = [dr.opaque(mi.Float, float(value) / radius**2) for value in lamp.intensity.tolist()]
        to_world = camera.T
        return cls(
            center + to_world @ mi.Vector3f(x, y, z),
            to_world @ mi.Vector3f(0, 0, 1),
            to_world @ mi.Vector3f(reach, 0, 0),
            to_world @ mi.Vector3f(0, reach, 0),
            mi.Color3f(*intensity),
            dr.opaque(mi.Float, float(lamp.exponent)),
        )

    def gathered(self, lanes: DrJitArray) -> PointLamp:
        """The lamp of some of the lanes."""
        position = dr.gather(mi.Point3f, mi.Point3f(self.position), lanes)
        axis, right, down = (
            dr.gather(mi.Vector3f, mi.Vector3f(each), lanes) for each in (self.axis, self.right, self.down)
        )
        return PointLamp(position, axis, right, down, self.intensity, self.exponent)

    def toward(self, position: DrJitArray, sample: DrJitArray) -> tuple[DrJitArray, DrJitArray, DrJitArray]:
        """Unit direction to a point of the lamp, distance, and irradiance (Color3f) on a surface there that faces it.

        `sample` (Point2f, uniform in the unit square) chooses the point.
        """
        sine, cosine = dr.sincos(sample.y * (2 * dr.pi))
        reach = dr.sqrt(sample.x)
        offset = mi.Vector3f(self.position - position) + reach * (cosine * self.right + sine * self.down)
        square = dr.maximum(dr.squared_norm(offset), 1e-12)
        distance = dr.sqrt(square)
        direction = offset / distance
        facing = dr.maximum(-dr.dot(direction, self.axis), 1e-3)
        emission: DrJitArray = dr.power(facing, self.exponent)
        return direction, distance, self.intensity * (emission / square)
