"""The base colour texture that a mesh file names: map_Kd of an .mtl, a glTF material's texture, TextureFile of a .ply.

Nothing else of the materials is read. A file that the mesh file names must lie in its folder (`contained_file`), and
pictures are opened like all others (`open_image`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.errors import HirError, InputError
from hir_exporters.reading.gltf_json.gltf_surface import SPECULAR_GLOSSINESS
from hir_exporters.reading.gltf_json.gltf_textures import image_source
from hir_exporters.reading.gltf_json.texture_placement import placement_problem
from hir_exporters.reading.mesh_references import check_references, contained_file, gltf_content, image_bytes, uris
from hir_exporters.reading.wavefront.mtl_statements import read_library, texture_map
from hir_exporters.reading.wavefront.obj_statements import library_names, read_statements, used_materials
from hir_exporters.textures.image_files import quantize, read_rgb8

_GLTF: Final = (".gltf", ".glb")
_TEXTURE_FILE: Final = re.compile(rb"^comment[ \t]+texturefile[ \t]+(.*?)[ \t\r]*$", re.MULTILINE | re.IGNORECASE)
_PLY_HEADER_BYTES: Final = 1 << 16
_WHITE: Final = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class _BaseColor:
    """The base colour of one material."""

    name: str
    """What messages call it."""
    picture: str | int | None
    """Name of a file, or index of an image in a glTF document; None for a material without a picture."""
    factor: tuple[float, ...] = _WHITE
    """Linear; the picture is multiplied by it."""
    problem: str = ""
    """Why the picture is not where the first texture coordinates say."""


def read_base_color_texture(path: Path) -> NDArray[np.uint8] | None:
    """sRGB codes (H, W, 3), row 0 at the top, of the texture of a mesh file; None where its materials have no picture.

    Raises `InputError` with one sentence where the materials have several base colours, so that none stands for the
    whole mesh, and where the picture is missing, damaged, or not one that the mesh file may name.
    """
    check_references(path)
    try:
        found = list(dict.fromkeys(_base_colors(path)))
        if all(color.picture is None for color in found):
            return None
        if len(found) > 1:
            names = ", ".join(color.name for color in found[:4]) + (", …" if len(found) > 4 else "")
            raise InputError(
                f"{path} has {len(found)} base colours ({names}), and none stands for the whole mesh; bake them into "
                "one texture in the program that made it"
            )
        color = found[0]
        if color.problem:
            raise InputError(f"{path}: the texture {color.name} {color.problem}; bake it in the program that made it")
        return _multiplied(_pixels(path, color), color.factor)
    except HirError:
        raise
    except Exception as error:  # a document may have any structure
        raise InputError(f"{path}: its texture cannot be read ({_reason(error)}); export it again") from error


def named_files(path: Path) -> list[Path]:
    """Existing files that a mesh file names and that decide how it looks: buffers, material library, pictures."""
    check_references(path)
    try:
        if path.suffix.lower() in _GLTF:
            names = [uri for uri in uris(gltf_content(path)[0]) if not uri.startswith("data:")]
        else:
            libraries = _libraries(path) if path.suffix.lower() == ".obj" else []
            missing = any(not contained_file(path, library).is_file() for library in libraries)
            pictures = [] if missing else [color.picture for color in _base_colors(path)]
            names = [name for name in (*libraries, *pictures) if isinstance(name, str)]
        files = [_named_file(path, name) for name in dict.fromkeys(names)]
        return [file for file in files if file.is_file()]
    except HirError:
        raise
    except Exception as error:
        raise InputError(f"{path}: what it names cannot be listed ({_reason(error)}); export it again") from error


def _base_colors(path: Path) -> Iterator[_BaseColor]:
    """The base colour of each material that a triangle has."""
    suffix = path.suffix.lower()
    if suffix in _GLTF:
        yield from _gltf_base_colors(gltf_content(path)[0])
    elif suffix == ".obj":
        yield from _obj_base_colors(path)
    elif suffix == ".ply":
        for name in _ply_textures(path):
            yield _BaseColor(name, name)


def _obj_base_colors(path: Path) -> Iterator[_BaseColor]:
    libraries = _libraries(path)
    if not libraries:
        return
    materials: dict[str, _BaseColor] = {}
    for library in libraries:
        file = contained_file(path, library)
        if not file.is_file():
            raise InputError(f"{path} names {library[:80]!r}, which is not in its folder; put it beside the file")
        materials = _mtl_base_colors(file) | materials
    for name in used_materials(read_statements(path)):
        yield materials.get(name, _BaseColor("faces without a material", None))


def _mtl_base_colors(library: Path) -> dict[str, _BaseColor]:
    """Base colours by the name of the material. A picture replaces the colour Kd (docs/formats.md)."""
    materials: dict[str, _BaseColor] = {}
    for material, statements in read_library(library).items():
        materials[material] = _BaseColor(f"the colour of {material!r}", None)
        if "map_kd" in statements:
            texture = texture_map(statements["map_kd"].value)
            problem = f"has the option {texture.change}" if texture.change else ""
            materials[material] = _BaseColor(texture.name, texture.name, problem=problem)
    return materials


def _gltf_base_colors(document: Mapping[str, Any]) -> Iterator[_BaseColor]:
    for mesh in document.get("meshes", []):
        for primitive in mesh["primitives"]:
            index = primitive.get("material")
            material = {} if index is None else document["materials"][index]
            yield _gltf_base_color(document, material, f"the colour of material {index}")


def _gltf_base_color(document: Mapping[str, Any], material: Mapping[str, Any], name: str) -> _BaseColor:
    old = material.get("extensions", {}).get(SPECULAR_GLOSSINESS)
    core = material.get("pbrMetallicRoughness", {})
    reference = core.get("baseColorTexture") if old is None else old.get("diffuseTexture")
    color = core.get("baseColorFactor") if old is None else old.get("diffuseFactor")
    factor = tuple(float(value) for value in (color or _WHITE)[:3])
    if reference is None:
        return _BaseColor(name, None, factor)
    source = image_source(document["textures"][reference["index"]])
    if source is None:
        return _BaseColor(name, None, factor)
    image = document["images"][source]
    uri = str(image.get("uri", "data:"))
    shown = f"image {source}" if uri.startswith("data:") else uri
    return _BaseColor(shown, int(source), factor, placement_problem(reference))


def _pixels(path: Path, color: _BaseColor) -> NDArray[np.uint8]:
    name = f"{path}: the texture {color.name}"
    if isinstance(color.picture, int):
        document, binary = gltf_content(path)
        data = image_bytes(path, document, document["images"][color.picture], binary)
        if data is None:
            raise InputError(f"{path} names {color.name!r}, which is not in its folder; put it beside the file")
        return read_rgb8(data, name=name)
    assert color.picture is not None
    file = contained_file(path, color.picture)
    if not file.is_file():
        raise InputError(f"{path} names {color.picture[:80]!r}, which is not in its folder; put it beside the file")
    return read_rgb8(file)


def _multiplied(codes: NDArray[np.uint8], factor: tuple[float, ...]) -> NDArray[np.uint8]:
    """sRGB codes times a linear factor for each channel; values above 1 are clipped."""
    if factor == _WHITE:
        return codes
    linear = srgb_to_linear(np.arange(256) / 255)
    tables = [quantize(linear_to_srgb(np.clip(linear * value, 0, 1))) for value in factor]
    channels = [table[codes[..., i]] for i, table in enumerate(tables)]
    return np.stack(channels, axis=-1).astype(np.uint8)


def ply_texture(path: Path) -> Path | None:
    """The picture that a .ply names as its texture; `InputError` where it is missing or one of several."""
    names = list(dict.fromkeys(_ply_textures(path)))
    if len(names) > 1:
        raise InputError(f"{path} has {len(names)} textures; an asset has one: bake them into one first")
    file = contained_file(path, names[0]) if names else None
    if file is not None and not file.is_file():
        raise InputError(f"{path} names {names[0][:80]!r}, which is not in its folder; put it beside the file")
    return file


def _ply_textures(path: Path) -> list[str]:
    with open(path, "rb") as stream:
        header = stream.read(_PLY_HEADER_BYTES).partition(b"end_header")[0]
    return [_text(name) for name in _TEXTURE_FILE.findall(header)]


def _libraries(path: Path) -> list[str]:
    """The material libraries that an .obj names."""
    return [name for text in read_statements(path)[b"mtllib"].texts() for name in library_names(text)]


def _named_file(path: Path, name: str) -> Path:
    return contained_file(path, name, percent_encoded=path.suffix.lower() in _GLTF)


def _text(name: bytes) -> str:
    return name.decode("utf-8", "replace").strip()


def _reason(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())[:200]
