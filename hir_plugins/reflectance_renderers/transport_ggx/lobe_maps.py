"""The material of a fit whose texels have lobes of their own."""
# ruff: noqa: TID253

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.atlas import dilate, fill_unobserved, texel_surface
from hir_core.scene import Material, Scene
from hir_plugins.reflectance_renderers.transport_ggx.normal_map import normal_map
from hir_plugins.reflectance_renderers.transport_ggx.texel_lobes import FEWEST_SIGHTS, LitSurface, texel_values
from hir_plugins.reflectance_renderers.transport_ggx.texture_stage import PADDING, refined_mesh, texture_size


def solve_lobe_maps(lit: LitSurface, scene: Scene, report: Callable[[float], None]) -> tuple[Material, dict[str, Any]]:
    """Maps of albedo, ρs, α and normal at the size of the scene's texture; texels that too few photographs see are
    filled from those around.
    """
    assert scene.material is not None
    mesh = refined_mesh(lit.transport.surface)
    texels = texel_surface(mesh, texture_size(scene.material))
    with torch.no_grad():
        values, count = texel_values(lit, texels, lambda share: report(0.9 * share))
        told = torch.zeros_like(texels.covered)
        told[texels.covered] = count >= FEWEST_SIGHTS

        def image(found: Float[Tensor, "N C"]) -> Float[Tensor, "H W C"]:
            texture = found.new_zeros(*texels.covered.shape, found.shape[1])
            texture[texels.covered] = found
            return dilate(fill_unobserved(texture, mesh, told, texels), texels.covered, PADDING)

        material = Material(
            model="paper" if lit.rung.brdf == "paper" else "dielectric",
            diffuse_albedo=image(values.albedo),
            specular_albedo=image(values.specular),
            roughness=image(values.alpha),
            normal=normal_map(scene.mesh, image(values.tilt), PADDING),
            observed=told,
        )
    report(1.0)
    facts: dict[str, Any] = {
        "texels": int(texels.covered.sum()),
        "sightings": int(count.sum()),
        "observed": round(int(told.sum()) / max(int(texels.covered.sum()), 1), 4),
    }
    if lit.unknowns.exposure is not None:
        facts["view_gain"] = [round(float(e), 4) for e in lit.unknowns.exposure]
    return material, facts
