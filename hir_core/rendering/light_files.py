"""Lights that are stored in files: the notation `FILE*STRENGTH`, reading, comparing."""

from __future__ import annotations

import numpy as np
import torch
from hir_exporters.textures.image_files import read_hdr

from hir_core.capture import Array, EnvironmentSource
from hir_core.errors import InputError
from hir_core.scene import EnvironmentMap


def load_light(source: EnvironmentSource, world_from_source: Array, device: str = "cpu") -> EnvironmentMap:
    """Reads the light of a capture, times its strength, into the world of `world_from_source` (4×4).

    `InputError` where the product is not finite.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        radiance = read_hdr(source.path) * np.float32(source.strength)
    if not np.isfinite(radiance).all():
        raise InputError(f"{source.path}: its radiance times {source.strength:g} is too large; give a lower strength")
    to_world = world_from_light(world_from_source, source)
    return EnvironmentMap(
        torch.from_numpy(np.ascontiguousarray(radiance)).to(device),
        torch.from_numpy(to_world.astype(np.float32)).to(device),
        "world",
    )


def world_from_light(world_from_source: Array, source: EnvironmentSource | None) -> Array:
    """3×3: turns directions of a lat-long file into the world. Without `source` the file has the capture's own axes."""
    linear = world_from_source[:3, :3]
    axes = np.eye(3) if source is None else np.asarray(source.source_from_environment, dtype=np.float64)
    turned: Array = linear / np.cbrt(np.linalg.det(linear)) @ axes
    return turned


def is_same_light(a: EnvironmentSource | None, b: EnvironmentSource | None) -> bool:
    """Whether two splits have the same light. File contents are compared too, because captures often copy a file."""
    if a is None or b is None:
        return a is b
    if a.strength != b.strength or not np.allclose(a.source_from_environment, b.source_from_environment):
        return False
    try:
        return a.path == b.path or a.path.read_bytes() == b.path.read_bytes()
    except OSError as error:
        raise InputError(f"{error.filename} cannot be read: {error.strerror}; add the light of the capture") from error
