"""Where the textures of a glTF material lie: the set of texture coordinates, KHR_texture_transform, and wrap modes.

An asset has one set of texture coordinates, and its textures repeat. One offset and scale that all textures share is
part of the coordinates; all else is refused.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.errors import InputError
from hir_exporters.reading.gltf_json.gltf_surface import texture_references
from hir_exporters.reading.gltf_json.gltf_textures import GltfTextures
from hir_exporters.reading.gltf_json.stored_accessors import Json

TRANSFORM: Final = "KHR_texture_transform"

Offset = tuple[float, float]
Scale = tuple[float, float]

_REPEAT: Final = 10497
_WRAP_NAMES: Final = {33071: "clamped", 33648: "mirrored"}
_MARGIN: Final = 1e-3
"""How far beyond 0 to 1 a coordinate may be before another wrap mode than repetition shows: a texel of 1024."""


def placement_problem(reference: Json) -> str:
    """Why a texture does not lie where the first texture coordinates say, for `the texture NAME …`; else empty."""
    transform = reference.get("extensions", {}).get(TRANSFORM, {})
    if transform.get("texCoord", reference.get("texCoord", 0)) != 0:
        return "lies on the second texture coordinates"
    if _offset_and_scale(transform) != ((0.0, 0.0), (1.0, 1.0)):
        return f"has a transform ({TRANSFORM})"
    return ""


def placed_uvs(uvs: NDArray[np.floating], material: Json, textures: GltfTextures) -> NDArray[np.float64]:
    """The coordinates (..., 2), origin top-left, at which the textures of the material are looked up.

    Raises `InputError` where textures lie on other coordinates or have different transforms, rotations or mirroring,
    and where coordinates beyond 0 to 1 reach a texture that is not repeated.
    """
    path = textures.path
    transforms: dict[tuple[Offset, Scale] | None, Json] = {}
    for reference in texture_references(material):
        transform = reference.get("extensions", {}).get(TRANSFORM, {})
        if transform.get("texCoord", reference.get("texCoord", 0)) != 0:
            raise _refused(path, textures.name(reference), "lies on the second texture coordinates")
        placement = _offset_and_scale(transform)
        if placement is None:
            raise _refused(path, textures.name(reference), f"has a transform that rotates or mirrors it ({TRANSFORM})")
        transforms.setdefault(placement, reference)
    if len(transforms) > 1:
        name = textures.name(list(transforms.values())[1])
        raise _refused(path, name, f"has another transform ({TRANSFORM}) than the other textures")
    found = np.asarray(uvs, np.float64)
    for offset, scale in filter(None, transforms):
        if (offset, scale) != ((0.0, 0.0), (1.0, 1.0)):
            found = found * np.asarray(scale) + np.asarray(offset)
    _check_wrapping(found, material, textures)
    return found


def _check_wrapping(uvs: NDArray[np.floating], material: Json, textures: GltfTextures) -> None:
    if not uvs.size:
        return
    flat = uvs.reshape(-1, 2)
    beyond = (flat.min(axis=0) < -_MARGIN) | (flat.max(axis=0) > 1 + _MARGIN)
    if not beyond.any():
        return
    for reference in texture_references(material):
        sampler = textures.texture(reference).get("sampler")
        modes = {} if sampler is None else textures.document["samplers"][sampler]
        for outside, key in zip(beyond, ("wrapS", "wrapT"), strict=True):
            mode = modes.get(key, _REPEAT)
            if outside and mode != _REPEAT:
                problem = f"is {_WRAP_NAMES.get(mode, 'not repeated')} where texture coordinates leave 0 to 1"
                raise _refused(textures.path, textures.name(reference), problem)


def _offset_and_scale(transform: Json) -> tuple[Offset, Scale] | None:
    """None for a transform that rotates or mirrors, and so changes the tangents of normal maps, too."""
    (u, v), (width, height) = transform.get("offset", (0, 0)), transform.get("scale", (1, 1))
    if transform.get("rotation", 0) != 0 or width <= 0 or height <= 0:
        return None
    return (float(u), float(v)), (float(width), float(height))


def _refused(path: Path, name: str, problem: str) -> InputError:
    return InputError(f"{path}: the texture {name} {problem}; bake it in the program that made it")
