"""The error of each term of three.js' published formula on the metal object: `python -m parity.costs`.

Surface points in four views, directions and light are those of our own model (`hir_exporters.engines.surface_points`):
each row differs from it only in the term that it names. PSNR in dB, sRGB.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.engines.engine_shaders import MaterialSamples, three
from hir_exporters.engines.surface_points import surface_points
from hir_exporters.materials.brdf_slice import model_brdf
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.materials.surfaces import MetallicSurface
from hir_exporters.textures.texture_maps import sample_texels
from numpy.typing import NDArray

from parity.scenes import metal_egg

Array = NDArray[np.float64]


def rows(light: Path) -> list[str]:
    """Lines of the table in docs/engines/threejs.md."""
    asset = metal_egg(light).asset
    surface, points = to_gltf(asset.material, "khr"), surface_points(asset)
    assert isinstance(surface, MetallicSurface)
    texels = MaterialSamples(points, surface, None)
    specular = sample_texels(asset.material.specular_albedo, True, points.uvs)
    reference = _encoded(points.shade(model_brdf(points.slices, "dielectric", 0 * specular, specular)))

    f0, schlick = texels.base, points.slices.schlick[..., None]
    a, b = points.lobe_terms()
    correlated = points.shade(
        (f0[:, None, None] + (1 - f0[:, None, None]) * schlick) * points.correlated_lobe[..., None]
    )
    single, lost, mean = f0 * a + b, 1 - (a + b), f0 + (1 - f0) / 21
    returned = single * mean / (1 - lost * mean) * lost * points.irradiance_over_pi()
    bend = texels.roughness**4
    toward = (1 - bend) * points.reflected + bend * points.normals
    toward /= np.linalg.norm(toward, axis=-1, keepdims=True)
    prefiltered = points.prefiltered(toward, texels.roughness[:, 0] ** 2) * single
    pictures = {
        "height-correlated G": correlated,
        "the same, and light that bounces inside the lobe": correlated + returned,
        "height-correlated G, light prefiltered for n = v = r": prefiltered,
        "all of it": three(points, texels),
    }
    return [
        f"| {name} | {-10 * np.log10(np.mean((_encoded(p) - reference) ** 2)):.1f} |" for name, p in pictures.items()
    ]


def _encoded(linear: Array) -> Array:
    return np.asarray(linear_to_srgb(np.clip(linear, 0, 1)), np.float64)


if __name__ == "__main__":
    print("\n".join(rows(Path(os.environ["HIR_SHARED"]) / "envmaps" / "studio.hdr")))
