"""The lat-long light as Dr.Jit arrays: bilinear lookup, and importance sampling by its brightness."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import torch
from jaxtyping import Float
from torch import Tensor

from hir_plugins.reflectance_renderers.drjit_arrays import to_float, to_torch
from hir_plugins.reflectance_renderers.drjit_bilinear import bilinear, extended, repeated
from hir_plugins.reflectance_renderers.drjit_latlong import latlong_coordinates
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray

_UNIFORM_SHARE = 0.1
"""Share of uniform samples: the derivative of a black texel needs samples too."""


@dataclass
class Light:
    """A light in its own axes; the caller rotates directions into them."""

    values: DrJitArray
    """Float, 4 for each texel (red, green, blue, 0), to be gathered as packets."""
    height: int
    width: int
    rows: DrJitArray
    """Float (height): cumulative probability of rows."""
    columns: DrJitArray
    """Float (height · width): cumulative probability of the columns of each row."""
    density: DrJitArray
    """Float (height · width): probability of a texel times the number of texels."""

    @classmethod
    def of(cls, radiance: Float[Tensor, "H W 3"]) -> Light:
        """Uploads the map and its sampling distribution."""
        height, width = radiance.shape[:2]
        weights = _cell_integrals(radiance.detach().mean(-1).clamp_min(0).double())
        polar = (torch.arange(height, dtype=torch.float64, device=radiance.device) + 0.5) * (torch.pi / height)
        area = torch.sin(polar)[:, None].expand(height, width)
        weights = weights * area
        total = weights.sum()
        uniform = area / area.sum()
        chance = (1 - _UNIFORM_SHARE) * weights / total + _UNIFORM_SHARE * uniform if float(total) > 0 else uniform
        row = chance.sum(1)
        columns = (chance / row[:, None]).cumsum(1)
        padded = torch.nn.functional.pad(radiance.detach(), (0, 1))
        return cls(
            to_float(padded, mi),
            height,
            width,
            to_float(row.cumsum(0), mi),
            to_float(columns, mi),
            to_float(chance * (height * width), mi),
        )

    def radiance(self, direction: DrJitArray) -> DrJitArray:
        """Color3f from a direction, differentiable in `values`: periodic in u, the last rows go on at the poles."""
        u, v = latlong_coordinates(direction)
        x, y = repeated(u * self.width - 0.5, self.width), extended(v * self.height - 0.5, self.height)
        value = bilinear(self._texel, x, y)
        return mi.Color3f(value.x, value.y, value.z)

    def sample(self, point: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
        """A direction and its density per steradian, from a point of the unit square."""
        row, y = _invert(self.rows, mi.UInt32(0), self.height, point.y)
        column, x = _invert(self.columns, row * self.width, self.width, point.x)
        u, v = (mi.Float(column) + x) / self.width, (mi.Float(row) + y) / self.height
        sin, cos = dr.sincos((0.5 - u) * dr.two_pi)
        sin_polar, cos_polar = dr.sincos(v * dr.pi)
        direction = mi.Vector3f(sin_polar * sin, cos_polar, sin_polar * cos)
        density = dr.gather(mi.Float, self.density, row * self.width + column)
        return direction, density / (2 * dr.square(dr.pi) * dr.maximum(sin_polar, 1e-6))

    def pdf(self, direction: DrJitArray) -> DrJitArray:
        """Density per steradian of `sample`."""
        u, v = latlong_coordinates(direction)
        column = dr.minimum(mi.UInt32(u * self.width), self.width - 1)
        row = dr.minimum(mi.UInt32(v * self.height), self.height - 1)
        sin_polar = dr.sqrt(dr.square(direction.x) + dr.square(direction.z))
        density = dr.gather(mi.Float, self.density, row * self.width + column)
        return density / (2 * dr.square(dr.pi) * dr.maximum(sin_polar, 1e-6))

    def gradient(self, like: Tensor) -> Tensor:
        """The derivative that a backward pass left in `values`, shaped like the map."""
        packed = to_torch(dr.grad(self.values), (self.height, self.width, 4), like.device)
        return packed[..., :3].to(like.dtype)

    def _texel(self, row: DrJitArray, column: DrJitArray) -> DrJitArray:
        return dr.gather(mi.Vector4f, self.values, mi.UInt32(row * self.width + column))


def _invert(cumulative: DrJitArray, start: DrJitArray, count: int, u: DrJitArray) -> tuple[DrJitArray, DrJitArray]:
    """Index of the interval that contains u, and the position in it (0…1)."""
    index = dr.binary_search(0, count - 1, lambda i: dr.gather(mi.Float, cumulative, start + i) <= u)
    upper = dr.gather(mi.Float, cumulative, start + index)
    lower = dr.select(index > 0, dr.gather(mi.Float, cumulative, start + dr.maximum(index, 1) - 1), 0)
    position = (u - lower) / dr.maximum(upper - lower, 1e-20)
    return index, dr.clip(position, 0, dr.one_minus_epsilon(mi.Float))


def _cell_integrals(brightness: Float[Tensor, "H W"]) -> Float[Tensor, "H W"]:
    """Mean of the bilinear interpolant over each texel, to which the neighbours contribute."""
    rows = torch.cat([brightness[:1], brightness, brightness[-1:]])
    smooth = 0.125 * rows[:-2] + 0.75 * rows[1:-1] + 0.125 * rows[2:]
    return 0.125 * smooth.roll(1, 1) + 0.75 * smooth + 0.125 * smooth.roll(-1, 1)
