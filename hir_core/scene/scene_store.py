"""Scenes of finished stages on disk: arrays without pickle, images as float32 OpenEXR."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from hir_exporters.files.atomic import atomic_directory
from hir_exporters.textures.image_files import read_exr, write_exr

from hir_core.errors import InputError
from hir_core.files.array_files import read_arrays, write_arrays
from hir_core.files.json_documents import read_json, write_json
from hir_core.files.stored_take_lights import TAKES, read_take_lights, take_array_name
from hir_core.scene.scene import CameraLamp, EnvironmentMap, Material, Mesh, Scene, Topology

_MATERIAL = ("diffuse_albedo", "specular_albedo", "roughness", "normal", "observed", "metalness")
_LAMP = ("intensity", "offset", "exponent", "radius")


def save_stage_scene(scene: Scene, folder: Path) -> None:
    """Writes a scene so that `load_stage_scene` returns the same bits; replaces the folder as a whole."""
    scene = scene.to("cpu")
    mesh, material, environment = scene.mesh, scene.material, scene.environment
    arrays: dict[str, torch.Tensor | None] = {
        "positions": mesh.positions,
        "faces": mesh.faces,
        "uv_faces": mesh.topology.uv_faces,
        "uvs": mesh.uvs,
        "vertex_colors": mesh.vertex_colors,
    }
    document: dict[str, Any] = {"material": None, "environment": None}
    if material is not None:
        document["material"] = material.model
        if material.model == "metallic":
            document["dielectric_f0"] = material.dielectric_f0
        arrays |= {f"material.{name}": getattr(material, name) for name in _MATERIAL}
    if environment is not None:
        document["environment"] = environment.frame
        arrays |= {"environment.radiance": environment.radiance, "environment.to_world": environment.to_world}
        if environment.lamp is not None:
            arrays |= {f"lamp.{name}": getattr(environment.lamp, name) for name in _LAMP}
    if scene.take_radiance:
        document[TAKES] = list(scene.take_radiance)
        arrays |= {take_array_name(number): value for number, value in enumerate(scene.take_radiance.values())}
    with atomic_directory(folder) as new_folder:
        arrays_to_store = {}
        for name, value in arrays.items():
            if value is None:
                continue
            array = value.detach().numpy()
            if array.ndim == 3 and array.dtype == np.float32 and array.shape[2] in (1, 3, 4):
                write_exr(new_folder / f"{name}.exr", array)
            else:
                arrays_to_store[name] = array
        write_arrays(new_folder / "arrays.npz", arrays_to_store)
        write_json(new_folder / "scene.json", document)


def load_stage_scene(folder: Path, device: str = "cpu") -> Scene:
    """The scene that `save_stage_scene` wrote; `InputError` where it is damaged."""
    document = read_json(folder / "scene.json")
    try:
        return _scene_of(document, _arrays(folder), load_take_radiance(folder)).to(device)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{folder} is not a complete scene of a stage ({error}); run without --resume") from error


def _arrays(folder: Path) -> dict[str, torch.Tensor]:
    tensors = {name: torch.from_numpy(array) for name, array in read_arrays(folder / "arrays.npz").items()}
    for path in sorted(folder.glob("*.exr")):
        tensors[path.stem] = torch.from_numpy(np.ascontiguousarray(read_exr(path)))
    return tensors


def _scene_of(
    document: dict[str, Any], tensors: dict[str, torch.Tensor], take_radiance: dict[str, torch.Tensor]
) -> Scene:
    mesh = Mesh(
        tensors["positions"],
        Topology(tensors["faces"], tensors.get("uv_faces")),
        tensors.get("uvs"),
        tensors.get("vertex_colors"),
    )
    material = environment = None
    if document["material"] is not None:
        f0 = {"dielectric_f0": document["dielectric_f0"]} if document["material"] == "metallic" else {}
        maps = {n: tensors.get(f"material.{n}") for n in _MATERIAL}
        material = Material(model=document["material"], **maps, **f0)  # type: ignore[arg-type]
    if document["environment"] is not None:
        lamp = None
        if "lamp.intensity" in tensors:  # runs before lamps had a radius have none
            lamp = CameraLamp(**{name: tensors[f"lamp.{name}"] for name in _LAMP if f"lamp.{name}" in tensors})
        environment = EnvironmentMap(
            tensors["environment.radiance"], tensors.get("environment.to_world"), document["environment"], lamp
        )
    return Scene(mesh, material, environment, take_radiance)


def load_take_radiance(folder: Path) -> dict[str, torch.Tensor]:
    """As `read_take_lights`, as tensors."""
    return {name: torch.from_numpy(radiance) for name, radiance in read_take_lights(folder).items()}
