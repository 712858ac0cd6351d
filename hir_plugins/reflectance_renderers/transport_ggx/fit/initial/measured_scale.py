"""The scale between albedo and light that a card measured: an earlier fit takes it before another one starts from it.

Photographs of the object hardly change if the light is brighter and all albedos are darker. So gradient steps neither
find the scale nor leave it; and a term that draws the light to the card would first change the light of the card's own
hemisphere, which the object shows well.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Capture
from hir_core.scene import EnvironmentMap
from hir_core.scene.card_irradiance import measured_over_found, measuring_views
from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import ALBEDO_HIGH, ALBEDO_LOW
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.take_lights import light_of_each_take


def at_measured_scale(
    parameters: Parameters, frame: Literal["world", "camera"], to_world: Float[Tensor, "3 3"] | None, capture: Capture
) -> Parameters:
    """The parameters with a light that brings the card what it measured, and albedos that show the same photographs.

    F0 of a dielectric stays: it does not depend on the light. Unchanged without a card. Of several takes the one with
    the card gives the scale of all.
    """
    views = measuring_views(capture)
    if not views:
        return parameters
    with torch.no_grad():
        lights = light_of_each_take(parameters.radiance, len(capture.takes))
        radiance = lights[capture.take_numbers[views[0]]]
        return with_brighter_light(parameters, measured_over_found(EnvironmentMap(radiance, to_world, frame), capture))


def with_brighter_light(parameters: Parameters, gain: Float[Tensor, " 3"]) -> Parameters:
    """All light brighter by a factor for each channel, and albedos as much darker.

    A diffuse surface looks the same, but for the light that it reflects onto itself.
    """
    solved, lamp = parameters.closed_form_diffuse, parameters.lamp
    return replace(
        parameters,
        light=parameters.light + gain.log(),
        diffuse=_divided(parameters.diffuse, gain),
        closed_form_diffuse=None if solved is None else _divided(solved, gain),
        lamp=None if lamp is None else torch.cat([lamp[:3] + gain.log(), lamp[3:]]),
    )


def _divided(logit: Float[Tensor, "V 3"], gain: Float[Tensor, " 3"]) -> Float[Tensor, "V 3"]:
    return torch.logit((torch.sigmoid(logit) / gain).clamp(ALBEDO_LOW, ALBEDO_HIGH))
