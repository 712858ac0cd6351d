"""Fits material and light on cached transport: the `ReflectanceSolver` of `transport_ggx`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from threading import Lock, local
from typing import final

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.errors import StageError
from hir_core.plugins.interfaces import CheckpointLocation, PreparedReflectance, ReflectanceSolver, Solved, WeightedTerm
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Scene, Topology
from hir_core.scene.card_irradiance import measuring_views
from hir_plugins.reflectance_renderers.transport_ggx.fit import joint_optimization
from hir_plugins.reflectance_renderers.transport_ggx.fit.exposures import median_exposures, own_exposures
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_checkpoints import FitCheckpoint
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_settings import FitSettings, settings_of_fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_terms import FitTerms
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_model import Fit
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.grazing_gain import errors_with_grazing_gain
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import (
    MIN_VIEW_COSINE,
    ObservedPixels,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.photograph_pixels import (
    DRAW_SEEDS,
    PhotographPixels,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    PixelColors,
    predict,
    srgb_residual,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.gradient_grid import GradientGrid, gradient_grid
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_guess import (
    extended_to,
    initial_candidates,
    simpler_model,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial.initial_values import InitialValues
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import LampCameras
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import UPRIGHT, camera_rotations
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.shading import TransportShading
from hir_plugins.reflectance_renderers.transport_ggx.textures.albedo_refinement import AlbedoRefinement
from hir_plugins.reflectance_renderers.transport_ggx.textures.brdf_fit_state import PointBrdfs
from hir_plugins.reflectance_renderers.transport_ggx.textures.light_refit import light_pixels, refit_light
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import ImageCache
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import LitSurface, pixel_brdfs
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_maps import solve_per_texel_maps
from hir_plugins.reflectance_renderers.transport_ggx.textures.shaded_points import ShadedPoints
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import Indirect
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_solve import solve_scene

MIN_VIEW_DEGREES = math.degrees(math.asin(MIN_VIEW_COSINE))
MAX_COMPARED_POINTS = 12_000
"""Surface points of held-out views at which per-texel values are solved to compare them."""
COMPARED_LIGHT_PIXELS = 10_000
"""Pixels to which a light is fitted again where per-texel BRDFs are compared."""
TRIAL_EFFORT = 0.25
TRIAL_PIXEL_SHARE = 0.4
"""Effort, at most, and share of the pixels of the short fits that choose initial values."""


@final
class TransportSolver(ReflectanceSolver[Fit, AlbedoRefinement]):
    """One scene's geometry and one capture's cameras, with transport cached; pixels and lit surfaces are cached too."""

    concurrent_fits = True

    def __init__(
        self,
        transport: Transport,
        scene: Scene,
        capture: Capture,
        downsample: int,
        options: TransportGGXOptions,
        terms: Sequence[WeightedTerm] = (),
    ) -> None:
        self._transport = transport
        self._scene = scene
        self._capture = capture
        self._downsample = downsample
        self._options = options
        self._terms = tuple(terms)
        self._edges = Topology(transport.surface.faces).edges
        self._shading = TransportShading(transport, capture, downsample, options)
        self._images = ImageCache(capture, downsample)
        self._first_fits: dict[tuple[ModelSpec, tuple[int, ...], float, float], Parameters] = {}
        self._first_locks: dict[tuple[ModelSpec, tuple[int, ...], float, float], Lock] = {}
        self._grid_lock = Lock()
        self._of_thread = local()
        self._lit_surface: tuple[Parameters, ModelSpec, tuple[int, ...], LitSurface] | None = None
        self._refitted: tuple[LitSurface, LitSurface] | None = None
        """A lit surface, and the same one under the light that was fitted again."""
        self._grids: dict[int, GradientGrid | None] = {}
        self._rotation = camera_rotations(capture, transport.surface.positions.device)
        self._cameras = LampCameras.of_capture(capture, transport.surface.positions)
        self._pixels = PhotographPixels(transport, capture, downsample, options, self._rotation, self._cameras)
        self._initial_values = InitialValues(
            transport, scene, capture, options, self._rotation, self._cameras, self._exposures_of
        )

    def with_terms(self, terms: Sequence[WeightedTerm]) -> TransportSolver:
        """The same solver, whose fits at vertices and whose albedo textures minimise the terms too."""
        return TransportSolver(self._transport, self._scene, self._capture, self._downsample, self._options, terms)

    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """Direct radiance through pixels (view, x, y); 0 where they miss. Differentiable in material and light."""
        return self._shading.radiance(material, environment, pixels)

    def supported(self, spec: ModelSpec) -> ModelSpec | None:
        """Every model; but a BRDF for each texel needs distant light alone."""
        return replace(spec, per_texel="none") if spec.lamp else spec

    def simpler(self, spec: ModelSpec) -> ModelSpec | None:
        """The model that is fitted first where there is no earlier fit."""
        return simpler_model(spec)

    def fit(
        self,
        spec: ModelSpec,
        initial: Fit | None,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None = None,
        pixel_share: float = 1.0,
    ) -> Fit:
        """Adam on cached transport; the parameters of a model start from the values of the earlier fit.

        Without one, a simpler model is fitted first. That is the diffuse one, light and albedo before the lobes that
        depend on both. But for metal and dielectric it is metal: a diffuse model explains reflections by the albedo and
        by a wrong light. A metal starts with one base colour for all vertices.
        """
        if spec.per_texel == "none" and effort == 0 and initial is not None:
            report(1.0)
            assert self._scene.material is not None
            parameters = extended_to(spec, initial.parameters, self._scene.material)
            if spec.exposures == "equal":
                parameters = replace(parameters, log_exposure=None, exposure_take=None)
            return Fit(spec, parameters, tuple(views))
        if spec.per_texel != "none":
            # per-texel values are solved when they are used
            base = initial
            if base is None or effort > 0:
                vertices = replace(spec, per_texel="none")
                base = self.fit(vertices, initial, views, effort, report, checkpoint, pixel_share)
            report(1.0)
            return Fit(spec, base.parameters, tuple(views))
        if initial is not None:
            return Fit(spec, self._fitted(spec, initial, views, effort, report, checkpoint, pixel_share), tuple(views))
        # a hypothesis and the simpler model that another one starts from are the same fit, also where both run now
        first = spec, tuple(views), effort, pixel_share
        with self._first_locks.setdefault(first, Lock()):
            if first in self._first_fits:
                report(1.0)
            else:
                simpler = self.simpler(spec)
                if simpler is not None:
                    part = checkpoint.part(simpler.kind) if checkpoint is not None else None
                    initial = self.fit(simpler, None, views, effort, lambda share: None, part, pixel_share)
                self._first_fits[first] = self._fitted(spec, initial, views, effort, report, checkpoint, pixel_share)
            return Fit(spec, self._first_fits[first], tuple(views))

    def _fitted(
        self,
        spec: ModelSpec,
        initial: Fit | None,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None,
        pixel_share: float,
    ) -> Parameters:
        """The fit of values at vertices alone, after the simpler model."""
        file = FitCheckpoint(checkpoint.stem, checkpoint.seconds) if checkpoint is not None else None
        device = self._transport.surface.positions.device
        finished = file.result() if file is not None else None
        if finished is not None:
            report(1.0)
            return finished.to(device)
        photographs = self._pixels.recent(views, pixel_share, spec)
        if not len(photographs):
            raise StageError(
                f"no pixel of {len(views)} photographs shows the surface from more than {MIN_VIEW_DEGREES:.0f} degrees"
                ": mesh, masks and cameras are inconsistent, or all views are grazing; inspect them with: hir check"
            )
        parameters = self._initial_parameters(spec, initial, photographs)
        before = None if initial is None else initial.parameters
        settings = settings_of_fit(
            self._options, spec, parameters, before, effort, self._initial_values.guess_is_uniform(spec)
        )
        resumes = file is not None and file.has_state()
        scale_is_known = spec.light_is_known or (not spec.lamp and bool(measuring_views(self._capture)))
        candidates = initial_candidates(spec, parameters, before, scale_is_known)
        if len(candidates) > 1 and not resumes:
            # a scale needs more steps to tell than a metalness
            most = effort if spec.brdf == "dielectric" else effort / 2
            parameters = self._best_candidate(photographs, candidates, settings, spec, min(TRIAL_EFFORT, most))
        fitted = joint_optimization.fit(
            self._transport,
            self._pixels.batches(photographs, spec),
            parameters,
            settings,
            self._edges,
            lambda step, _: report((step + 1) / settings.steps),
            file,
            self._fit_terms(spec),
            self._grid(photographs),
        )
        if file is not None:
            file.finish(fitted)
        return fitted

    def errors(self, fit: Fit, views: Sequence[int]) -> NDArray[np.float64]:
        """Mean squared sRGB error of each view's pixels; no error where a clipped pixel is brighter.

        The errors of two renderings with independent directions of the lobes are multiplied, so that the mean does not
        contain the noise of the directions.

        With the albedo of the gradient steps: a closed-form albedo compensates a wrong light (on the chair the light on
        the camera would win).
        """
        pixels, renderings = self._renderings(fit, views)
        return self._errors_of_views(fit, pixels, renderings, views).cpu().numpy()

    def errors_between_lights(self, fit: Fit, views: Sequence[int]) -> NDArray[np.float64]:
        """The same where predictions may brighten towards grazing angles, which a light on the camera imitates."""
        pixels, renderings = self._renderings(fit, views)
        found = errors_with_grazing_gain(
            pixels, renderings, lambda shown: self._errors_of_views(fit, pixels, shown, views)
        )
        return found.cpu().numpy()

    def exposures(self, fit: Fit, views: Sequence[int]) -> NDArray[np.float64] | None:
        """Fitted exposures of the views; None for a model without."""
        found = fit.parameters.exposure
        if fit.spec.exposures != "fitted" or found is None:
            return None
        return found[list(views)].detach().double().cpu().numpy()

    def _errors_of_views(
        self, fit: Fit, pixels: PixelColors, renderings: Sequence[Float[Tensor, "P 3"]], views: Sequence[int]
    ) -> Float[Tensor, " V"]:
        """Mean squared sRGB error of each of the views that has pixels."""
        count, residuals = len(self._capture.views), []
        for radiance in renderings:
            if fit.spec.exposures == "fitted":
                radiance = radiance * own_exposures(pixels, radiance, count)[pixels.view]
            elif (exposure := fit.parameters.exposure) is not None:
                radiance = radiance * exposure[pixels.view]
            residuals.append(srgb_residual(pixels, radiance.clamp(0, 1)))
        squares = (residuals[0] * residuals[-1]).mean(dim=1).double()
        total = squares.new_zeros(count).index_add_(0, pixels.view, squares)
        seen = torch.bincount(pixels.view, minlength=count)
        found = [view for view in views if seen[view] > 0]
        return (total[found] / seen[found]).clamp_min(0)

    def _renderings(self, fit: Fit, views: Sequence[int]) -> tuple[PixelColors, list[Float[Tensor, "P 3"]]]:
        """The compared pixels, and their radiance in two independent renderings; in one where no lobe is drawn.

        The last ones of a thread are kept, for both kinds of errors.
        """
        known = getattr(self._of_thread, "renderings", None)
        if known is not None and known[0] is fit and known[1] == tuple(views):
            return known[2], known[3]
        photographs = self._pixels.compared(views)
        shown = self._at_texels(fit, photographs) if fit.spec.per_texel != "none" else None
        renderings = []
        for draw in range(2 if fit.spec.brdf != "diffuse" else 1):
            # a mean square would contain the noise of the lobes: 1 to 3 dB of a metal's error, nothing of a matt one's
            parts = (
                list(self._predicted(fit, photographs, draw)) if shown is None else [self._shaded(fit, *shown, draw)]
            )
            renderings.append(torch.cat([radiance for _, radiance in parts]))
        pixels = PixelColors.concatenated([block for block, _ in parts])
        self._of_thread.renderings = fit, tuple(views), pixels, renderings
        return pixels, renderings

    def _predicted(self, fit: Fit, photographs: ObservedPixels, draw: int = 0) -> Iterator[tuple[PixelColors, Tensor]]:
        """Observed pixels, in parts, with the radiance that a fit predicts for them, by one draw of its lobes."""
        # no `yield` inside `no_grad`: two such generators that take turns would leave gradients off
        if fit.spec.per_texel != "none":
            yield self._shaded(fit, *self._at_texels(fit, photographs), draw)
            return
        for block, specular in self._pixels.batches(photographs, fit.spec, draw).each(fit.parameters, fit.spec.brdf):
            with torch.no_grad():
                radiance = predict(self._transport, block, specular, fit.parameters, fit.spec.bounces)
            yield block, radiance

    def _at_texels(self, fit: Fit, photographs: ObservedPixels) -> tuple[ObservedPixels, PointBrdfs]:
        """At most `MAX_COMPARED_POINTS` of observed pixels, and their BRDFs from the photographs of the fit alone."""
        interval = max(1, math.ceil(len(photographs) / MAX_COMPARED_POINTS))
        few = photographs.take(torch.arange(0, len(photographs), interval))
        with torch.no_grad():
            return few, pixel_brdfs(self._lit_at_texels(fit), few, fit.spec.per_texel == "brdf")

    def _shaded(
        self, fit: Fit, pixels: ObservedPixels, brdfs: PointBrdfs, draw: int
    ) -> tuple[PixelColors, Float[Tensor, "P 3"]]:
        """Pixels with BRDFs of their own, and their radiance by the lobes that shade textures.

        The probes that the BRDFs are solved with are less exact: what they are fitted to, they predict better than
        textures can show it.
        """
        if not len(pixels):
            return PixelColors.of(pixels), pixels.color
        seed = draw * DRAW_SEEDS + (self._options.seed << 32)
        with torch.no_grad():
            shaded = ShadedPoints.of(self._lit_at_texels(fit), pixels.points, brdfs, self._options.samples, seed)
            return PixelColors.of(pixels), brdfs.albedo * shaded.gain + shaded.lobe

    def _lit_at_texels(self, fit: Fit) -> LitSurface:
        """The surface under the light of a fit, which is fitted again for a BRDF at each texel, as for textures."""
        lit = self._lit(fit)
        if fit.spec.per_texel != "brdf" or fit.spec.light_is_known:
            return lit
        cached = self._refitted
        if cached is not None and cached[0] is lit:
            return cached[1]
        self._refitted = cached = None  # frees its probes
        pixels = light_pixels(self._pixels.of(fit.views), self._options.seed, COMPARED_LIGHT_PIXELS)
        with torch.no_grad():
            values = pixel_brdfs(lit, pixels)
        with torch.enable_grad():
            refitted = refit_light(lit, pixels, values, self._options)
        self._refitted = lit, refitted
        return refitted

    def _lit(self, fit: Fit) -> LitSurface:
        """The surface under the light of a fit; the last one is cached, because comparisons use it four times."""
        spec = replace(fit.spec, per_texel="none")
        cached = self._lit_surface
        if cached is not None and cached[0] is fit.parameters and cached[1:3] == (spec, fit.views):
            return cached[3]
        self._lit_surface = self._refitted = cached = None  # frees its probes before there are new ones
        lit = LitSurface.of(self._transport, self._images, fit.views, spec, fit.scene_parameters)
        self._lit_surface = fit.parameters, spec, fit.views, lit
        return lit

    def scene(self, fit: Fit, views: Sequence[int], report: Callable[[float], None]) -> Solved[AlbedoRefinement]:
        """Textures solved from all pixels, light as fitted."""
        self._first_fits.clear()  # models are no longer compared, and textures need memory
        on_camera = fit.spec.light_frame == "camera"
        fit = replace(fit, parameters=self._initial_values.at_measured_scale(fit))
        parameters = fit.scene_parameters
        if fit.spec.per_texel == "brdf":
            if self._terms:
                names = ", ".join(term.name for term in self._terms)
                warnings.warn(
                    f"the model has a BRDF for each texel, which is solved without the regularizers {names}: they act "
                    "in the fit at vertices before it and on the albedo; for all maps: "
                    "--set reflectance.model=roughness_map",
                    stacklevel=2,
                )
            lit = self._lit(replace(fit, views=tuple(views)))
            material, parameters, equations, figures = solve_per_texel_maps(
                lit,
                self._scene,
                self._pixels.of(views),
                self._downsample,
                self._options,
                report,
                self._fit_terms(fit.spec),
            )
        else:
            material, equations, figures = solve_scene(
                self._transport,
                self._scene,
                self._capture,
                views,
                self._downsample,
                fit.spec,
                parameters,
                self._rotation if on_camera else None,
                self._cameras,
                self._options,
                report,
                self._fit_terms(fit.spec),
            )
        rotation = UPRIGHT.to(parameters.light) if on_camera else None
        lamp = None if (own := parameters.camera_lamp) is None else self._cameras.in_scene(own)
        lights = self._transport.lights(parameters.radiance)
        light = EnvironmentMap(lights[0], rotation, fit.spec.light_frame, lamp)
        of_takes = dict(zip(self._capture.takes, lights, strict=True)) if self._capture.takes != ("",) else {}
        scene = replace(self._scene, material=material, environment=light, take_radiance=of_takes)
        indirect = self._indirect_light(parameters, fit.spec.bounces) if fit.spec.bounces else []
        takes = [view.take for view in self._capture.views]
        refinement = AlbedoRefinement(equations, self._options.seed, self._fit_terms(fit.spec), takes)
        return Solved(
            scene, replace(self._shading, indirect=indirect), refinement, figures, exposures=parameters.exposure
        )

    def refine(
        self,
        solved: Solved[AlbedoRefinement],
        traced: PreparedReflectance | None,
        views: Sequence[int],
        report: Callable[[float], None],
    ) -> Solved[AlbedoRefinement] | None:
        """The albedo solved from the same pixels, with the radiance of `traced` in place of the cached transport."""
        scene = solved.refinement.refined(solved.scene, self._transport.surface, traced, views, report)
        return None if scene is None else replace(solved, scene=scene)

    def _indirect_light(self, values: Parameters, bounces: int) -> list[Indirect]:
        """Of the light of each take."""
        texels, count = self._transport.pyramid.texels, self._transport.takes.count
        with torch.no_grad():
            sources, irradiance = self._transport.sources(values.radiance, values.base_color, bounces)
            _, direct = self._transport.sources(values.radiance, values.base_color, 0)
        blocks = (irradiance - direct).chunk(count), sources.chunk(count)
        return [Indirect(reflected, seen[texels:]) for reflected, seen in zip(*blocks, strict=True)]

    def _fit_terms(self, spec: ModelSpec) -> FitTerms | None:
        """The regularizers, and the scene whose material and light a fit changes; None without any."""
        light = self._scene.environment
        if not self._terms or light is None:
            return None
        rotation = UPRIGHT.to(light.radiance) if spec.light_frame == "camera" else None
        light = EnvironmentMap(light.radiance, rotation, spec.light_frame)
        shown = replace(self._scene, environment=light)
        return FitTerms(self._terms, shown, self._transport.surface, self._transport.takes.count)

    def _initial_parameters(self, spec: ModelSpec, initial: Fit | None, photographs: ObservedPixels) -> Parameters:
        return self._initial_values.parameters(spec, initial, photographs, self._grid(photographs))

    def _exposures_of(self, fit: Fit, views: Sequence[int]) -> Float[Tensor, "views 3"]:
        """Logarithms of the photographs' brightness beside the radiance that a fit predicts."""
        predicted = self._predicted(fit, self._pixels.compared(views))
        return median_exposures(predicted, len(self._capture.views)).to(fit.parameters.light)

    def _grid(self, photographs: ObservedPixels) -> GradientGrid | None:
        """The grid of a fit to these pixels; the last one is cached."""
        per_value = self._options.pixels_per_value
        if not per_value:
            return None
        count = round(len(photographs) / per_value)
        with self._grid_lock:
            if count not in self._grids:
                self._grids = {count: gradient_grid(self._transport.surface, count)}
            return self._grids[count]

    def _best_candidate(
        self,
        photographs: ObservedPixels,
        candidates: Sequence[Parameters],
        settings: FitSettings,
        spec: ModelSpec,
        effort: float,
    ) -> Parameters:
        """The candidate from which a short fit reaches the lowest loss."""
        part = self._pixels.subsampled(photographs, TRIAL_PIXEL_SHARE)
        steps = max(1, round(effort * self._options.steps))
        short = replace(settings, steps=steps, solve_albedo=False)
        losses = [self._short_fit(part, spec, candidate, short) for candidate in candidates]
        return candidates[losses.index(min(losses))]

    def _short_fit(self, part: ObservedPixels, spec: ModelSpec, initial: Parameters, settings: FitSettings) -> float:
        """Mean loss over the last fifth of the steps."""
        losses: list[float] = []
        joint_optimization.fit(
            self._transport,
            self._pixels.batches(part, spec),
            initial,
            settings,
            self._edges,
            lambda _, loss: losses.append(loss),
            terms=self._fit_terms(spec),
            grid=self._grid(part),
        )
        last = losses[-max(1, len(losses) // 5) :]
        return sum(last) / len(last) if last else math.inf
