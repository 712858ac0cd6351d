"""The open scene format: a folder with scene.json, mesh.ply and float32 OpenEXR textures and environment."""

from __future__ import annotations

import json
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path, PurePosixPath
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import BRDF_MODELS, Asset, AssetEnvironment, AssetMaterial, validate_asset
from hir_exporters.asset_lamp import AssetLamp, lamp_description
from hir_exporters.errors import ExportError, InputError
from hir_exporters.files.atomic import atomic_directory, write_bytes_atomic, write_text_atomic
from hir_exporters.files.regular_files import refuse_special_file
from hir_exporters.files.untrusted_json import parse_json
from hir_exporters.mesh.ply_format import decode_ply, encode_ply
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0
from hir_exporters.textures.image_files import read_exr, write_exr
from hir_exporters.textures.pillow_images import MAX_PIXELS

FORMAT: Final = "hir-scene"
VERSION: Final = 1
"""Version of scene.json; readers refuse newer ones."""

_MAP_CHANNELS: Final = {
    "diffuse_albedo": 3,
    "specular_albedo": 3,
    "roughness": 1,
    "normal": 3,
    "observed": 1,
    "metalness": 1,
}
_CONSTANT_MAPS: Final = ("diffuse_albedo", "specular_albedo", "roughness", "metalness")
_SCENE_FILES: Final = frozenset(
    {"scene.json", "mesh.ply", "environment.exr", *(f"{name}.exr" for name in _MAP_CHANNELS)}
)
_MAX_JSON_BYTES: Final = 16 << 20


def save_scene(asset: Asset, folder: str | os.PathLike[str]) -> None:
    """Validates an asset and writes it into `folder`. An older scene there is replaced as a whole or not at all.

    Raises `ExportError` where the folder contains a file that is not part of a scene: such files are never deleted.
    """
    validate_asset(asset)
    folder = Path(folder)
    if folder.is_dir():
        other_files = sorted(entry.name for entry in folder.iterdir() if entry.name not in _SCENE_FILES)
        if other_files:
            raise ExportError(
                f"{folder} contains {other_files[0]!r}, which is not part of a scene; choose another folder"
            )
    with atomic_directory(folder) as temporary:
        write_bytes_atomic(temporary / "mesh.ply", encode_ply(asset.mesh))
        document = {
            "format": FORMAT,
            "version": VERSION,
            "name": asset.name,
            "mesh": "mesh.ply",
            "material": _save_material(temporary, asset.material),
            "environment": _save_environment(temporary, asset.environment),
            "provenance": dict(asset.provenance),
        }
        text = json.dumps(document, indent=2, sort_keys=True, allow_nan=False) + "\n"
        write_text_atomic(temporary / "scene.json", text)


def load_scene(folder: str | os.PathLike[str]) -> Asset:
    """The validated asset of a scene folder. Raises `InputError` with the file or the entry of scene.json at fault."""
    folder = Path(folder)
    source = folder / "scene.json"
    document = _read_json(source)
    if document.get("format") != FORMAT:
        raise InputError(f"{source} is not a scene: its format is {document.get('format')!r}, not {FORMAT!r}")
    version = document.get("version")
    if not isinstance(version, int) or isinstance(version, bool) or not 1 <= version <= VERSION:
        raise InputError(f"{source} has the version {version!r}; this program reads 1 to {VERSION}: update it")
    mesh_path = _inside(folder, document.get("mesh"), "mesh")
    asset = Asset(
        mesh=decode_ply(_read_bytes(mesh_path), str(mesh_path)),
        material=_load_material(folder, _table(source, document, "material")),
        environment=_load_environment(folder, source, document),
        provenance=_table(source, document, "provenance", optional=True),
        name=document.get("name", "asset"),
    )
    try:
        validate_asset(asset)
    except InputError as error:
        raise InputError(f"{folder}: {error}") from error
    return asset


def _save_material(folder: Path, material: AssetMaterial) -> dict[str, object]:
    # Scenes of the other models have no entry for metalness, as before there was one.
    names = [name for name in _MAP_CHANNELS if name != "metalness" or material.metalness is not None]
    entries: dict[str, object] = {name: _save_map(folder, name, getattr(material, name)) for name in names}
    if material.model == "metallic":
        entries["dielectric_f0"] = float(material.dielectric_f0)
    return {"model": material.model} | entries


def _save_map(folder: Path, name: str, value: NDArray[Any] | None) -> str | float | list[float] | None:
    if value is None:
        return None
    if value.ndim < 2:
        constant: float | list[float] = value.astype(np.float64).tolist()
        return constant
    write_exr(folder / f"{name}.exr", value.astype(np.float32))
    return f"{name}.exr"


def _save_environment(folder: Path, environment: AssetEnvironment | None) -> dict[str, object] | None:
    if environment is None:
        return None
    write_exr(folder / "environment.exr", environment.radiance)
    entry: dict[str, object] = {"radiance": "environment.exr", "to_world": environment.to_world.tolist()}
    entry["frame"] = environment.frame
    if environment.lamp is not None:
        entry["lamp"] = lamp_description(environment.lamp)
    return entry


def _load_material(folder: Path, table: dict[str, Any]) -> AssetMaterial:
    source = folder / "scene.json"
    model = table.get("model")
    if model not in BRDF_MODELS:
        raise InputError(f"{source}: material.model is {model!r}; known are {', '.join(BRDF_MODELS)}")
    needed = _CONSTANT_MAPS if model == "metallic" else _CONSTANT_MAPS[:3]
    for name in needed:
        if table.get(name) is None:
            raise InputError(f"{source}: material.{name} is missing; give a file or a constant")
    with ThreadPoolExecutor(max_workers=4) as pool:  # the OpenEXR binding releases the interpreter lock
        values = pool.map(lambda name: _load_map(folder, name, table.get(name)), _MAP_CHANNELS)
        maps: dict[str, Any] = dict(zip(_MAP_CHANNELS, values, strict=True))
    observed = maps.pop("observed")
    f0 = table.get("dielectric_f0", DEFAULT_DIELECTRIC_F0)
    _check_numbers(source, "material.dielectric_f0", [f0])
    observed = None if observed is None else observed > 0.5
    return AssetMaterial(model=model, observed=observed, dielectric_f0=float(f0), **maps)


def _load_map(folder: Path, name: str, value: object) -> NDArray[Any] | None:
    channels = _MAP_CHANNELS[name]
    if value is None:
        return None
    if isinstance(value, str):
        pixels = read_exr(_inside(folder, value, f"material.{name}"), MAX_PIXELS, channels)
        return pixels[..., 0] if channels == 1 else pixels
    numbers = value if isinstance(value, list) else [value]
    if name not in _CONSTANT_MAPS or len(numbers) != channels or isinstance(value, list) is not (channels == 3):
        raise InputError(f"{folder / 'scene.json'}: material.{name} is neither a file nor a constant of its size")
    _check_numbers(folder / "scene.json", f"material.{name}", numbers)
    return np.array(value, dtype=np.float32)


def _load_environment(folder: Path, source: Path, document: dict[str, Any]) -> AssetEnvironment | None:
    if document.get("environment") is None:
        return None
    table = _table(source, document, "environment")
    rows = table.get("to_world", np.eye(3).tolist())
    if not isinstance(rows, list) or len(rows) != 3 or not all(isinstance(row, list) and len(row) == 3 for row in rows):
        raise InputError(f"{source}: environment.to_world is not a list of three rows of three numbers")
    _check_numbers(source, "environment.to_world", [number for row in rows for number in row])
    frame = table.get("frame", "world")
    if frame not in ("world", "camera"):
        raise InputError(f"{source}: environment.frame is {frame!r}; it is 'world' or 'camera'")
    radiance = read_exr(_inside(folder, table.get("radiance"), "environment.radiance"), MAX_PIXELS, 3)
    return AssetEnvironment(radiance, np.array(rows, dtype=np.float64), frame, _load_lamp(source, table))


def _load_lamp(source: Path, environment: dict[str, Any]) -> AssetLamp | None:
    if environment.get("lamp") is None:
        return None
    table = _table(source, environment, "lamp")
    vectors = {name: table.get(name) for name in ("intensity", "offset")}
    for name, vector in vectors.items():
        if not isinstance(vector, list) or len(vector) != 3:
            raise InputError(f"{source}: environment.lamp.{name} is not a list of three numbers")
        _check_numbers(source, f"environment.lamp.{name}", vector)
    _check_numbers(source, "environment.lamp.exponent", [table.get("exponent")])
    intensity, offset = (np.array(vector, dtype=np.float64) for vector in vectors.values())
    radius = table.get("radius", 0.0)  # older scenes have none
    _check_numbers(source, "environment.lamp.radius", [radius])
    return AssetLamp(intensity, offset, float(table["exponent"]), float(radius))


def _inside(folder: Path, name: object, entry: str) -> Path:
    """The file that an entry names. It must be inside the scene's folder, also after links are resolved."""
    source = folder / "scene.json"
    if not isinstance(name, str) or not name:
        raise InputError(f"{source}: {entry} does not name a file")
    relative = PurePosixPath(name)
    if relative.is_absolute() or ".." in relative.parts or "\\" in name or ":" in name or "\0" in name:
        raise InputError(f"{source}: {entry} is {name!r}, which is outside the scene's folder")
    path = folder / relative
    if not path.resolve().is_relative_to(folder.resolve()):
        raise InputError(f"{source}: {entry} is {name!r}, a link to outside the scene's folder")
    return path


def _read_json(source: Path) -> dict[str, Any]:
    data = _read_bytes(source, _MAX_JSON_BYTES)
    try:
        document = parse_json(data)
    except (ValueError, RecursionError) as error:
        raise InputError(f"{source} is not JSON ({error})") from error
    if not isinstance(document, dict):
        raise InputError(f"{source} is not a JSON object")
    return document


def _read_bytes(path: Path, limit: int = 8 << 30) -> bytes:
    refuse_special_file(path)
    try:
        if path.stat().st_size > limit:
            raise InputError(f"{path} is larger than {limit} bytes")
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}") from error


def _table(source: Path, document: dict[str, Any], name: str, optional: bool = False) -> dict[str, Any]:
    value = document.get(name, {} if optional else None)
    if not isinstance(value, dict):
        raise InputError(f"{source}: {name} is not a JSON object")
    return value


def _check_numbers(source: Path, entry: str, numbers: list[Any]) -> None:
    if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
        raise InputError(f"{source}: {entry} contains a value that is not a number")
