"""The material as Dr.Jit arrays: one value, or a texture looked up bilinearly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import drjit as dr
import mitsuba as mi
import torch
from torch import Tensor

from hir_core.errors import StageError
from hir_plugins.reflectance_renderers.drjit_arrays import to_float, to_torch


@dataclass
class Parameter:
    """One parameter of the material with 1 or 3 channels; `values` is the leaf of differentiation."""

    values: Any
    channels: int
    height: int
    width: int
    """0 × 0: one value for the whole surface."""

    @classmethod
    def of(cls, tensor: Tensor) -> Parameter:
        """Uploads (H, W, C) or (C,); colours are padded to packets of four."""
        channels = tensor.shape[-1]
        if channels not in (1, 3) or tensor.ndim not in (1, 3):
            shape = tuple(tensor.shape)
            raise StageError(f"a texture has the shape {shape}; it must be (H, W, 3), (H, W, 1), (3,) or (1,)")
        height, width = (tensor.shape[0], tensor.shape[1]) if tensor.ndim == 3 else (0, 0)
        padded = torch.nn.functional.pad(tensor.detach(), (0, 1)) if channels == 3 else tensor
        return cls(to_float(padded, mi), channels, height, width)

    def at(self, u: Any, v: Any, active: Any) -> Any:
        """Color3f or Float at texture coordinates, which wrap; row 0 is at v = 0."""
        kind = mi.Vector4f if self.channels == 3 else mi.Float
        if not self.width:
            index = dr.zeros(mi.UInt32, dr.width(u))
            return self._channels(dr.gather(kind, self.values, index, active))
        x, y = (u - dr.floor(u)) * self.width - 0.5, (v - dr.floor(v)) * self.height - 0.5
        left, top = dr.floor(x), dr.floor(y)
        s, t = x - left, y - top
        columns, rows = _wrapped(mi.Int32(left), self.width), _wrapped(mi.Int32(top), self.height)

        def texel(row: Any, column: Any) -> Any:
            return dr.gather(kind, self.values, mi.UInt32(row * self.width + column), active)

        upper = dr.lerp(texel(rows[0], columns[0]), texel(rows[0], columns[1]), s)
        lower = dr.lerp(texel(rows[1], columns[0]), texel(rows[1], columns[1]), s)
        return self._channels(dr.lerp(upper, lower, t))

    def gradient(self, like: Tensor) -> Tensor:
        """The derivative that a backward pass left in `values`, shaped like the tensor it was made of."""
        rows = max(self.height * self.width, 1)
        packed = to_torch(dr.grad(self.values), (rows, 4 if self.channels == 3 else 1), like.device)
        return packed[:, : self.channels].reshape(like.shape).to(like.dtype)

    def _channels(self, value: Any) -> Any:
        return mi.Color3f(value.x, value.y, value.z) if self.channels == 3 else value


def _wrapped(index: Any, count: int) -> tuple[Any, Any]:
    """An index in −1 … count − 1 and the next, wrapped."""
    following = index + 1
    return dr.select(index < 0, count - 1, index), dr.select(following >= count, 0, following)
