"""The material of an .obj from its .mtl, with the PBR statements Pr, Pm and norm; warnings name what is left out."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from hir_exporters.errors import InputError
from hir_exporters.reading.material_overrides import MaterialOverrides
from hir_exporters.reading.mesh_references import contained_file
from hir_exporters.reading.wavefront.bump_maps import is_normal_map
from hir_exporters.reading.wavefront.mtl_statements import MtlStatement, read_library, texture_map
from hir_exporters.reading.wavefront.obj_geometry import ObjGeometry

Material = Mapping[str, MtlStatement]

_BUMP: Final = ("map_bump", "bump")
_LEFT_OUT: Final = {
    "d": 1.0,
    "tr": 0.0,
    "ke": 0.0,
    "tf": 1.0,
    "ps": 0.0,
    "pc": 0.0,
    "aniso": 0.0,
    "map_d": None,
    "map_tr": None,
    "map_ke": None,
    "map_ps": None,
    "disp": None,
    "decal": None,
    "refl": None,
}
"""Statements that an asset has no place for, with their neutral number; None where each value has an effect."""

_SPECULAR: Final = ("ks", "ns", "map_ks", "map_ns")
"""Programs define `Ns` differently, so there is no roughness that all of them mean."""

_CHANNELS: Final = {"map_pr": "g", "map_pm": "b"}
"""The channel that is read of a picture in colours."""


def read_mtl(path: Path, geometry: ObjGeometry, maps: MaterialOverrides) -> MaterialOverrides:
    """`maps`, completed by the material that the faces of an .obj use.

    Raises `InputError` where they use materials that differ, and where a statement is malformed.
    """
    library = _library(path, geometry.libraries)
    found = list(dict.fromkeys(_material(path, library, name, maps) for name in geometry.materials))
    if len(found) > 1:
        raise InputError(f"{path} has {len(found)} materials; an asset has one: merge them first")
    return found[0] if found else maps


def _library(path: Path, names: Sequence[str]) -> dict[str, dict[str, MtlStatement]] | None:
    """The materials of all libraries; None where a library is missing or none is named."""
    materials: dict[str, dict[str, MtlStatement]] = {}
    files = [contained_file(path, name) for name in names]
    missing = [name for name, file in zip(names, files, strict=True) if not os.path.isfile(file)]
    if missing:
        warnings.warn(
            f"{path} names {missing[0][:80]!r}, which is not in its folder, so its materials are left out; put it "
            "beside the file",
            stacklevel=4,
        )
    for file in files:
        if os.path.isfile(file):  # pathlib raises an error for too long names
            materials = read_library(file) | materials
    return None if (missing and not materials) or not names else materials


def _material(
    path: Path, library: dict[str, dict[str, MtlStatement]] | None, name: str, maps: MaterialOverrides
) -> MaterialOverrides:
    """`maps`, completed by one material of the library; by none where it has no material of this name."""
    if library is None:
        return maps
    if not name and len(library) == 1:
        name = next(iter(library))
    if name in library:
        return _completed(path, name, library[name], maps)
    if name or library:
        problem = f"use the material {name[:80]!r}, which its .mtl does not define" if name else "have no usemtl"
        warnings.warn(
            f"faces of {path} {problem}, so they get the default material; export the mesh again with its material",
            stacklevel=5,
        )
    return maps


def _completed(path: Path, name: str, material: Material, maps: MaterialOverrides) -> MaterialOverrides:
    base_color, roughness, metallic = maps.base_color, maps.roughness, maps.metallic
    normal, normal_scale = maps.normal, maps.normal_scale
    if base_color is None:
        base_color = _picture(path, material, "map_kd") or _color(material.get("kd"))
        if isinstance(base_color, Path):
            _warn_of_tint(material.get("kd"))
    if roughness is None:
        roughness = _picture(path, material, "map_pr") or _number(material.get("pr"))
    if metallic is None:
        metallic = _picture(path, material, "map_pm") or _number(material.get("pm"))
    if normal is None:
        normal, normal_scale = _normal(path, material)
    _warn_of_left_out(path, name, material, roughness is not None)
    return MaterialOverrides(base_color, roughness, metallic, normal, normal_scale)


def _picture(path: Path, material: Material, keyword: str) -> Path | None:
    statement = material.get(keyword)
    if statement is None:
        return None
    texture = texture_map(statement.value)
    if texture.change:
        raise InputError(
            f"{statement.location} has the option {texture.change}, which cannot be read; bake the texture without it"
        )
    channel = "".join(texture.options.get("-imfchan", ())).lower()
    if channel and keyword in _CHANNELS and channel != _CHANNELS[keyword]:
        raise InputError(
            f"{statement.location} has the option -imfchan {channel}, which cannot be read; save this channel as a "
            "grey image"
        )
    return _existing(path, statement)


def _existing(path: Path, statement: MtlStatement) -> Path:
    """The picture that a statement names."""
    name = texture_map(statement.value).name
    file = contained_file(path, name)
    if not os.path.isfile(file):
        raise InputError(
            f"{statement.location} names {name[:80]!r}, which is not in the folder of {path.name}; put it there"
        )
    return file


def _normal(path: Path, material: Material) -> tuple[Path | None, float]:
    """The normal map and its scale: that of `norm`, else that of a bump statement if its picture is one."""
    keyword = next((keyword for keyword in ("norm", *_BUMP) if keyword in material), None)
    if keyword is None:
        return None, 1.0
    statement = material[keyword]
    file = _existing(path, statement)
    if keyword in _BUMP and not is_normal_map(file):
        warnings.warn(
            f"{statement.location} names {file.name!r}, a height map, which is left out; bake it into a normal map, "
            "and give that with --normal",
            stacklevel=6,
        )
        return None, 1.0
    return _picture(path, material, keyword), _strength(statement)


def _strength(statement: MtlStatement) -> float:
    """The bump multiplier `-bm`, as which Blender writes the strength of a normal map."""
    words = texture_map(statement.value).options.get("-bm", ("1",))
    numbers = MtlStatement(" ".join(words), statement.location).numbers()
    if len(numbers) != 1 or not math.isfinite(numbers[0]):
        raise InputError(f"{statement.location} has the option -bm without a finite number; export it again")
    return numbers[0]


def _warn_of_tint(color: MtlStatement | None) -> None:
    """Many programs write a grey `Kd` beside a picture that is the whole colour; one that is not grey is meant."""
    try:
        tinted = color is not None and len(set(color.numbers())) > 1
    except InputError:
        return
    if color is not None and tinted:
        warnings.warn(
            f"{color.location} is {color.value[:80]}, by which map_Kd is not multiplied; bake it into the picture",
            stacklevel=6,
        )


def _color(statement: MtlStatement | None) -> tuple[float, float, float] | None:
    if statement is None:
        return None
    numbers = statement.numbers()
    if len(numbers) not in (1, 3):
        raise InputError(f"{statement.location} is not three numbers; export it again")
    red, green, blue = numbers * (3 // len(numbers))
    _check_unit_range(statement, numbers)
    return red, green, blue


def _number(statement: MtlStatement | None) -> float | None:
    if statement is None:
        return None
    numbers = statement.numbers()[:1]
    _check_unit_range(statement, numbers)
    return numbers[0]


def _check_unit_range(statement: MtlStatement, numbers: Sequence[float]) -> None:
    if not all(0 <= number <= 1 for number in numbers):
        raise InputError(f"{statement.location} is {statement.value[:80]!r}; it must be from 0 to 1")


def _warn_of_left_out(path: Path, name: str, material: Material, has_roughness: bool) -> None:
    """One warning for what an asset cannot have, and one for highlights without a roughness."""
    owner = f"of the material {name[:80]!r}"
    lost = [key for key, neutral in _LEFT_OUT.items() if key in material and not _is_neutral(material[key], neutral)]
    if lost:
        warnings.warn(
            f"{path}: the import leaves out {_listed(lost, material)} {owner}, because an asset cannot have them; bake "
            "what they show into the base colour",
            stacklevel=6,
        )
    lobes = [key for key in _SPECULAR if key in material]
    matt = "map_ks" not in material and "ks" in material and _is_neutral(material["ks"], 0.0)
    if lobes and not has_roughness and not matt:
        warnings.warn(
            f"{path}: the import leaves out {_listed(lobes, material)} {owner}, because programs define them "
            "differently; give the roughness with --roughness",
            stacklevel=6,
        )


def _listed(keys: Sequence[str], material: Material) -> str:
    return ", ".join(f"{material[key].location.rpartition(' ')[2]} {material[key].value[:80]}" for key in keys)


def _is_neutral(statement: MtlStatement, neutral: float | None) -> bool:
    if neutral is None:
        return False
    try:
        return all(number == neutral for number in statement.numbers())
    except InputError:  # "d -halo 0.5", a spectral file
        return False
