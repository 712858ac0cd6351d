"""Renders the thumbnail of an asset in its own light: a PNG with a transparent background."""

from __future__ import annotations

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset
from hir_exporters.content_cache import ContentCache, asset_key
from hir_exporters.conventions import latlong_directions, linear_to_srgb
from hir_exporters.light.environment_map import resample_latlong, rotate_latlong, world_radiance
from hir_exporters.materials.texture_packing import limit_texture_sizes
from hir_exporters.mesh.normal_mapping import mapped_normals
from hir_exporters.textures.image_files import encode_png
from hir_exporters.textures.texture_maps import sample_texels
from hir_exporters.thumbnail.image_based_shading import (
    PrefilteredLight,
    ShadedPoints,
    irradiance_over_pi,
    prefiltered_light,
    shaded,
)
from hir_exporters.thumbnail.object_view import ObjectView, camera_to_world, object_view

Array = NDArray[np.float64]

SIDE: Final = 512
"""Pixels."""

_SAMPLES: Final = 2
"""Per pixel and axis."""

_MAX_LIGHT_ROWS: Final = 256

_WHITE: Final = 0.9
"""Linear value of a white diffuse surface where the object is lit best (`_PERCENTILE`)."""

_PERCENTILE: Final = 95

_EXPOSURE_STEP: Final = 16
"""Every such pixel decides on the exposure."""

_CACHE: Final = ContentCache[bytes](1)


def thumbnail_png(asset: Asset) -> bytes:
    """The file of a valid asset, rendered once for several formats.

    `asset` is the one to export, before a format reduces it. A light that moves with the camera is that of this
    picture's camera; an asset without light is shown under a bright sky.
    """
    return _CACHE.get(asset_key(asset), lambda: encode_png(render_thumbnail(asset)))


def thumbnail_file(destination: Path) -> Path:
    """The picture beside an exported file; one for all formats, whose content is the same."""
    return destination.with_name(f"{destination.stem}_thumbnail.png")


def render_thumbnail(asset: Asset) -> NDArray[np.uint8]:
    """sRGB and alpha (SIDE, SIDE, 4), 8 bits, not premultiplied."""
    fine = SIDE * _SAMPLES
    view = object_view(asset.mesh, fine)
    premultiplied = np.zeros((fine * fine, 4))
    if len(view.pixels):
        premultiplied[view.pixels, :3] = _exposed_colors(asset, view)
        premultiplied[view.pixels, 3] = 1
    mean = premultiplied.reshape(SIDE, _SAMPLES, SIDE, _SAMPLES, 4).mean(axis=(1, 3))
    color = linear_to_srgb(mean[..., :3] / np.maximum(mean[..., 3:], 1e-9))
    picture = np.concatenate([np.where(mean[..., 3:] > 0, color, 0), mean[..., 3:]], axis=-1)
    return (picture * 255 + 0.5).astype(np.uint8)


def _exposed_colors(asset: Asset, view: ObjectView) -> Array:
    """Linear colours (N, 3) in [0, 1]. The exposure depends on the light alone, so that dark objects stay dark."""
    light = prefiltered_light(_radiance(asset))
    material = limit_texture_sizes(asset.material, SIDE * _SAMPLES)
    normals = view.normals
    if material.normal is not None:
        normals = mapped_normals(asset.mesh, material.normal, view.corners, normals, view.uvs)
    points = ShadedPoints(
        material.model,
        sample_texels(material.diffuse_albedo, True, view.uvs),
        sample_texels(material.specular_albedo, True, view.uvs),
        sample_texels(material.roughness, False, view.uvs),
        normals,
        view.views,
    )
    return np.clip(_exposure(view, light) * shaded(points, light), 0, 1)


def _exposure(view: ObjectView, light: PrefilteredLight) -> float:
    white = np.percentile(irradiance_over_pi(view.normals[::_EXPOSURE_STEP], light).max(axis=1), _PERCENTILE)
    return _WHITE / float(white) if white > 0 else 0.0


def _radiance(asset: Asset) -> NDArray[np.floating]:
    """The light (H, 2H, 3) in world axes, of at most `_MAX_LIGHT_ROWS` rows."""
    environment = asset.environment
    if environment is None:
        directions = latlong_directions(16, 32)
        return (0.6 + 0.5 * directions[..., 1:2] + 0.2 * directions[..., 2:3]).repeat(3, axis=-1).clip(0.05)
    rows, columns = environment.radiance.shape[:2]
    rows = min(max(rows, -(-columns // 2)), _MAX_LIGHT_ROWS)
    if environment.frame == "camera":
        small = resample_latlong(environment.radiance, rows, 2 * rows)
        return rotate_latlong(small, camera_to_world() @ environment.to_world)
    return world_radiance(asset, rows)[0]
