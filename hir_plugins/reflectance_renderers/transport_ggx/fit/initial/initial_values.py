"""The values that a fit starts from: an earlier fit's, or the prepared scene's and the photographs'."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Capture
from hir_core.errors import StageError
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import Scene
from hir_core.scene.card_irradiance import measuring_views
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import ObservedPixels
from hir_plugins.reflectance_renderers.transport_ggx.fit.gradient_grid import GradientGrid
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_exposures import initial_exposures
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_guess import (
    direct_irradiance,
    extended_to,
    initial_albedo,
    initial_metal,
    without_indirect,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_lamp import initial_lamp
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.measured_scale import at_measured_scale
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MAX_RADIANCE, Parameters, mean_of_takes
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import (
    LampCameras,
    LampPoints,
    lamp_irradiance,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import UPRIGHT
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions


class InitialValues:
    """Initial values of the fits to one capture on one scene's geometry.

    `rotation`: (views, 3, 3), from the world to the axes of a light that moves with each camera. `exposures_of`:
    logarithms of the photographs' brightness beside the radiance that a fit predicts, (views, 3).
    """

    def __init__(
        self,
        transport: Transport,
        scene: Scene,
        capture: Capture,
        options: TransportGGXOptions,
        rotation: Float[Tensor, "views 3 3"],
        cameras: LampCameras,
        exposures_of: Callable[[Fit, Sequence[int]], Float[Tensor, "views 3"]],
    ) -> None:
        self._transport = transport
        self._scene = scene
        self._capture = capture
        self._options = options
        self._rotation = rotation
        self._cameras = cameras
        self._exposures_of = exposures_of

    def parameters(
        self, spec: ModelSpec, initial: Fit | None, photographs: ObservedPixels, grid: GradientGrid | None
    ) -> Parameters:
        """Parameters of a model, from an earlier fit or from the prepared scene."""
        assert self._scene.material is not None and self._scene.environment is not None
        if initial is None:
            light = self._scene.environment.radiance.clamp(1e-6, MAX_RADIANCE).log()
            light = self._light_of_takes(light, photographs, spec)
            if spec.lamp:
                light = light - math.log(2)  # the lamp is as bright as the rest
            lamp = initial_lamp(light) if spec.lamp else None
            if spec.brdf == "metallic" and self.guess_is_uniform(spec):
                gain, diffuse = self._metal(photographs, spec, light.exp(), lamp)
                light = (light.exp() * gain).clamp(1e-6, MAX_RADIANCE).log()
                lamp = None if lamp is None else torch.cat([lamp[:3] + gain.log(), lamp[3:]])
            else:
                diffuse = self._albedo(photographs, spec, light.exp(), lamp, grid)
            base = Parameters(light, torch.logit(diffuse), None, None, lamp=lamp)
            if spec.bounces and spec.brdf != "metallic" and not self.guess_is_uniform(spec):
                base = replace(base, diffuse=without_indirect(self._transport, base, spec.bounces))
        else:
            base = self.at_measured_scale(initial)
            lamp = initial_lamp(base.light) if spec.lamp and base.lamp is None else base.lamp
            base = replace(base, lamp=lamp if spec.lamp else None)
            if spec.bounces and not initial.spec.bounces:
                base = replace(base, diffuse=without_indirect(self._transport, base, spec.bounces))
        return self._with_exposures(spec, extended_to(spec, base, self._scene.material), photographs, initial)

    def _light_of_takes(self, light: Tensor, photographs: ObservedPixels, spec: ModelSpec) -> Float[Tensor, "H W 3"]:
        """The logarithm of an initial light, for each take as much brighter as its photographs are beside all, or
        beside those of the take for whose light a card measured the brightness.
        """
        takes = self._transport.takes
        if takes.of_view is None:
            return light
        light = light.repeat(takes.count, 1, 1)
        arriving = self._arriving(photographs, spec, light.exp(), None)
        color, view = photographs.color, photographs.points.view
        if spec.exposures == "recorded":
            recorded = self._recorded().to(color)
            color = color / (recorded / recorded.log().mean().exp())[view]
        take = takes.of_view[view]
        levels = [color[take == n].mean() / arriving[take == n].mean() for n in range(takes.count)]
        with_card = measuring_views(self._capture)
        overall = color.mean() / arriving.mean()
        reference = levels[self._capture.take_numbers[with_card[0]]] if with_card else overall
        gains = torch.stack([level / reference for level in levels])
        usable = torch.isfinite(gains) & (gains > 0)
        gains = torch.where(usable, gains, torch.ones_like(gains)).log()
        return light + gains.repeat_interleave(len(light) // takes.count)[:, None, None]

    def at_measured_scale(self, fit: Fit) -> Parameters:
        """The parameters of a fit, as bright as a card measured the light; unchanged with a lamp, which lit the card in
        each photograph from another side and at another distance.
        """
        if fit.spec.light_is_known or fit.spec.lamp:
            return fit.parameters
        rotation = UPRIGHT if fit.spec.light_frame == "camera" else None
        return at_measured_scale(fit.parameters, fit.spec.light_frame, rotation, self._capture)

    def _with_exposures(
        self, spec: ModelSpec, parameters: Parameters, photographs: ObservedPixels, initial: Fit | None
    ) -> Parameters:
        """With exposures as the model has them.

        Fitted ones start from colours of the same places; from the earlier fit, if there is one; and for views that it
        did not have, from the photographs beside its prediction.
        """
        if spec.exposures == "equal":
            return replace(parameters, log_exposure=None, exposure_take=None)
        if spec.exposures == "recorded":
            return replace(parameters, log_exposure=self._recorded().to(parameters.light).log(), exposure_take=None)
        take = self._transport.takes.of_view
        if initial is None:
            eyes = np.stack([camera.center for camera in self._capture.cameras]).astype(np.float64)
            # under another light a place has another colour, so places are compared within a take
            parts = [photographs]
            if take is not None:
                numbers = take[photographs.points.view]
                parts = [photographs.take((numbers == n).nonzero()[:, 0]) for n in range(self._transport.takes.count)]
            found = torch.stack([initial_exposures(self._transport.surface, part, eyes) for part in parts]).sum(dim=0)
            return replace(parameters, log_exposure=found, exposure_take=take)
        found = parameters.light.new_zeros(len(self._capture.views), 3)
        known = initial.views if initial.parameters.log_exposure is not None else ()
        if initial.parameters.exposure is not None:
            found[list(known)] = initial.parameters.exposure[list(known)].log()
        if missing := [view for view in photographs.points.view.unique().tolist() if view not in known]:
            found[missing] = self._exposures_of(initial, missing)[missing]
        # the mean belongs to the light
        mean, lamp = found.mean(dim=0), parameters.lamp
        if lamp is not None:
            lamp = torch.cat([lamp[:3] + mean, lamp[3:]])
        light = parameters.light + mean
        if take is not None:
            views = [int((take == number).nonzero()[0]) for number in range(self._transport.takes.count)]
            of_takes = mean_of_takes(found, take)[views]
            rows = len(parameters.light) // self._transport.takes.count
            light = parameters.light + of_takes.repeat_interleave(rows, dim=0)[:, None]
        return replace(parameters, log_exposure=found, exposure_take=take, light=light, lamp=lamp)

    def _recorded(self) -> Float[Tensor, "views 3"]:
        recorded = [view.recorded_exposure for view in self._capture.views]
        if None in recorded:
            raise StageError("the photographs record no exposures; use reflectance.exposures=fitted or equal")
        return torch.tensor(recorded)[:, None].repeat(1, 3)

    def guess_is_uniform(self, spec: ModelSpec) -> bool:
        """Whether the first fit of the model has one albedo everywhere as its initial guess."""
        return self._options.initial_albedo == "uniform" and not spec.light_is_known

    def _albedo(
        self,
        photographs: ObservedPixels,
        spec: ModelSpec,
        light: Tensor,
        lamp: Tensor | None,
        grid: GradientGrid | None,
    ) -> Float[Tensor, "V 3"]:
        arriving = self._arriving(photographs, spec, light, lamp)
        return initial_albedo(self._transport, photographs, arriving, self.guess_is_uniform(spec), grid)

    def _metal(
        self, photographs: ObservedPixels, spec: ModelSpec, light: Tensor, lamp: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        arriving = self._arriving(photographs, spec, light, lamp)
        return initial_metal(self._transport, photographs, arriving, bool(measuring_views(self._capture)))

    def _arriving(
        self, photographs: ObservedPixels, spec: ModelSpec, light: Tensor, lamp: Tensor | None
    ) -> Float[Tensor, "P 3"]:
        """Irradiance of pixels under an initial light, without indirect light."""
        rotation = self._rotation if spec.light_frame == "camera" else None
        arriving = direct_irradiance(self._transport, photographs, light, rotation, self._options.diffuse_samples)
        if lamp is None:
            return arriving
        shown = Parameters(light, light, None, None, lamp=lamp).camera_lamp
        assert shown is not None
        points = LampPoints.of(photographs.points, self._cameras, self._transport.tracer, self._transport.offset)
        return arriving + lamp_irradiance(points.rays(shown))
