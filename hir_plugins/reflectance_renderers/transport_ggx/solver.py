"""Fits material and light on cached transport: the `ReflectanceSolver` of `transport_ggx`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, final

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.errors import StageError
from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceSolver
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Scene, Topology
from hir_core.scene.srgb import linear_to_srgb, srgb_to_linear
from hir_plugins.reflectance_renderers.transport_ggx.fit import joint_optimization
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_checkpoints import FitFiles
from hir_plugins.reflectance_renderers.transport_ggx.fit.initial_guess import albedo_of_photographs, without_indirect
from hir_plugins.reflectance_renderers.transport_ggx.fit.joint_optimization import FitSettings
from hir_plugins.reflectance_renderers.transport_ggx.fit.mini_batches import Stream
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import (
    GRAZING,
    Photographed,
    join,
    photographed,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import LIGHT_LIMIT, Unknowns, width_of
from hir_plugins.reflectance_renderers.transport_ggx.fit.pixel_batches import Block, ShownPixels, predict, residual
from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import bent
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.textures.albedo_refinement import AlbedoRefinement
from hir_plugins.reflectance_renderers.transport_ggx.textures.observations import Pictures
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_brdf import LitSurface, shown_pixels
from hir_plugins.reflectance_renderers.transport_ggx.textures.per_texel_maps import solve_lobe_maps
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import TexelEquations
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_shading import Indirect, shade
from hir_plugins.reflectance_renderers.transport_ggx.textures.texture_solve import solve_scene

UPRIGHT = torch.diag(torch.tensor([1.0, -1.0, -1.0]))
"""Axes of a light that the camera carries: y up and z backwards, so that the picture of the light is upright."""


WIDE = 0.3
"""The other width from which a lobe is tried: highlights and sheen lie in two valleys of the loss."""
LEAST_START = math.log(0.03 / 0.97)
"""Logit of ρs from which a colour or a map starts at least: a logistic that has gone to 0 has no slope left."""
GRAZING_DEGREES = math.degrees(math.asin(GRAZING))
JUDGED_POINTS = 12_000
"""At most, of held-out views: what texels would have of their own is solved at them, with photographs of each."""
PROBE_EFFORT = 0.25
PROBE_SHARE = 0.4


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted rung."""

    spec: ModelSpec
    unknowns: Unknowns
    views: tuple[int, ...] = ()
    """Of those it was fitted to; points that have values of their own are solved from them."""

    @property
    def shown(self) -> Unknowns:
        """What its scene has."""
        return self.unknowns.settled


@final
class TransportSolver(ReflectanceSolver):
    """One scene's geometry and one capture's cameras, with transport cached."""

    def __init__(
        self, transport: Transport, scene: Scene, capture: Capture, downsample: int, options: TransportGGXOptions
    ) -> None:
        self._transport = transport
        self._scene = scene
        self._capture = capture
        self._downsample = downsample
        self._options = options
        self._edges = Topology(transport.surface.faces).edges
        self._indirect: Indirect | None = None
        self._equations: list[TexelEquations] = []
        self._settling: AlbedoRefinement | None = None
        self._files: FitFiles | None = None
        self._samples: dict[int, Photographed] = {}
        self._pictures = Pictures(capture, downsample)
        self._last: tuple[Unknowns, tuple[int, ...], LitSurface] | None = None
        self._rotation = _camera_rotations(capture, transport.surface.positions.device)

    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """Radiance through pixels (view, x, y); 0 where they miss. Differentiable in material and light."""
        cameras = {v: c.downsampled(self._downsample) for v, c in enumerate(self._capture.cameras)}
        return shade(self._transport, material, environment, cameras, pixels, self._options, self._indirect)

    def keep(self, folder: Path, seconds: float) -> None:
        """Fits that have ended are read again from `folder`, one under way goes on from its last state."""
        self._files = FitFiles(folder, seconds)

    def fit(self, spec: ModelSpec, start: Any, views: Sequence[int], effort: float, report: Callable[[float], None]) -> Fit:
        """Adam on cached transport; a rung's new unknowns start from the values of the earlier fit.

        Without one a diffuse model is fitted first: light and albedo before the lobes that depend on both.
        """
        if spec.texels != "none":
            # what points have of their own is solved when they are looked at
            whole = replace(spec, texels="none")
            base = start if effort == 0 else self.fit(whole, start, views, effort, report)
            report(1.0)
            return Fit(spec, base.unknowns, tuple(views))
        if start is None and spec.brdf != "diffuse":
            start = self.fit(ModelSpec("diffuse", light_frame=spec.light_frame), None, views, effort, lambda share: None)
        file = self._files.next(spec, tuple(views), effort) if self._files is not None else None
        device = self._transport.surface.positions.device
        ended = file.result() if file is not None else None
        if ended is not None:
            report(1.0)
            return Fit(spec, ended.to(device), tuple(views))
        photographs = self._thinned(self._photographs(views), effort)
        if not len(photographs):
            raise StageError(
                f"no pixel of {len(views)} photographs shows the surface from more than {GRAZING_DEGREES:.0f} degrees: "
                "mesh, masks and cameras do not fit together, or all views graze it; see with: hir check"
            )
        unknowns = self._begin(spec, start, photographs)
        steps = max(1, round(self._options.steps * effort))
        known = self._options.known_light
        settings = FitSettings(
            steps,
            spec.brdf,
            spec.bounces,
            known_light=known,
            light_smoothness=self._options.light_smoothness,
            light_whiteness=self._options.light_whiteness,
            albedo_smoothness=self._options.albedo_smoothness,
        )
        begun = file is not None and file.begun()
        if spec.brdf != "diffuse" and start.unknowns.width is None and not begun:
            unknowns = self._probe(photographs, unknowns, settings, spec, effort)
        fitted = joint_optimization.fit(
            self._transport,
            self._stream(photographs, spec),
            unknowns,
            settings,
            self._edges,
            lambda step, _: report((step + 1) / steps),
            file,
        )
        if file is not None:
            file.finish(fitted)
        return Fit(spec, fitted, tuple(views))

    def errors(self, fit: Fit, views: Sequence[int]) -> NDArray[np.float64]:
        """Mean squared sRGB error of each view's pixels; a clipped pixel that the fit makes brighter is right.

        Of the gradient steps: albedos in closed form flatter a wrong light (the chair's stood on the camera then).
        """
        photographs = self._photographs(views)
        count = len(self._capture.views)
        total, seen = np.zeros(count), np.zeros(count)
        for pixels, radiance in self._shown(fit, photographs):
            if fit.unknowns.gain is not None:
                radiance = radiance * _exposures(pixels, radiance, count)[pixels.view][:, None]
            error = residual(pixels, radiance.clamp(0, 1)).square().mean(dim=1)
            view = pixels.view.cpu().numpy()
            total += np.bincount(view, error.cpu().double().numpy(), count)
            seen += np.bincount(view, minlength=count)
        found = [v for v in views if seen[v] > 0]
        return total[found] / seen[found]

    def _shown(self, fit: Fit, photographs: Photographed) -> Iterator[tuple[ShownPixels, Tensor]]:
        """Pixels, in parts, with the radiance that a fit shows there."""
        with torch.no_grad():
            if fit.spec.texels != "none":
                apart = max(1, math.ceil(len(photographs) / JUDGED_POINTS))
                few = photographs.take(torch.arange(0, len(photographs), apart))
                yield ShownPixels.of(few), shown_pixels(self._lit(fit), few, fit.spec.texels == "lobes")
                return
            for block, specular in self._stream(photographs, fit.spec).each(fit.unknowns, fit.spec.brdf):
                yield block, predict(self._transport, block, specular, fit.unknowns, fit.spec.bounces)

    def _lit(self, fit: Fit) -> LitSurface:
        """The surface under the light of a fit; the last one is kept, for two rungs and two judgements ask for it."""
        if self._last is None or self._last[0] is not fit.unknowns or self._last[1] != fit.views:
            self._last = None  # its probes go before there are new ones
            lit = LitSurface.of(self._transport, self._pictures, fit.views, fit.spec, fit.shown)
            self._last = fit.unknowns, fit.views, lit
        return self._last[2]

    def scene(self, fit: Fit, views: Sequence[int], report: Callable[[float], None]) -> tuple[Scene, dict[str, Any]]:
        """Textures solved from all pixels, light as fitted. `radiance` has the fit's indirect light from then on."""
        moving = fit.spec.light_frame == "camera"
        shown = fit.shown
        if fit.spec.texels == "lobes":
            lit = self._lit(replace(fit, views=tuple(views)))
            material, shown, self._equations, facts = solve_lobe_maps(
                lit, self._scene, self._photographs(views), self._downsample, self._options, report
            )
        else:
            material, self._equations, facts = solve_scene(
                self._transport,
                self._scene,
                self._capture,
                views,
                self._downsample,
                fit.spec,
                shown,
                self._rotation if moving else None,
                self._options,
                report,
            )
        if fit.spec.bounces:
            self._indirect = self._indirect_light(shown, fit.spec.bounces)
        light = EnvironmentMap(shown.radiance, UPRIGHT.to(shown.light) if moving else None, fit.spec.light_frame)
        return replace(self._scene, material=material, environment=light), facts

    def settle(
        self, scene: Scene, traced: PreparedReflectance | None, views: Sequence[int], report: Callable[[float], None]
    ) -> Scene | None:
        """The albedo solved from the same pixels, with what `traced` shows of them in place of what was cached."""
        if self._settling is None or self._settling.scene is not scene:
            self._settling = AlbedoRefinement(scene, self._equations)
        return self._settling.solved(self._transport.surface, traced, views, report)

    def _indirect_light(self, values: Unknowns, bounces: int) -> Indirect:
        texels = self._transport.pyramid.texels
        with torch.no_grad():
            sources, irradiance = self._transport.sources(values.radiance, values.diffuse_albedo, bounces)
            _, direct = self._transport.sources(values.radiance, values.diffuse_albedo, 0)
        return Indirect(irradiance - direct, sources[texels:])

    def _photographs(self, views: Sequence[int]) -> Photographed:
        most = max(64, self._options.pixels // max(len(self._capture.views), 1))
        for view in views:
            if view not in self._samples:
                self._samples[view] = photographed(
                    self._transport, self._capture, view, most, self._downsample, self._options.seed
                )
        return join([self._samples[v] for v in views])

    def _thinned(self, photographs: Photographed, effort: float) -> Photographed:
        """Little effort looks at fewer pixels, too."""
        share = min(1.0, 2 * effort)
        if share == 1.0:
            return photographs
        generator = torch.Generator().manual_seed(self._options.seed)
        return photographs.take((torch.rand(len(photographs), generator=generator) < share).nonzero()[:, 0])

    def _stream(self, photographs: Photographed, spec: ModelSpec) -> Stream:
        block = self._options.block_pixels
        count = max(1, math.ceil(len(photographs) / block))
        order = torch.randperm(len(photographs), generator=torch.Generator().manual_seed(self._options.seed))

        def make(state: Unknowns, number: int) -> Block:
            return self._block(photographs.take(order[number::count]), spec, state, number)

        return Stream(make, count, max(1, self._options.resident_pixels // block))

    def _block(self, part: Photographed, spec: ModelSpec, unknowns: Unknowns, seed: int) -> Block:
        vertices, cells = self._transport.interpolation(part.points)
        points = part.points
        if unknowns.tilt is not None:
            points = points.bent(bent(points.normal, vertices.matrix @ unknowns.tilt.detach()))
        rotation = self._rotation if spec.light_frame == "camera" else None
        direct = None
        if rotation is not None:
            direct = pixel_irradiance(self._transport, part.points, self._options.diffuse_samples, rotation, seed)
        lobes = None
        if spec.brdf != "diffuse":
            alpha = unknowns.alpha.detach()
            alpha = alpha if len(alpha) == 1 else vertices.matrix @ alpha
            lobes = self._transport.lobes(points, alpha, self._options.samples, rotation, seed)
        return Block(
            linear_to_srgb(part.color),
            part.saturated,
            part.points.view,
            lobes,
            vertices,
            None if direct else cells,
            direct,
            part.points.normal,
        )

    def _begin(self, spec: ModelSpec, start: Fit | None, photographs: Photographed) -> Unknowns:
        """Unknowns of a rung, from an earlier fit or from the scene that was prepared."""
        assert self._scene.material is not None and self._scene.environment is not None
        if start is None:
            light = self._scene.environment.radiance.clamp(1e-6, LIGHT_LIMIT).log()
            diffuse = self._start_albedo(photographs, spec, light.exp())
            gain = light.new_zeros(len(self._capture.views)) if self._options.view_gain else None
            base = Unknowns(light, torch.logit(diffuse), None, None, gain)
        else:
            base = start.unknowns
            if spec.bounces and not start.spec.bounces:
                base = replace(base, diffuse=without_indirect(self._transport, base, spec.bounces))
        tilt = base.tilt
        if spec.normals == "map" and tilt is None:
            tilt = torch.zeros_like(self._transport.surface.positions)
        if spec.brdf == "diffuse":
            return Unknowns(base.light, base.diffuse, None, None, base.gain, tilt=tilt)
        specular, width = base.specular, base.width
        vertices = len(base.diffuse)
        if specular is None or width is None:
            rho = self._scene.material.specular_albedo.mean().clamp(1e-3, 0.999)
            alpha = self._scene.material.roughness.mean().clamp(0.02, 0.98)
            specular, width = torch.logit(rho).reshape(1, 1), width_of(alpha).reshape(1, 1)
        if spec.colored and specular.shape[1] == 1:
            specular = specular.clamp_min(LEAST_START).expand(-1, 3)
        if spec.specular == "map" and len(specular) == 1:
            specular = specular.clamp_min(LEAST_START).expand(vertices, -1)
        if spec.roughness == "map" and len(width) == 1:
            width = width.expand(vertices, -1)
        return Unknowns(base.light, base.diffuse, specular.contiguous(), width.contiguous(), base.gain, tilt=tilt)

    def _start_albedo(self, photographs: Photographed, spec: ModelSpec, light: Tensor) -> Float[Tensor, "V 3"]:
        rotation = self._rotation if spec.light_frame == "camera" else None
        alike = self._options.start == "uniform" and not self._options.known_light
        samples = self._options.diffuse_samples
        return albedo_of_photographs(self._transport, photographs, light, alike, rotation, samples)

    def _probe(
        self, photographs: Photographed, unknowns: Unknowns, settings: FitSettings, spec: ModelSpec, effort: float
    ) -> Unknowns:
        """The start, narrow or wide, from which a short fit to some of the pixels gets farther."""
        part = self._thinned(photographs, PROBE_SHARE / 2)
        steps = max(1, round(min(PROBE_EFFORT, effort) * self._options.steps))
        short = replace(settings, steps=steps, solve_albedo=False)
        assert unknowns.width is not None
        wide = width_of(torch.full_like(unknowns.width, WIDE))
        starts = [unknowns, replace(unknowns, width=wide)]
        losses = [self._short_fit(part, spec, start, short) for start in starts]
        return starts[losses.index(min(losses))]

    def _short_fit(self, part: Photographed, spec: ModelSpec, start: Unknowns, settings: FitSettings) -> float:
        losses: list[float] = []
        joint_optimization.fit(
            self._transport,
            self._stream(part, spec),
            start,
            settings,
            self._edges,
            lambda _, loss: losses.append(loss),
        )
        last = losses[-max(1, len(losses) // 5) :]
        return sum(last) / len(last) if last else math.inf


def _camera_rotations(capture: Capture, device: torch.device) -> Float[Tensor, "N 3 3"]:
    """From the world to the axes of a light that each view's camera carries."""
    rotations = np.stack([c.world_to_camera[:3, :3] for c in capture.cameras])
    return UPRIGHT.to(device) @ torch.from_numpy(rotations.astype(np.float32)).to(device)


def _exposures(pixels: ShownPixels, radiance: Tensor, views: int) -> Float[Tensor, " views"]:
    """The factor that brings each view's radiance nearest to its photograph: a held-out view's was never fitted."""
    known = ~pixels.saturated.any(dim=1)
    photograph = srgb_to_linear(pixels.color_srgb)
    above, below = (
        torch.zeros(views, device=radiance.device).index_add(0, pixels.view[known], (radiance * o).sum(dim=1)[known])
        for o in (photograph, radiance)
    )
    return torch.where(below > 0, above / below.clamp_min(1e-12), torch.ones_like(below))
