"""glTF 2.0's metallic parameters as the two albedos of the `dielectric` formula, and back.

    diffuse_albedo = (1 - m) base        specular_albedo = (1 - m) F0 + m base

These are `c_diff` and `f0` of the closing formula of glTF 2.0, appendix B.3.5 (F0 is 0.04 there; KHR_materials_ior
makes it a parameter), so whatever shades `dielectric` also shades `metallic`. The inverse is
`base = diffuse_albedo + specular_albedo - (1 - m) F0`. In float32, both are exact where m is 0 or 1.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

DEFAULT_DIELECTRIC_F0: Final = 0.04
"""F0 of core glTF's non-metals: an ior of 1.5."""
MAX_DIELECTRIC_F0: Final = 0.5
"""Upper limit of a non-metal's F0. Germanium, among the largest, has 0.36 (ior 4)."""


def effective_albedos(base_color: Array, metalness: Array, dielectric_f0: float) -> tuple[Array, Array]:
    """Diffuse and specular albedo, (H, W, 3) or (3,), of a base colour (H, W, 3) or (3,) and a metalness (H, W) or ().

    F0 is one number. All are linear.
    """
    m = metalness[..., None]
    share = np.float32(1) - m
    diffuse, specular = share * base_color, m * base_color
    specular += share * np.float32(dielectric_f0)
    return diffuse.astype(np.float32, copy=False), specular.astype(np.float32, copy=False)


def base_color_of(diffuse: Array, specular: Array, metalness: Array, dielectric_f0: float) -> Array:
    """The base colour (H, W, 3) or (3,) of `effective_albedos`; not clipped."""
    base = specular - (np.float32(1) - metalness[..., None]) * np.float32(dielectric_f0)
    base = np.add(diffuse, base, out=base if base.ndim >= diffuse.ndim else None)
    return base.astype(np.float32, copy=False)
