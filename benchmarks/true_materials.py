"""True mesh, material and light of captures/spot and captures/avocado, from HIR_SHARED. For evaluation only."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.textures.image_files import read_ldr
from numpy.typing import NDArray

from benchmarks.experiments.cells import ROOT
from hir_core.capture import Array, Capture
from hir_core.evaluation.truth_evaluation import TRUE_MESH
from hir_core.rendering.light_files import load_light
from hir_core.scene import Material, Mesh, Scene, Topology

MODELS = Path(os.environ.get("HIR_SHARED", ROOT.parent / "shared")) / "models"
DIELECTRIC = 0.04


def true_scene(path: Path, capture: Capture) -> Scene:
    """The rendered scene in the world of `capture`, under the light of its split."""
    material = avocado() if path.name == "avocado" else spot()
    assert capture.environment is not None
    light = load_light(capture.environment, capture.world_from_source)
    return Scene(textured_mesh(path, capture.world_from_source), material, light)


def textured_mesh(path: Path, world_from_source: Array) -> Mesh:
    """`reference.obj` with its texture coordinates; equal positions are one vertex, so that normals are smooth."""
    import trimesh

    loaded = cast(Any, trimesh.load(path / TRUE_MESH, process=False, force="mesh"))
    moved = np.asarray(loaded.vertices) @ world_from_source[:3, :3].T + world_from_source[:3, 3]
    unique_positions, vertex = np.unique(moved.round(6), axis=0, return_inverse=True)
    corners = np.asarray(loaded.faces, np.int64)
    uvs = np.asarray(loaded.visual.uv, np.float32) * [1, -1] + [0, 1]
    topology = Topology(torch.from_numpy(vertex.reshape(-1)[corners]), torch.from_numpy(corners))
    return Mesh(_tensor(unique_positions), topology, _tensor(uvs))


def spot() -> Material:
    """A texture of albedo, glTF's roughness .3."""
    albedo = _linear(MODELS / "spot" / "spot_texture.png")
    return Material("dielectric", albedo, torch.full((3,), DIELECTRIC), torch.tensor([0.3**2]))


def avocado() -> Material:
    """Textures of albedo, roughness, metalness and normals."""
    folder = MODELS / "avocado" / "glTF"
    found = read_ldr(folder / "Avocado_roughnessMetallic.png")
    roughness, metal = _tensor(found[..., 1:2]), _tensor(found[..., 2:3])
    color = _linear(folder / "Avocado_baseColor.png")
    normal = _tensor(2 * read_ldr(folder / "Avocado_normal.png")[..., :3] - 1)
    return Material(
        "dielectric",
        color * (1 - metal),
        DIELECTRIC * (1 - metal) + color * metal,
        roughness.square().clamp_min(1e-3),
        torch.nn.functional.normalize(normal, dim=-1),
    )


def _linear(path: Path) -> torch.Tensor:
    return _tensor(np.asarray(srgb_to_linear(read_ldr(path)[..., :3])))


def _tensor(values: NDArray[Any]) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(values, dtype=np.float32))
