"""Gradient steps on textures and light through any reflectance renderer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import GradientSettings
from hir_core.errors import StageError
from hir_core.optimization.clipped_pixels import without_clipped_excess
from hir_core.optimization.nonfinite_diagnostics import nonfinite_elements
from hir_core.optimization.optimization_loop import Checkpointing, optimize, warn_of_skipped_steps
from hir_core.optimization.schedules import Batches, Schedule
from hir_core.optimization.weighted_energies import Energies
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.plugins.progress import Progress
from hir_core.scene import Material, Scene
from hir_core.scene.energy_conservation import specular_at_size_of
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.reflectance.reflectance_report import GradientReport

MIN_OBJECT_COVERAGE = 0.99
"""Mask value from which a pixel shows the object alone."""
MIN_ALPHA, MAX_RADIANCE = 0.01, 1e5
"""Limits of the GGX width α and of the light's radiance; albedos stay in 0…1."""
MAX_NAMED_VIEWS = 5


class GradientContext(Protocol):
    """What a gradient fit needs of its stage, or of the solver that runs it."""

    @property
    def seed(self) -> int:
        """Of the pixels that are drawn."""

    @property
    def checkpoints(self) -> Path | None:
        """The folder of its state; None to store none."""

    @property
    def checkpoint_seconds(self) -> float:
        """Interval at which the state is stored."""

    @property
    def report(self) -> Callable[[Progress], None]:
        """Receives the progress."""

    @property
    def warn(self) -> Callable[[str], None]:
        """Receives warnings."""


@dataclass(frozen=True, eq=False)
class ObjectPixels:
    """All pixels that show the object, as (view, x, y), with their linear colours at exposure 1."""

    index: Int[Tensor, "N 3"]
    color: Float[Tensor, "N 3"]
    saturated: Bool[Tensor, "N 1"]
    first: Sequence[int]
    """Row of each view's first pixel, and the number of rows."""


def object_pixels(capture: Capture, views: Sequence[int], downsample: int, device: str) -> ObjectPixels:
    """Gathers the object pixels of some views; `StageError` where the masks leave none."""
    index, color, saturated, first = [], [], [], [0]
    for view in views:
        pixels = capture.views[view].pixels(downsample)
        mask = pixels.mask if pixels.mask is not None else np.ones(pixels.color_linear.shape[:2], np.float32)
        rows, columns = np.nonzero(mask >= MIN_OBJECT_COVERAGE)
        index.append(np.stack([np.full(len(rows), view), columns, rows], axis=1))
        _check(pixels.color_linear[rows, columns], capture.views[view].name)
        color.append(pixels.color_linear[rows, columns] / capture.views[view].gain)
        saturated.append(pixels.saturated[rows, columns])
        first.append(first[-1] + len(rows))
    if first[-1] == 0:
        raise StageError(f"{capture.path}: the masks leave no pixel of the object; inspect them with: hir check")
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
    settings: GradientSettings,
    energies: Energies,
    context: GradientContext,
    *,
    steps: int,
    conserve_energy: bool = True,
    fit_light: bool = True,
    fit_specular: bool = True,
    checkpoint: str = "gradient",
) -> tuple[Scene, GradientReport]:
    """Adam on textures and light, clamped to their physical range after each step.

    Of a `metallic` material the base colour and, if it is a texture, the metalness are fitted in place of the albedos.
    The photometric term is `rgb_weight · ‖fit − photograph‖₁`, summed over the pixels of a step (Zhu et al. 2023).
    The state is stored under the name `checkpoint`, unique to this fit within its stage.
    """
    assert scene.material is not None and scene.environment is not None
    material, environment = scene.material, scene.environment
    leaves = [material.diffuse_albedo, material.specular_albedo, material.roughness, environment.radiance]
    fitted_leaves = [True, fit_specular, fit_specular, fit_light]
    names = ("diffuse albedo", "specular albedo", "roughness", "light")
    if material.metalness is not None:
        leaves[:2] = [material.base_color, material.metalness]
        fitted_leaves[1] = fit_specular and material.metalness.ndim == 3
        names = ("base colour", "metalness", "roughness", "light")
    # of a metallic material: the base colour and the metalness
    diffuse, specular, roughness, radiance = (
        leaf.detach().clone().requires_grad_(fit) for leaf, fit in zip(leaves, fitted_leaves, strict=True)
    )
    parameters = [p for p in (diffuse, specular, roughness, radiance) if p.requires_grad]
    optimizer = torch.optim.Adam(parameters, lr=settings.learning_rate)
    limits = [(diffuse, 0.0, 1.0), (specular, 0.0, 1.0), (roughness, MIN_ALPHA, 1.0), (radiance, 0.0, MAX_RADIANCE)]
    draw = PixelSampler(pixels, settings, context.seed)

    def of(diffuse: Tensor, specular: Tensor, roughness: Tensor) -> Material:
        if material.metalness is None:
            return replace(material, diffuse_albedo=diffuse, specular_albedo=specular, roughness=roughness)
        return Material.metallic(
            diffuse, specular, roughness, material.normal, material.observed, material.dielectric_f0
        )

    def current() -> Scene:
        light = replace(environment, radiance=radiance)
        return replace(scene, material=of(diffuse, specular, roughness), environment=light)

    def loss(step: int) -> dict[str, Tensor]:
        rows = draw(step)
        state = current()
        assert state.material is not None and state.environment is not None
        predicted = prepared.radiance(state.material, state.environment, pixels.index[rows])
        difference = _in_loss_space(predicted, settings) - _in_loss_space(pixels.color[rows], settings)
        difference = without_clipped_excess(difference, pixels.saturated[rows])
        return {"rgb": settings.rgb_weight * difference.abs().sum(), **energies(state)}

    def locate(step: int, term: str) -> str:
        with torch.no_grad():
            state, rows = current(), draw(step)
            assert state.material is not None and state.environment is not None
            predicted = prepared.radiance(state.material, state.environment, pixels.index[rows])
            nonfinite = ~torch.isfinite(predicted - pixels.color[rows]).all(dim=1)
        views = pixels.index[rows][nonfinite, 0].unique().tolist()
        if term == "rgb" and views:
            return f"{int(nonfinite.sum())} pixels of view {', '.join(map(str, views[:MAX_NAMED_VIEWS]))}"
        return nonfinite_elements(dict(zip(names, (diffuse, specular, roughness, radiance), strict=True)))

    def clamp(_: int) -> bool:
        with torch.no_grad():
            for value, low, high in limits:
                value.clamp_(low, high)
            if conserve_energy and material.model == "paper":
                # NaN stays NaN here: the optimisation loop diagnoses it
                diffuse.copy_(torch.minimum(diffuse, 1 - specular_at_size_of(specular, diffuse)))
        return False

    result = optimize(
        loss,
        optimizer,
        Schedule(steps, end=settings.learning_rate_end),
        stage="reflectance",
        report=context.report,
        after_step=clamp,
        locate=locate,
        checkpointing=None
        if context.checkpoints is None
        else Checkpointing(context.checkpoints / f"{checkpoint}.npz", context.checkpoint_seconds),
    )
    warn_of_skipped_steps(result, context.warn)
    fitted_material = of(diffuse.detach(), specular.detach(), roughness.detach())
    light = replace(environment, radiance=radiance.detach())
    return replace(scene, material=fitted_material, environment=light), GradientReport(result.steps, result.skipped)


def gradient_steps(settings: GradientSettings, views: int) -> int:
    """Number of steps for so many views."""
    return settings.iterations_per_view * views or settings.iterations


def _check(color: np.ndarray, view: str) -> None:
    if not np.isfinite(color).all():
        bad = int((~np.isfinite(color).all(axis=1)).sum())
        raise StageError(f"view {view} has {bad} pixels of the object that are NaN or infinite; repair or remove it")


class PixelSampler:
    """The rows of each step's pixels: one whole view, or random pixels of all views."""

    def __init__(self, pixels: ObjectPixels, settings: GradientSettings, seed: int) -> None:
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


def _in_loss_space(linear: Tensor, settings: GradientSettings) -> Tensor:
    return linear if settings.loss_space == "linear" else linear_to_srgb(linear)
