"""The material of a fit with per-texel BRDFs, and its light."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from hir_core.mesh.texel_rasterization import TexelSurface, dilate, texel_surface
from hir_core.mesh.texture_inpainting import fill_unobserved
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_terms import FitTerms
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import (
    ObservedPixels,
    observe_pixels,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import refined_mesh
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import PointBrdfs
from hir_plugins.reflectance_renderers.transport_ggx.textures.light_refit import light_pixels, refit_light
from hir_plugins.reflectance_renderers.transport_ggx.textures.metallic_equations import metallic_equations
from hir_plugins.reflectance_renderers.transport_ggx.textures.normal_map import normal_map
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import (
    MIN_OBSERVATIONS,
    LitSurface,
    pixel_brdfs,
    texel_brdfs,
)
from hir_plugins.reflectance_renderers.transport_ggx.textures.shaded_points import ShadedPoints
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import TexelEquations, solve_texels
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import sample
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_solve import (
    PADDING_TEXELS,
    TEXEL_HUBER_SRGB,
    TEXEL_PRIOR_WEIGHT,
    TEXEL_SMOOTHNESS_WEIGHT,
    TextureReport,
    texel_equations,
    texture_size,
)


def solve_per_texel_maps(
    lit: LitSurface,
    scene: Scene,
    pixels: ObservedPixels,
    downsample: int,
    options: TransportGGXOptions,
    report: Callable[[float], None],
    terms: FitTerms | None = None,
) -> tuple[Material, Parameters, list[TexelEquations], TextureReport]:
    """Maps of albedo, ρs, α and normal at the size of the scene's texture, the parameters with their light, the
    equations of the albedo, and a report. Texels with too few photographs are inpainted.

    The light is fitted again to `pixels`, first with their own BRDFs, then with the maps. Last the albedo is solved
    from the radiance of whole pixels, because lookups between pixels blur the photographs; `terms` have their say in
    this albedo alone.
    """
    assert scene.material is not None
    transport = lit.transport
    mesh = refined_mesh(transport.surface)
    texels = texel_surface(mesh, texture_size(scene.material))
    if not lit.spec.light_is_known:
        pixels = light_pixels(pixels, options.seed)
        with torch.no_grad():
            values = pixel_brdfs(lit, pixels)
        lit = refit_light(lit, pixels, values, options)
        report(0.2)
    with torch.no_grad():
        values, count = texel_brdfs(lit, texels, lambda share: report(0.2 + 0.4 * share))
        maps = _Maps.of(values, count >= MIN_OBSERVATIONS, mesh, texels)
    if not lit.spec.light_is_known:
        lit = refit_light(lit, pixels, maps.at(pixels.points.uvs(transport.surface)), options)
    report(0.7)
    with torch.no_grad():
        equations = _equations(lit, maps, downsample, options, lambda share: report(0.7 + 0.25 * share))
        metallic = lit.model == "metallic"
        start, metalness = (maps.base_color(lit.dielectric_f0), maps.metalness) if metallic else (maps.albedo, None)
        metal = maps.metalness if lit.spec.metalness == "map" else torch.ones_like(maps.metalness[0, 0])

        def material_of(texture: Tensor, normal: Tensor | None = None) -> Material:
            if metallic:
                return Material.metallic(texture, metal, maps.alpha, normal, maps.observed, lit.dielectric_f0)
            return Material(lit.model, texture, maps.specular, maps.alpha, normal, maps.observed)

        shown = Scene(scene.mesh, material_of(start), EnvironmentMap(transport.lights(lit.parameters.radiance)[0]))
        refiner = None if terms is None else terms.of_textures(shown, TEXEL_HUBER_SRGB)
        weights = TEXEL_HUBER_SRGB, TEXEL_PRIOR_WEIGHT, TEXEL_SMOOTHNESS_WEIGHT
        solved = solve_texels(equations, start, *weights, metalness, refiner)[0] if equations else start
        texture = dilate(fill_unobserved(solved, mesh, maps.observed, texels), texels.covered, PADDING_TEXELS)
        material = material_of(texture, normal_map(scene.mesh, maps.normal_offset, PADDING_TEXELS))
    report(1.0)
    report_values: TextureReport = {
        "texels": int(texels.covered.sum()),
        "observations": int(count.sum()),
        "observed": round(int(maps.observed.sum()) / max(int(texels.covered.sum()), 1), 4),
    }
    return material, lit.parameters, equations, report_values


@dataclass(frozen=True, eq=False)
class _Maps:
    """The BRDFs of texels as images."""

    albedo: Float[Tensor, "H W 3"]
    specular: Float[Tensor, "H W 3"]
    alpha: Float[Tensor, "H W 1"]
    normal_offset: Float[Tensor, "H W 3"]
    metalness: Float[Tensor, "H W 1"]
    observed: Bool[Tensor, "H W"]
    """Texels with enough photographs."""

    def base_color(self, f0: float) -> Float[Tensor, "H W 3"]:
        """Of the `metallic` BRDF."""
        return (self.albedo + self.specular - (1 - self.metalness) * f0).clamp(0, 1)

    @classmethod
    def of(cls, values: PointBrdfs, known: Bool[Tensor, " N"], mesh: Mesh, texels: TexelSurface) -> _Maps:
        observed = torch.zeros_like(texels.covered)
        observed[texels.covered] = known

        def image(rows: Float[Tensor, "N C"]) -> Float[Tensor, "H W C"]:
            texture = rows.new_zeros(*texels.covered.shape, rows.shape[1])
            texture[texels.covered] = rows
            return dilate(fill_unobserved(texture, mesh, observed, texels), texels.covered, PADDING_TEXELS)

        albedo, specular, alpha, normal_offset, metalness = (image(rows) for rows in values.all())
        return cls(albedo, specular, alpha, normal_offset, metalness, observed)

    def at(self, uv: Float[Tensor, "P 2"]) -> PointBrdfs:
        """The values of the maps at texture coordinates."""
        images = self.albedo, self.specular, self.alpha, self.normal_offset, self.metalness
        return PointBrdfs(*(sample(image, uv) for image in images))


def _equations(
    lit: LitSurface, maps: _Maps, downsample: int, options: TransportGGXOptions, report: Callable[[float], None]
) -> list[TexelEquations]:
    """The equations of the albedo from pixels, for the lobes of the maps."""
    transport, capture = lit.transport, lit.images.capture
    equations = []
    max_pixels = max(64, options.texture_pixels // max(len(lit.views), 1))
    for done, view in enumerate(lit.views):
        part = observe_pixels(transport, capture, view, max_pixels, downsample, options.seed + 1)
        if not len(part):
            continue
        values = maps.at(part.points.uvs(transport.surface))
        shaded = ShadedPoints.of(lit, part.points, values, options.texture_samples, options.seed)
        size = (int(maps.albedo.shape[0]), int(maps.albedo.shape[1]))
        rows = texel_equations(transport, part, shaded.gain, shaded.lobe, lit.parameters.exposure, size)
        if lit.model == "metallic":
            base, f0 = maps.base_color(lit.dielectric_f0), lit.dielectric_f0
            rows = metallic_equations(
                rows, base, maps.metalness, f0, shaded.arriving, shaded.lobes, shaded.alpha, shaded.received
            )
        equations.append(rows)
        report((done + 1) / len(lit.views))
    return equations
