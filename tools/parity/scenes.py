"""The objects of the table: two finished runs, and a metal and a mixed object made here."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.light.environment_map import resample_latlong
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.scene_format import load_scene
from hir_exporters.textures.image_files import read_hdr

MODELS: Final = {"spot": "spot/spot.obj", "avocado": "avocado/glTF/Avocado.gltf"}
"""What the captures of these names were rendered from, in the shared data's folder of models."""

GOLD, COPPER, IRON = (1.0, 0.766, 0.336), (0.955, 0.638, 0.538), (0.56, 0.57, 0.58)
"""Reflectance at normal incidence, linear (Akenine-Möller et al., Real-Time Rendering, table 9.2)."""


@dataclass(frozen=True)
class Subject:
    """An asset to show, and how often light is reflected between its parts in our render of it."""

    name: str
    asset: Asset
    bounces: int | None
    origin: str
    """Where it comes from, in a word or two."""


def finished_run(name: str, folder: Path) -> Subject:
    """A run as it was fitted: its report's pictures have the reflections that its model has."""
    bounces = None
    for file in folder.glob("stages/*-reflectance/stage.json"):
        bounces = json.loads(file.read_text(encoding="utf-8"))["report"].get("bounces")
    return Subject(name, load_scene(folder / "scene"), bounces, "a run")


def model(name: str, file: Path, light: Path) -> Subject:
    """A modelled mesh with its textures, as `hir export MESH` takes it, under a lat-long .hdr."""
    return Subject(name, replace(load_mesh_asset(file), environment=_studio(light), name=name), None, "a model")


def metal_egg(light: Path) -> Subject:
    """Gold, copper and iron in bands, from polished to brushed, under a lat-long .hdr.

    Convex: real-time engines show no reflections of an object in itself, and this one has none.
    """
    v, u = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(512) + 0.5) / 512, indexing="ij")
    bands = np.floor(u * 6 + 0.35 * np.sin(4 * np.pi * v)).astype(int) % 3
    color = np.array([GOLD, COPPER, IRON], np.float32)[bands]
    alpha = 0.08 + 0.42 * (0.5 - 0.5 * np.cos(6 * np.pi * v)) * (0.6 + 0.4 * np.sin(4 * np.pi * u))
    material = AssetMaterial.metallic(color, 1.0, np.maximum(alpha, 0.05))
    return Subject("metal", Asset(_egg(), material, _studio(light), name="metal"), None, "made by hand")


def mixed_egg(light: Path) -> Subject:
    """Bands of brushed iron and of red and white plastic, under a lat-long .hdr: metalness is a texture."""
    v, u = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(512) + 0.5) / 512, indexing="ij")
    bands = np.floor(u * 6 + 0.35 * np.sin(4 * np.pi * v)).astype(int) % 3
    color = np.array([IRON, (0.5, 0.05, 0.04), (0.7, 0.68, 0.62)], np.float32)[bands]
    alpha = np.array([0.2, 0.12, 0.3], np.float32)[bands]
    material = AssetMaterial.metallic(color, (bands == 0).astype(np.float32), alpha)
    return Subject("mixed", Asset(_egg(), material, _studio(light), name="mixed"), None, "made by hand")


def with_light(subject: Subject, hdr: Path) -> Asset:
    """The asset under the light as it was written: as for every engine."""
    return replace(subject.asset, environment=AssetEnvironment(np.maximum(read_hdr(hdr), 0)))


def _studio(light: Path) -> AssetEnvironment:
    radiance = resample_latlong(read_hdr(light), 128, 256).astype(np.float32)
    return AssetEnvironment(radiance * (0.35 / radiance.mean()))  # so that little of a picture is clipped


def _egg(rows: int = 160, columns: int = 320) -> AssetMesh:
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    polar, azimuth = np.pi * v, 2 * np.pi * u
    sphere = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], axis=-1)
    axes = np.array([0.75, 1.0, 0.75])
    normals = sphere / axes
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    corner = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)
    a, b, c, d = corner, corner + columns + 1, corner + columns + 2, corner + 1
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    a, b, c = (sphere * axes).reshape(-1, 3)[faces].transpose(1, 0, 2)
    # at the poles every other triangle has no area
    faces = faces[np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-9]
    used, faces = np.unique(faces, return_inverse=True)
    return AssetMesh(
        (sphere * axes).reshape(-1, 3)[used],
        normals.reshape(-1, 3)[used],
        np.stack([u, v], -1).reshape(-1, 2)[used],
        faces.reshape(-1, 3),
    )
