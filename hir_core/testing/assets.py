"""Small assets that exporters are tried on; numpy only."""

from __future__ import annotations

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from numpy.typing import NDArray

SIDE = 16


def ball(rings: int = 6, segments: int = 10) -> AssetMesh:
    """A sphere with a seam: one vertex for each pair of position and texture coordinate."""
    v, u = np.meshgrid(np.linspace(0, 1, rings + 1), np.linspace(0, 1, segments + 1), indexing="ij")
    polar, azimuth = v * np.pi, u * 2 * np.pi
    normals = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1)
    normals[:, -1] = normals[:, 0]
    index = np.arange((rings + 1) * (segments + 1)).reshape(rings + 1, segments + 1)
    a, b, c, d = (i.ravel() for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    positions = (normals * [0.5, 1.0, 0.7]).reshape(-1, 3)
    p = positions[faces]
    faces = faces[np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) > 1e-9]
    used, faces = np.unique(faces, return_inverse=True)
    unit = normals.reshape(-1, 3)[used] / np.array([0.5, 1.0, 0.7])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    uvs = np.stack([u, v], -1).reshape(-1, 2)[used]
    return AssetMesh(positions[used], unit, uvs, faces.reshape(-1, 3).astype(np.int32))


def waves(channels: int, low: float, high: float, seed: int) -> NDArray[np.float32]:
    """(SIDE, SIDE, channels) of slow waves."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:SIDE, :SIDE] / SIDE * 2 * np.pi
    parts = [
        np.sin(random.integers(1, 3) * x + random.integers(1, 3) * y + random.uniform(0, 6)) for _ in range(channels)
    ]
    return (low + (high - low) * (np.stack(parts, -1) + 1) / 2).astype(np.float32)


def textured_asset() -> Asset:
    """All maps, and a light with a colour of its own in every texel."""
    slope = waves(2, -0.4, 0.4, 3)
    normal = np.concatenate([slope, np.ones((SIDE, SIDE, 1), np.float32)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    material = AssetMaterial(
        "dielectric",
        waves(3, 0.1, 0.8, 0),
        waves(3, 0.02, 0.08, 1),
        waves(1, 0.05, 0.5, 2)[..., 0],
        normal,
        np.ones((SIDE, SIDE), dtype=bool),
    )
    light = AssetEnvironment(np.random.default_rng(4).uniform(0.1, 4.0, (8, 16, 3)).astype(np.float32))
    return Asset(ball(), material, light, {"generator": "contract tests"}, "ball")


def constant_asset() -> Asset:
    """No texture, no light, a name that is hard on file formats."""
    diffuse, specular = (np.array(color, np.float32) for color in ([0.5, 0.4, 0.3], [0.2, 0.2, 0.2]))
    material = AssetMaterial("paper", diffuse, specular, np.array(0.25, np.float32))
    return Asset(ball(), material, name="a ball, “blue” & new")
