"""The last step of a fit: albedos in closed form, under the light and the lobes that gradient steps found.

A few dozen steps from one albedo for all bring the light near, and leave dark spots too bright: a logistic moves
slowly at its ends. The problem is bilinear, so what is left of the albedos is a least-squares problem.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import torch

from hir_core.scene.srgb import srgb_slope, srgb_to_linear
from hir_plugins.reflectance_renderers.transport_ggx.fit.closed_form_albedo import AlbedoEquations, solve_albedo
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.fit.pixel_batches import Block, gain_and_lobe
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_radiance import SpecularBlock

HUBER_SRGB = 0.1
PRIOR = 0.05
"""Hold on the albedo of the gradient steps, of the weight that a vertex's pixels have on average: few see each."""
DARKEST = 0.003
"""Linear value below which the sRGB weight stops growing: noise rules there."""
ALBEDO_LOW, ALBEDO_HIGH = 1e-3, 0.999
"""Of a logistic that can still move."""


def with_solved_albedo(
    transport: Transport, blocks: Iterable[tuple[Block, SpecularBlock | None]], unknowns: Unknowns, bounces: int
) -> Unknowns:
    """The unknowns with the albedos `solved` that the pixels of `blocks` ask for; their matrices as `refresh` left
    them.
    """
    with torch.no_grad():
        rows = [_equations(transport, block, matrices, unknowns, bounces) for block, matrices in blocks]
        albedo, _, _ = solve_albedo(rows, unknowns.diffuse_albedo, HUBER_SRGB, PRIOR)
        solved = torch.logit(albedo.clamp(ALBEDO_LOW, ALBEDO_HIGH))
    return replace(unknowns, solved=solved)


def _equations(
    transport: Transport, block: Block, specular: SpecularBlock | None, unknowns: Unknowns, bounces: int
) -> AlbedoEquations:
    gain, lobe = gain_and_lobe(transport, block, specular, unknowns, bounces)
    color = srgb_to_linear(block.color_srgb)
    importance = srgb_slope(color.clamp(DARKEST, 1)).square()
    exposure = unknowns.exposure
    shown = color if exposure is None else color / exposure[block.view][:, None]
    return AlbedoEquations(block.vertices, gain, shown if lobe is None else shown - lobe, importance, block.saturated)
