"""Scenes between stages on disk: arrays without pickle, images as float32 OpenEXR."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from hir_exporters.files.atomic import atomic_directory, atomic_path
from hir_exporters.textures.image_files import read_exr, write_exr

from hir_core.errors import InputError
from hir_core.files.array_files import read_arrays
from hir_core.files.json_documents import read_json, write_json
from hir_core.scene.scene import EnvironmentMap, Material, Mesh, Scene, Topology

_MATERIAL = ("diffuse_albedo", "specular_albedo", "roughness", "normal", "observed")


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
        arrays |= {f"material.{name}": getattr(material, name) for name in _MATERIAL}
    if environment is not None:
        document["environment"] = environment.frame
        arrays |= {"environment.radiance": environment.radiance, "environment.to_world": environment.to_world}
    with atomic_directory(folder) as place:
        plain = {}
        for name, value in arrays.items():
            if value is None:
                continue
            array = value.detach().numpy()
            if array.ndim == 3 and array.dtype == np.float32 and array.shape[2] in (1, 3, 4):
                write_exr(place / f"{name}.exr", array)
            else:
                plain[name] = array
        with atomic_path(place / "arrays.npz") as temporary:
            np.savez(temporary, **plain)  # type: ignore[arg-type]
        write_json(place / "scene.json", document)


def load_stage_scene(folder: Path, device: str = "cpu") -> Scene:
    """The scene that `save_stage_scene` wrote; `InputError` where it is damaged."""
    document = read_json(folder / "scene.json")
    try:
        return _scene_of(document, _arrays(folder)).to(device)
    except (KeyError, TypeError, AttributeError) as error:
        raise InputError(f"{folder} is no whole scene of a stage ({error}); run without --resume") from error


def _arrays(folder: Path) -> dict[str, torch.Tensor]:
    found = {name: torch.from_numpy(array) for name, array in read_arrays(folder / "arrays.npz").items()}
    for path in sorted(folder.glob("*.exr")):
        found[path.stem] = torch.from_numpy(np.ascontiguousarray(read_exr(path)))
    return found


def _scene_of(document: dict[str, Any], found: dict[str, torch.Tensor]) -> Scene:
    mesh = Mesh(
        found["positions"],
        Topology(found["faces"], found.get("uv_faces")),
        found.get("uvs"),
        found.get("vertex_colors"),
    )
    material = environment = None
    if document["material"] is not None:
        material = Material(model=document["material"], **{n: found.get(f"material.{n}") for n in _MATERIAL})  # type: ignore[arg-type]
    if document["environment"] is not None:
        environment = EnvironmentMap(
            found["environment.radiance"], found.get("environment.to_world"), document["environment"]
        )
    return Scene(mesh, material, environment)
