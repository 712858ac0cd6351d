"""The material of a fit whose texels have lobes of their own, and the light that it needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_core.scene import Material, Mesh, Scene
from hir_core.stages.atlas import TexelSurface, dilate, fill_unobserved, texel_surface
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import Photographed, photographed
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import ALPHA_LOW, Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import bent
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit import PointValues
from hir_plugins.reflectance_renderers.transport_ggx.textures.light_refit import some_pixels, with_fitted_light
from hir_plugins.reflectance_renderers.transport_ggx.textures.normal_map import normal_map
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import (
    FEWEST_SIGHTS,
    LitSurface,
    pixel_values,
    texel_values,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import TexelEquations, solve_texels
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import (
    gain_and_lobe,
    irradiance_at,
    received,
    sample,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_solve import (
    HUBER_SRGB,
    PADDING,
    PRIOR,
    SMOOTH,
    refined_mesh,
    texel_equations,
    texture_size,
)


def solve_lobe_maps(
    lit: LitSurface,
    scene: Scene,
    pixels: Photographed,
    downsample: int,
    options: TransportGGXOptions,
    report: Callable[[float], None],
) -> tuple[Material, Unknowns, list[TexelEquations], dict[str, Any]]:
    """Maps of albedo, ρs, α and normal at the size of the scene's texture, the unknowns with the light they go with,
    and what the albedo was solved from; texels that too few photographs see are filled from those around.

    The light is fitted again to `pixels`, first under their own values, then under the maps; last the albedo is solved
    from what whole pixels show of the maps, for a texel's own photographs are looked up between blurred pixels.
    """
    assert scene.material is not None
    transport = lit.transport
    mesh = refined_mesh(transport.surface)
    texels = texel_surface(mesh, texture_size(scene.material))
    if not options.known_light:
        pixels = some_pixels(pixels, options.seed)
        with torch.no_grad():
            values = pixel_values(lit, pixels)
        lit = with_fitted_light(lit, pixels, values, options)
        report(0.2)
    with torch.no_grad():
        values, count = texel_values(lit, texels, lambda share: report(0.2 + 0.4 * share))
        maps = _Maps.of(values, count >= FEWEST_SIGHTS, mesh, texels)
    if not options.known_light:
        lit = with_fitted_light(lit, pixels, maps.at(pixels.points.uvs(transport.surface)), options)
    report(0.7)
    with torch.no_grad():
        equations = _equations(lit, maps, downsample, options, lambda share: report(0.7 + 0.25 * share))
        albedo = solve_texels(equations, maps.albedo, HUBER_SRGB, PRIOR, SMOOTH)[0] if equations else maps.albedo
        material = Material(
            model=lit.model,
            diffuse_albedo=dilate(fill_unobserved(albedo, mesh, maps.told, texels), texels.covered, PADDING),
            specular_albedo=maps.specular,
            roughness=maps.alpha,
            normal=normal_map(scene.mesh, maps.tilt, PADDING),
            observed=maps.told,
        )
    report(1.0)
    facts: dict[str, Any] = {
        "texels": int(texels.covered.sum()),
        "sightings": int(count.sum()),
        "observed": round(int(maps.told.sum()) / max(int(texels.covered.sum()), 1), 4),
    }
    if lit.unknowns.exposure is not None:
        facts["view_gain"] = [round(float(e), 4) for e in lit.unknowns.exposure]
    return material, lit.unknowns, equations, facts


@dataclass(frozen=True, eq=False)
class _Maps:
    """Values of texels as images."""

    albedo: Float[Tensor, "H W 3"]
    specular: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W 1"]
    tilt: Float[Tensor, "H W 3"]
    told: Bool[Tensor, "H W"]
    """Texels that enough photographs tell of."""

    @classmethod
    def of(cls, values: PointValues, known: Bool[Tensor, " N"], mesh: Mesh, texels: TexelSurface) -> _Maps:
        told = torch.zeros_like(texels.covered)
        told[texels.covered] = known

        def image(found: Float[Tensor, "N C"]) -> Float[Tensor, "H W C"]:
            texture = found.new_zeros(*texels.covered.shape, found.shape[1])
            texture[texels.covered] = found
            return dilate(fill_unobserved(texture, mesh, told, texels), texels.covered, PADDING)

        albedo, specular, alpha, tilt = (image(found) for found in values.all())
        return cls(albedo, specular, alpha, tilt, told)

    def at(self, uv: Float[Tensor, "P 2"]) -> PointValues:
        """What the maps hold at points."""
        return PointValues(*(sample(image, uv) for image in (self.albedo, self.specular, self.alpha, self.tilt)))


def _equations(
    lit: LitSurface, maps: _Maps, downsample: int, options: TransportGGXOptions, report: Callable[[float], None]
) -> list[TexelEquations]:
    """What pixels say of the albedo, under the lobes of the maps."""
    transport, capture = lit.transport, lit.pictures.capture
    equations = []
    most = max(64, options.texture_pixels // max(len(lit.views), 1))
    for done, view in enumerate(lit.views):
        part = photographed(transport, capture, view, most, downsample, options.seed + 1)
        if not len(part):
            continue
        values = maps.at(part.points.uvs(transport.surface))
        points, alpha = part.points.bent(bent(part.points.normal, values.tilt)), values.alpha.clamp(ALPHA_LOW, 1)
        arriving = irradiance_at(transport, points, part.points.normal, lit.irradiance, lit.vectors)
        lobes = transport.lobes(points, alpha, options.texture_samples, None, options.seed)
        gathered = received(lobes, alpha, lit.sources)
        gain, lobe = gain_and_lobe(lit.model, values.specular, alpha, arriving, lobes, gathered)
        size = (int(maps.albedo.shape[0]), int(maps.albedo.shape[1]))
        equations.append(texel_equations(transport, part, gain, lobe, lit.unknowns.exposure, size))
        report((done + 1) / len(lit.views))
    return equations
