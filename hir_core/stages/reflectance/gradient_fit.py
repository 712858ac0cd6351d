"""Material and light fitted by gradient steps through any reflectance renderer, textures and all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.errors import StageError
from hir_core.optimization.nonfinite_diagnostics import elements_at_fault
from hir_core.optimization.optimization_loop import Batches, Keep, Schedule, optimize, tell_troubles
from hir_core.optimization.weighted_energies import Energies
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.scene import Scene
from hir_core.scene.energy_conservation import specular_like
from hir_core.scene.srgb import linear_to_srgb

if TYPE_CHECKING:
    from hir_core.run.stage_context import StageContext

INSIDE = 0.99
"""Mask from which a pixel shows the object alone."""


@dataclass(frozen=True, eq=False)
class ObjectPixels:
    """All pixels that show the object, as (view, x, y), with their colours."""

    index: Int[Tensor, "N 3"]
    color: Float[Tensor, "N 3"]
    saturated: Bool[Tensor, "N 1"]
    first: Sequence[int]
    """Where each view begins; one more than views."""


def object_pixels(capture: Capture, views: Sequence[int], downsample: int, device: str) -> ObjectPixels:
    """Gathers the pixels of some views; an error where the masks leave none."""
    index, color, saturated, first = [], [], [], [0]
    for view in views:
        pixels = capture.views[view].pixels(downsample)
        mask = pixels.mask if pixels.mask is not None else np.ones(pixels.color_linear.shape[:2], np.float32)
        rows, columns = np.nonzero(mask >= INSIDE)
        index.append(np.stack([np.full(len(rows), view), columns, rows], axis=1))
        _check(pixels.color_linear[rows, columns], capture.views[view].name)
        color.append(pixels.color_linear[rows, columns] / capture.views[view].exposure)
        saturated.append(pixels.saturated[rows, columns])
        first.append(first[-1] + len(rows))
    if first[-1] == 0:
        raise StageError(f"{capture.path}: the masks leave no pixel of the object; look at them with: hir check")
    return ObjectPixels(
        torch.from_numpy(np.concatenate(index)).to(device),
        torch.from_numpy(np.concatenate(color).astype(np.float32)).to(device),
        torch.from_numpy(np.concatenate(saturated))[:, None].to(device),
        first,
    )


def fit_by_gradient(
    scene: Scene,
    prepared: PreparedReflectance,
    pixels: ObjectPixels,
    settings: ReflectanceSettings,
    energies: Energies,
    context: StageContext,
    *,
    steps: int,
    fit_light: bool = True,
    fit_specular: bool = True,
) -> tuple[Scene, dict[str, Any]]:
    """Adam on textures and light, held in their physical range after each step.

    The photometric term is `rgb_weight · ‖fit − photograph‖₁`, summed over the pixels of a step (Zhu et al. 2023).
    """
    assert scene.material is not None and scene.environment is not None
    material, environment = scene.material, scene.environment
    leaves = [material.diffuse_albedo, material.specular_albedo, material.roughness, environment.radiance]
    wanted = [True, fit_specular, fit_specular, fit_light]
    diffuse, specular, roughness, radiance = (
        leaf.detach().clone().requires_grad_(want) for leaf, want in zip(leaves, wanted, strict=True)
    )
    parameters = [p for p in (diffuse, specular, roughness, radiance) if p.requires_grad]
    optimizer = torch.optim.Adam(parameters, lr=settings.learning_rate)
    limits = [(diffuse, 0.0, 1.0), (specular, 0.0, 1.0), (roughness, 0.01, 1.0), (radiance, 0.0, 1e5)]
    draw = _Draw(pixels, settings, context.seed)

    def current() -> Scene:
        fitted = replace(material, diffuse_albedo=diffuse, specular_albedo=specular, roughness=roughness)
        return replace(scene, material=fitted, environment=replace(environment, radiance=radiance))

    def loss(step: int) -> dict[str, Tensor]:
        rows = draw(step)
        state = current()
        assert state.material is not None and state.environment is not None
        shown = prepared.radiance(state.material, state.environment, pixels.index[rows])
        difference = _compared(shown, settings) - _compared(pixels.color[rows], settings)
        # a clipped pixel says only that the truth is at least this bright
        difference = torch.where(pixels.saturated[rows] & (difference > 0), torch.zeros_like(difference), difference)
        return {"rgb": settings.rgb_weight * difference.abs().sum(), **energies(state)}

    def locate(step: int, term: str) -> str:
        with torch.no_grad():
            state, rows = current(), draw(step)
            assert state.material is not None and state.environment is not None
            shown = prepared.radiance(state.material, state.environment, pixels.index[rows])
            broken = ~torch.isfinite(shown - pixels.color[rows]).all(dim=1)
        views = pixels.index[rows][broken, 0].unique().tolist()
        if term == "rgb" and views:
            return f"{int(broken.sum())} pixels of view {', '.join(map(str, views[:5]))}"
        named = {"diffuse albedo": diffuse, "specular albedo": specular, "roughness": roughness, "light": radiance}
        return elements_at_fault(named)

    def hold(_: int) -> bool:
        with torch.no_grad():
            for value, low, high in limits:
                value.clamp_(low, high)
            if settings.conserve_energy and material.model == "paper":
                # NaN stays NaN here: it is for the guards of the optimisation to catch
                diffuse.copy_(torch.minimum(diffuse, 1 - specular_like(specular, diffuse)))
        return False

    result = optimize(
        loss,
        optimizer,
        Schedule(steps, end=settings.learning_rate_end),
        stage="reflectance",
        report=context.report,
        after_step=hold,
        locate=locate,
        keep=Keep(context.checkpoints / "gradient.npz", context.checkpoint_seconds),
    )
    tell_troubles(result, context.warn)
    done = current()
    assert done.material is not None and done.environment is not None
    finished = replace(
        done.material, diffuse_albedo=diffuse.detach(), specular_albedo=specular.detach(), roughness=roughness.detach()
    )
    light = replace(done.environment, radiance=radiance.detach())
    return replace(scene, material=finished, environment=light), {"steps": result.steps, "skipped": result.skipped}


def _check(color: np.ndarray, view: str) -> None:
    if not np.isfinite(color).all():
        bad = int((~np.isfinite(color).all(axis=1)).sum())
        raise StageError(f"view {view} has {bad} pixels of the object that are NaN or infinite; mend or leave it out")


class _Draw:
    """The pixels of each step: one whole view, or some pixels of all views."""

    def __init__(self, pixels: ObjectPixels, settings: ReflectanceSettings, seed: int) -> None:
        self._pixels = pixels
        self._by_view = settings.batch == "views"
        count = len(pixels.first) - 1 if self._by_view else 1
        self._views = Batches(count, 1, seed)
        self._size = settings.batch_pixels
        self._seed = seed

    def __call__(self, step: int) -> Tensor:
        device = self._pixels.index.device
        if self._by_view:
            view = self._views(step)[0]
            return torch.arange(self._pixels.first[view], self._pixels.first[view + 1], device=device)
        total = len(self._pixels.index)
        if self._size >= total:
            return torch.arange(total, device=device)
        generator = np.random.default_rng((self._seed, step))
        return torch.from_numpy(generator.integers(0, total, self._size)).to(device)


def _compared(linear: Tensor, settings: ReflectanceSettings) -> Tensor:
    return linear if settings.loss_space == "linear" else linear_to_srgb(linear)
