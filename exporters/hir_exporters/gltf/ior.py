"""KHR_materials_ior: the index of refraction. Never 0, its code for "no Fresnel": that breaks readers."""

from __future__ import annotations

NAME = "KHR_materials_ior"
_DEFAULT = 1.5


def ior_extension(ior: float) -> dict[str, float] | None:
    """The extension's object, or None where the core's 1.5 is meant."""
    if ior == _DEFAULT:
        return None
    assert ior >= 1
    return {"ior": ior}
