"""Conversion between torch or NumPy and Dr.Jit."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import drjit as dr
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray

_ALIGNMENT = 64
"""Bytes."""


def to_float(tensor: Tensor, mi: ModuleType) -> DrJitArray:
    """A flat `mi.Float` with a copy of the values."""
    flat = tensor.detach().to(torch.float32).contiguous().reshape(-1)
    if flat.is_cuda:
        return mi.Float(flat.clone())
    # a copy, because an optimiser may change the tensor in place before a kernel has run
    return floats(flat.numpy(), mi)


def floats(values: NDArray[Any], mi: ModuleType) -> DrJitArray:
    """A flat `mi.Float` with a copy of an array."""
    return mi.Float(_aligned(np.ascontiguousarray(values, dtype=np.float32).ravel()))


def to_uint(tensor: Tensor, mi: ModuleType) -> DrJitArray:
    """A flat `mi.UInt32`."""
    flat = tensor.detach().reshape(-1)
    if flat.is_cuda:
        return mi.UInt32(flat.to(torch.int32).contiguous())
    return mi.UInt32(_aligned(flat.numpy().astype(np.uint32)))


def to_torch(array: DrJitArray, shape: tuple[int, ...], device: torch.device) -> Tensor:
    """A tensor with a copy of a flat Dr.Jit array."""
    if device.type == "cuda":
        return array.torch().reshape(shape).clone().to(device)
    return torch.from_numpy(np.array(array, copy=True).astype(np.float32, copy=False)).reshape(shape).to(device)


def copy_to_torch(array: DrJitArray, target: Tensor) -> None:
    """Copies a flat Dr.Jit array to a tensor of its type, with as many elements."""
    values = array.torch() if target.is_cuda else torch.from_numpy(np.asarray(array))
    target.copy_(values.reshape(target.shape))


def to_color(array: DrJitArray, device: torch.device) -> Tensor:
    """(N, 3) of a `mi.Color3f`."""
    dr.eval(array)  # together: each channel that is read alone would run its kernel again
    channels = [to_torch(array[i], (-1,), device) for i in range(3)]
    return torch.stack(torch.broadcast_tensors(*channels), dim=1)


def _aligned(values: NDArray[Any]) -> NDArray[Any]:
    """A copy at an aligned address: Dr.Jit uses it in place, and compiles other kernels for unaligned addresses."""
    buffer = np.empty(values.nbytes + _ALIGNMENT, dtype=np.uint8)
    padding = -buffer.ctypes.data % _ALIGNMENT
    copy = buffer[padding : padding + values.nbytes].view(values.dtype)
    copy[:] = values
    return copy
