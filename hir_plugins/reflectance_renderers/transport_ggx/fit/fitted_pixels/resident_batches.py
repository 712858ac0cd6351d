"""The pixel batches of a running fit: their lobes and specular matrices follow α and the shading normals."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any, final

import torch
from numpy.typing import NDArray
from torch import Tensor

from hir_core.optimization.checkpoints import Arrays
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_checkpoints import parameter_arrays, parameters_from_arrays
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.mini_batches import MiniBatches
from hir_plugins.reflectance_renderers.transport_ggx.fit.fitted_pixels.pixel_batches import (
    PixelBatch,
    at_pixels,
    normals_in_lobe_frame,
    refresh_matrices,
    specular_matrices,
)
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters, logit_of_alpha
from hir_plugins.reflectance_renderers.transport_ggx.operator.lobes.specular_radiance import SpecularMatrices

MAX_ALPHA_RATIO = 1.1
"""Lobes are sampled anew if α has changed by more than this factor on average."""

RELATIVE_ALPHA_STEP = 0.1
"""Step of the finite differences in α."""

MAX_NORMAL_CHANGE_IN_ALPHAS = 1.0
"""Lobes are sampled anew if shading normals have turned by more than this multiple of α on average."""


@final
class ResidentBatches:
    """The batches in memory for the current step; a `Stateful` of the loop.

    Every `interval` steps the specular matrices are rebuilt for the current α and normals. Lobes are sampled anew if
    both have changed too far, and always if the batches do not fit into memory at once: then the next shard comes.
    """

    def __init__(
        self,
        source: MiniBatches,
        parameters: Parameters,
        initial: Parameters,
        model: str,
        interval: int,
        predicted: Callable[[PixelBatch, SpecularMatrices, Parameters], Tensor],
    ) -> None:
        """`parameters` are those that the loop changes; `initial` are detached from them. `predicted` gives the
        radiance of a batch (P, 3)."""
        self._source, self._parameters, self._model, self._interval = source, parameters, model, interval
        self._predicted = predicted
        self._sampled_for = initial
        self._batches: list[PixelBatch] = []
        self._matrices: list[SpecularMatrices | None] = []
        self._refreshed_at = -1

    def at(self, step: int) -> tuple[PixelBatch, SpecularMatrices | None]:
        """The batch of a step, with its specular matrices."""
        if step % self._interval == 0 and step != self._refreshed_at:
            self._refresh(step)
        index = step % len(self._batches)
        return self._batches[index], self._matrices[index]

    def all(self) -> Iterable[tuple[PixelBatch, SpecularMatrices | None]]:
        """All batches of the fit, with matrices for the current parameters."""
        current = self._parameters.detached()
        if self._source.shards > 1:
            self._batches, self._matrices = [], []
            return self._source.each(current, self._model)
        self._sample_first()
        refresh_matrices(self._batches, self._matrices, current)
        return zip(self._batches, self._matrices, strict=True)

    def state(self) -> Arrays:
        """The parameters for which lobes were sampled."""
        return parameter_arrays(self._sampled_for)

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Lobes will be sampled for the stored parameters."""
        stored = parameters_from_arrays(dict(state))
        assert stored is not None
        self._sampled_for = stored.to(self._parameters.light.device)

    def _refresh(self, step: int) -> None:
        if self._source.shards == 1:
            self._sample_first()
        if self._source.shards > 1 or self._have_drifted():
            self._sampled_for = self._parameters.detached()
            # the old batches are freed before there are new ones: each takes gigabytes
            self._batches, self._matrices = [], []
            self._sample(step // self._interval)
        refresh_matrices(self._batches, self._matrices, self._parameters)
        if self._parameters.width is not None and len(self._parameters.width) > 1:
            self._find_alpha_slopes(step // self._interval)
        self._refreshed_at = step

    def _find_alpha_slopes(self, shard: int) -> None:
        """Derivatives in a map of α, from lobes that are drawn with the same random numbers at α ± a step."""
        current = self._parameters.detached()
        for batch, matrices, number in zip(self._batches, self._matrices, self._source.numbers(shard), strict=True):
            if matrices is None:
                continue
            ends = []
            for factor in (1 - RELATIVE_ALPHA_STEP, 1 + RELATIVE_ALPHA_STEP):
                moved = replace(current, width=logit_of_alpha(current.alpha * factor))
                drawn = self._source.make(moved, number)
                own = specular_matrices([drawn], self._model)
                refresh_matrices([drawn], own, moved)
                assert own[0] is not None
                with torch.no_grad():
                    ends.append((self._predicted(drawn, own[0], moved), at_pixels(batch, moved.alpha)))
            (below, narrow), (above, wide) = ends
            matrices.alpha_slope = (above - below) / (wide - narrow).clamp_min(1e-6)

    def _sample_first(self) -> None:
        if not self._batches:
            self._sample(0)

    def _sample(self, shard: int) -> None:
        self._batches = self._source.shard(self._sampled_for, shard)
        self._matrices = specular_matrices(self._batches, self._model)

    def _have_drifted(self) -> bool:
        batch = self._batches[0]
        if batch.lobes is None or self._parameters.width is None:
            return False
        with torch.no_grad():
            normal = normals_in_lobe_frame(batch, self._parameters.normal_offset)
            if normal is not None:
                turned = float((normal[:, :2].norm(dim=1) / batch.lobes.sampling_alpha[:, 0]).mean())
                if turned > MAX_NORMAL_CHANGE_IN_ALPHAS:
                    return True
            ratio = (at_pixels(batch, self._parameters.alpha) / batch.lobes.sampling_alpha).log().abs().mean()
        return float(ratio) > math.log(MAX_ALPHA_RATIO)
