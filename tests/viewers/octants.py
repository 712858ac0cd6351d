"""An asset that looks different from every side, in a mirror and with its channels swapped."""

from __future__ import annotations

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.conventions import latlong_directions, srgb_to_linear


def ellipsoid(rows: int = 48, columns: int = 96) -> AssetMesh:
    """Convex, so that no shadow falls on it (three.js casts none from a panorama), and different along each axis."""
    v, u = np.meshgrid(np.linspace(0, 1, rows + 1), np.linspace(0, 1, columns + 1), indexing="ij")
    polar, azimuth = np.pi * v, 2 * np.pi * u
    sphere = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], axis=-1)
    axes = np.array([0.9, 0.6, 0.7])
    normals = sphere / axes
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    corner = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)
    a, b, c, d = corner, corner + columns + 1, corner + columns + 2, corner + 1
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return AssetMesh((sphere * axes).reshape(-1, 3), normals.reshape(-1, 3), np.stack([u, v], -1).reshape(-1, 2), faces)


def asset() -> Asset:
    """Eight colours in the eight octants, under a light that is bright above and to one side, and not grey."""
    v, u = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(128) + 0.5) / 128, indexing="ij")
    octant = (v > 0.5) * 4 + np.floor(u * 4)
    reds = [0.8, 0.2, 0.2, 0.8, 0.7, 0.2, 0.9, 0.4]
    greens = [0.2, 0.7, 0.3, 0.7, 0.2, 0.7, 0.5, 0.4]
    blues = [0.2, 0.2, 0.8, 0.2, 0.7, 0.7, 0.2, 0.4]
    colours = srgb_to_linear(np.stack([reds, greens, blues], axis=-1))
    texture = colours[octant.astype(int)]
    directions = latlong_directions(64, 128)
    brightness = 0.25 + 0.35 * (1 + directions @ np.array([0.5, 0.7, 0.2]))
    tint = 1 + 0.3 * directions @ np.array([[1.0, 0, -1], [0, 0, 0], [0, 1, 0]])
    material = AssetMaterial("paper", texture, np.zeros(3), np.array(1.0))
    return Asset(ellipsoid(), material, AssetEnvironment(brightness[..., None] * tint), name="octants")
