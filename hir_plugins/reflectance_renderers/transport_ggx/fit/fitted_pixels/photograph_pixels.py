"""Which pixels of the photographs a fit, a comparison or a search of α uses, and their mini-batches with lobes."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable, Sequence
from threading import RLock
from typing import final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture import Capture
from hir_core.optimization.linear_maps import LinearMap
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.mini_batches import MiniBatches
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.observed_pixels import (
    ObservedPixels,
    concatenate,
    observe_pixels,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import PixelBatch, reflecting_metal
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_lamp import LampCameras, LampPoints
from hir_plugins.reflectance_renderers.transport_ggx.operator.camera_light import pixel_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.shading_normals import offset_normals
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions

COMPARED_PIXELS = 2_048
"""Pixels of each held-out view whose error is compared, at most: all models are compared on the same ones, and views
differ more than pixels do."""
SAMPLE_PIXELS = 4_096
"""Pixels of all views together on which widths of a lobe are compared."""
SAMPLE_DIRECTIONS_FACTOR = 2
"""Multiple of the directions of a lobe there: the noise of few directions grows with the width and favours narrow
lobes."""
METAL_DIRECTIONS = 3
"""Multiple of the directions of a metal's lobes, of which a fit has as many times fewer pixels: all that a metal shows
is in its lobes, whose noise and blur are the largest error (docs/studies/directions_of_lobes.md)."""
SAMPLE_NUMBER = -1
"""Their key among the batches."""
DRAW_SEEDS = 1 << 24
"""Between the seeds of two draws of the same lobes."""


@final
class PhotographPixels:
    """The pixels of one capture's photographs on one surface. Those of each view are drawn once and kept, for all fits
    that run at the same time.
    """

    def __init__(
        self,
        transport: Transport,
        capture: Capture,
        downsample: int,
        options: TransportGGXOptions,
        rotation: Float[Tensor, "N 3 3"],
        cameras: LampCameras,
    ) -> None:
        """`rotation`: from the world to the axes of a light that moves with the camera; `cameras` carry a lamp."""
        self._transport = transport
        self._capture = capture
        self._downsample = downsample
        self._options = options
        self._rotation = rotation
        self._cameras = cameras
        self._observed: dict[int, ObservedPixels] = {}
        self._recent: OrderedDict[tuple[tuple[int, ...], float], ObservedPixels] = OrderedDict()
        self._max_recent_pixels = options.resident_pixels // 2
        self._lock = RLock()

    def of(self, views: Sequence[int]) -> ObservedPixels:
        """All that a fit may use of these views: each has its share of `pixels`."""
        most = max(64, self._options.pixels // max(len(self._capture.views), 1))
        with self._lock:
            for view in views:
                if view not in self._observed:
                    self._observed[view] = observe_pixels(
                        self._transport, self._capture, view, most, self._downsample, self._options.seed
                    )
            return concatenate([self._observed[v] for v in views])

    def compared(self, views: Sequence[int]) -> ObservedPixels:
        """At most `COMPARED_PIXELS` of each view."""

        def thinned() -> ObservedPixels:
            parts = [self.of([view]) for view in views]
            rows = [torch.arange(0, len(part), max(1, math.ceil(len(part) / COMPARED_PIXELS))) for part in parts]
            return concatenate([part.take(chosen) for part, chosen in zip(parts, rows, strict=True)])

        return self._recently((tuple(views), 0.0), thinned)

    def recent(self, views: Sequence[int], share: float, spec: ModelSpec) -> ObservedPixels:
        """The pixels of a fit of a model, a share of all: of a metal fewer, with more directions each."""
        if spec.kind == "metal":
            most = self._options.pixels / METAL_DIRECTIONS * len(views) / max(len(self._capture.views), 1)
            share *= min(1.0, most / max(len(self.of(views)), 1))
        return self._recently((tuple(views), share), lambda: self.subsampled(self.of(views), share))

    def _recently(self, key: tuple[tuple[int, ...], float], make: Callable[[], ObservedPixels]) -> ObservedPixels:
        """The last pixels of fits and comparisons stay in memory with their irradiance matrices."""
        with self._lock:
            found = self._recent.pop(key, None)
            if found is None:
                found = make()
            self._recent[key] = found
            while len(self._recent) > 1 and sum(map(len, self._recent.values())) > self._max_recent_pixels:
                self._recent.popitem(last=False)
            return found

    def subsampled(self, photographs: ObservedPixels, share: float) -> ObservedPixels:
        """A share of the pixels, drawn at random."""
        if share >= 1.0:
            return photographs
        generator = torch.Generator().manual_seed(self._options.seed)
        return photographs.take((torch.rand(len(photographs), generator=generator) < share).nonzero()[:, 0])

    def batches(self, photographs: ObservedPixels, spec: ModelSpec, draw: int = 0) -> MiniBatches:
        """Mini-batches of pixels in random order; their lobes are drawn when they are asked for.

        Another `draw` has the same pixels and other directions.
        """
        block = self._options.block_pixels
        count = max(1, math.ceil(len(photographs) / block))
        directions = self._options.samples * (METAL_DIRECTIONS if spec.kind == "metal" else 1)
        order = torch.randperm(len(photographs), generator=torch.Generator().manual_seed(self._options.seed))

        def make(state: Parameters, number: int) -> PixelBatch:
            seed = number + draw * DRAW_SEEDS + (self._options.seed << 32)
            part = photographs.take(order[number::count])
            irradiance = self._irradiance(photographs, number, part, spec, seed)
            return self.batch(part, spec, state, seed, directions, irradiance)

        def sample(state: Parameters) -> PixelBatch:
            seed = self._options.seed
            few = photographs.take(order[:SAMPLE_PIXELS])
            irradiance = self._irradiance(photographs, SAMPLE_NUMBER, few, spec, seed)
            return self.batch(few, spec, state, seed, SAMPLE_DIRECTIONS_FACTOR * directions, irradiance)

        return MiniBatches(make, sample, count, max(1, self._options.resident_pixels // block))

    def _irradiance(
        self, photographs: ObservedPixels, number: int, part: ObservedPixels, spec: ModelSpec, seed: int
    ) -> LinearMap | None:
        """The irradiance matrix of a batch; None where the irradiance cache has it."""
        if spec.light_frame != "camera":
            return None
        with self._lock:
            found = photographs.irradiance.get(number)
            if found is None:
                samples = self._options.diffuse_samples
                found = pixel_irradiance(self._transport, part.points, samples, self._rotation, seed)
                if len(photographs) <= self._max_recent_pixels:
                    photographs.irradiance[number] = found
            return found

    def batch(
        self,
        part: ObservedPixels,
        spec: ModelSpec,
        parameters: Parameters,
        seed: int,
        directions: int,
        irradiance: LinearMap | None,
    ) -> PixelBatch:
        """A batch with lobes of the present α and shading normals."""
        vertices, cells = self._transport.interpolation(part.points)
        points = part.points
        if parameters.normal_offset is not None:
            points = points.with_normals(
                offset_normals(points.normal, vertices.matrix @ parameters.normal_offset.detach())
            )
        rotation = self._rotation if spec.light_frame == "camera" else None
        lobes = None
        if spec.brdf != "diffuse":
            alpha = parameters.alpha.detach()
            alpha = alpha if len(alpha) == 1 else vertices.matrix @ alpha
            metal = reflecting_metal(self._transport, parameters, spec)
            lobes = self._transport.lobes(points, alpha, directions, rotation, seed, metal)
        lamp = None
        if spec.lamp:
            lamp = LampPoints.of(part.points, self._cameras, self._transport.tracer, self._transport.offset)
        return PixelBatch(
            linear_to_srgb(part.color),
            part.saturated,
            part.points.view,
            part.points.view_cosine,
            lobes,
            vertices,
            cells if irradiance is None else None,
            irradiance,
            part.points.normal,
            lamp,
        )
