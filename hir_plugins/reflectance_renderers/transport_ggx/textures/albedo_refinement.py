"""Path-traced albedo refinement: removes the approximations of the cached transport from the diffuse albedo, or from
the base colour of `metallic`.

A path tracer is unbiased but slow and noisy. It renders the pixels that the textures were solved from once. How a pixel
changes with its albedo is taken from the cached transport. The noise enters the equations where the photographs' does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from hir_core.mesh.texel_rasterization import dilate, texel_surface
from hir_core.mesh.texture_inpainting import fill_unobserved
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.run.determinism import folded_seed
from hir_core.scene import Material, Scene
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_terms import FitTerms
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface, refined_mesh
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import TexelEquations, solve_texels
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_solve import (
    PADDING_TEXELS,
    TEXEL_HUBER_SRGB,
    TEXEL_PRIOR_WEIGHT,
    TEXEL_SMOOTHNESS_WEIGHT,
)


@dataclass(eq=False)
class AlbedoRefinement:
    """The equations that the albedo of a scene was solved from, view by view, with a cache of path-traced radiance."""

    equations: list[TexelEquations]
    seed: int = 0
    """Of the noise of the path tracer; each view has its own."""
    terms: FitTerms | None = None
    """Regularizers that have their say in the albedo."""
    takes: Sequence[str] = ()
    """The take of each view; needed where the scene has the lights of several."""
    _cache: dict[int, Tensor] = field(default_factory=dict)
    """Path-traced radiance of each view's pixels, of `_cached`."""
    _cached: tuple[PreparedReflectance, Scene] | None = None

    def refined(
        self,
        scene: Scene,
        surface: Surface,
        traced: PreparedReflectance | None,
        views: Sequence[int],
        report: Callable[[float], None],
    ) -> Scene | None:
        """The scene with the albedo that fits the pixels of `views` under the radiance of `traced`; None where there
        are no such pixels, or no albedo texture.
        """
        material, allowed = scene.material, set(views)
        parts = [e for e in self.equations if len(e.pixel) and int(e.pixel[0, 0]) in allowed]
        if material is None or material.diffuse_albedo.ndim != 3 or material.observed is None or not parts:
            return None
        albedo, metalness = solved_texture(material)
        with torch.no_grad():
            rows = []
            for done, part in enumerate(parts):
                rows.append(part if traced is None else self._corrected(part, scene, traced, albedo, metalness))
                report(0.9 * (done + 1) / len(parts))
            refiner = None if self.terms is None else self.terms.of_textures(scene, TEXEL_HUBER_SRGB)
            weights = TEXEL_HUBER_SRGB, TEXEL_PRIOR_WEIGHT, TEXEL_SMOOTHNESS_WEIGHT
            found, _ = solve_texels(rows, albedo, *weights, metalness, refiner)
            mesh = refined_mesh(surface)
            texels = texel_surface(mesh, (albedo.shape[0], albedo.shape[1]))
            filled = fill_unobserved(found, mesh, material.observed, texels)
            albedo = dilate(filled, texels.covered, PADDING_TEXELS)
        report(1.0)
        return replace(scene, material=with_solved_texture(material, albedo))

    def _corrected(
        self,
        rows: TexelEquations,
        scene: Scene,
        traced: PreparedReflectance,
        albedo: Tensor,
        metalness: Tensor | None,
    ) -> TexelEquations:
        """The same rows, whose constant part is what remains of the path-traced radiance without the albedo's part."""
        view = int(rows.pixel[0, 0])
        if self._cached is None or self._cached[0] is not traced or self._cached[1] is not scene:
            self._cached, self._cache = (traced, scene), {}
        if view not in self._cache:
            assert scene.material is not None and scene.environment is not None
            torch.manual_seed(folded_seed(view + (self.seed << 32)))
            light = scene.in_take(self.takes[view]).environment if self.takes else scene.environment
            assert light is not None
            radiance = traced.radiance(scene.material, light, rows.pixel.long())
            # one non-finite pixel would reach every texel through conjugate gradients; this one asks for no change
            self._cache[view] = torch.where(torch.isfinite(radiance), radiance, rows.color)
        return replace(rows, offset=self._cache[view] - rows.radiance(albedo, metalness))


def solved_texture(material: Material) -> tuple[Tensor, Tensor | None]:
    """The texture that the equations solve, (H, W, 3), and the metalness (H, W, 1) of a `metallic` material."""
    if material.metalness is None:
        return material.diffuse_albedo, None
    base = material.base_color
    return base, material.metalness.expand(base.shape[0], base.shape[1], 1)


def with_solved_texture(material: Material, texture: Tensor) -> Material:
    """The material with another diffuse albedo, or with another base colour if it is `metallic`."""
    if material.metalness is None:
        return replace(material, diffuse_albedo=texture)
    return Material.metallic(
        texture, material.metalness, material.roughness, material.normal, material.observed, material.dielectric_f0
    )
