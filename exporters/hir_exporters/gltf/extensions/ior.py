"""KHR_materials_ior: the index of refraction. Its value 0, for no Fresnel, is never written: Blender fails on it."""

from __future__ import annotations

NAME = "KHR_materials_ior"
_CORE_IOR = 1.5


def ior_extension(ior: float) -> dict[str, float] | None:
    """The extension's JSON object, or None for 1.5, the value of core glTF."""
    if ior == _CORE_IOR:
        return None
    assert ior >= 1
    return {"ior": ior}
