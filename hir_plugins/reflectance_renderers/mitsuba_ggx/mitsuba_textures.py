"""The parameters of a material as Dr.Jit arrays: one value, or a texture with bilinear lookup."""

from __future__ import annotations

from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import torch
from torch import Tensor

from hir_core.errors import StageError
from hir_plugins.reflectance_renderers.drjit_arrays import to_float, to_torch
from hir_plugins.reflectance_renderers.drjit_bilinear import bilinear, repeated
from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


@dataclass
class Parameter:
    """One parameter of the material with 1 or 3 channels; `values` is the leaf of differentiation."""

    values: DrJitArray
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

    def at(self, u: DrJitArray, v: DrJitArray, active: DrJitArray) -> DrJitArray:
        """Color3f or Float at texture coordinates, which are periodic; row 0 is at v = 0."""
        kind = mi.Vector4f if self.channels == 3 else mi.Float
        if not self.width:
            index = dr.zeros(mi.UInt32, dr.width(u))
            return self._channels(dr.gather(kind, self.values, index, active))
        x = repeated((u - dr.floor(u)) * self.width - 0.5, self.width)
        y = repeated((v - dr.floor(v)) * self.height - 0.5, self.height)

        def texel(row: DrJitArray, column: DrJitArray) -> DrJitArray:
            return dr.gather(kind, self.values, mi.UInt32(row * self.width + column), active)

        return self._channels(bilinear(texel, x, y))

    def gradient(self, like: Tensor) -> Tensor:
        """The derivative that a backward pass left in `values`, shaped like the tensor it was made of."""
        rows = max(self.height * self.width, 1)
        packed = to_torch(dr.grad(self.values), (rows, 4 if self.channels == 3 else 1), like.device)
        return packed[:, : self.channels].reshape(like.shape).to(like.dtype)

    def _channels(self, value: DrJitArray) -> DrJitArray:
        return mi.Color3f(value.x, value.y, value.z) if self.channels == 3 else value
