"""A solver for any differentiable reflectance renderer: gradient steps on textures and light.

A renderer whose `prepare` returns it, and that declares the traits `solver` and `regularizers`, gets the model
selection of the core, albedo refinement under path-traced radiance, checkpoints and progress.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy.typing import NDArray
from torch import Tensor

from hir_core.capture import Capture
from hir_core.config import GradientSettings
from hir_core.errors import StageError
from hir_core.optimization.checkpoints import read_arrays, write_arrays
from hir_core.optimization.clipped_pixels import without_clipped_excess
from hir_core.optimization.weighted_energies import Energies
from hir_core.plugins.interfaces import (
    CheckpointLocation,
    PreparedReflectance,
    ReflectanceSolver,
    Solved,
    WeightedTerm,
)
from hir_core.plugins.model_spec import MaterialKind, ModelSpec
from hir_core.plugins.progress import Progress
from hir_core.scene import EnvironmentMap, Material, Scene
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.reflectance.gradient_fit import ObjectPixels, fit_by_gradient, object_pixels
from hir_core.stages.reflectance.reflectance_report import significant

LEARNING_RATE_END = 0.1
"""Factor by which the rate has fallen at the end of a fit."""
REFINEMENT_EFFORT = 0.5
"""Share of the steps of a full fit with which an albedo is refined."""
COMPARED_PIXELS = 4096
"""Pixels of each view, at most, whose error is compared."""


@dataclass(frozen=True, eq=False)
class GradientFit:
    """The fitted scene of a model."""

    spec: ModelSpec
    scene: Scene


@dataclass(frozen=True)
class _Run:
    """What a gradient fit needs of a stage."""

    seed: int
    report: Callable[[Progress], None]
    checkpoints: Path | None
    checkpoint_seconds: float
    warn: Callable[[str], None]


class GradientSolver(ReflectanceSolver[GradientFit, GradientFit]):
    """Fits `diffuse`, `paper` or `dielectric` materials, each of one lobe or of maps, under a light in either frame."""

    def __init__(
        self,
        prepared: PreparedReflectance,
        scene: Scene,
        capture: Capture,
        downsample: int = 1,
        *,
        kinds: Sequence[MaterialKind] = ("diffuse",),
        frames: Sequence[Literal["world", "camera"]] = ("world", "camera"),
        steps: int = 200,
        learning_rate: float = 0.05,
        batch_pixels: int = 4096,
        seed: int = 0,
    ) -> None:
        """`scene`, `capture` and `downsample` are the arguments of `ReflectanceRenderer.prepare`.

        `prepared`: the renderer's pixels, differentiable in material and light.
        `kinds`: the materials that the renderer shows, of `diffuse`, `paper` and `dielectric`; others are left out.
        `frames`: the frames in which it can place a light.
        `steps`: of Adam in a full fit; the model selection asks for a share of them first.
        `learning_rate`: of Adam, for all maps and the light; it falls to a tenth (cosine).
        `batch_pixels`: pixels of a step, drawn from all views.
        `seed`: of these pixels; give it that of `seed_of_run`.
        """
        self._prepared, self._scene, self._capture, self._downsample = prepared, scene, capture, downsample
        self._kinds = [kind for kind in kinds if kind in ("diffuse", "paper", "dielectric")]
        self._frames, self._steps, self._seed = tuple(frames), steps, seed
        self._settings = GradientSettings(
            learning_rate=learning_rate, learning_rate_end=LEARNING_RATE_END, batch_pixels=batch_pixels
        )
        self._terms: tuple[WeightedTerm, ...] = ()

    def with_terms(self, terms: Sequence[WeightedTerm]) -> GradientSolver:
        """The same solver, whose steps minimise the terms too."""
        other = GradientSolver(self._prepared, self._scene, self._capture, self._downsample)
        other.__dict__.update(self.__dict__, _terms=tuple(terms))
        return other

    def radiance(
        self, material: Material, environment: EnvironmentMap, pixels: Int[Tensor, "B 3"]
    ) -> Float[Tensor, "B 3"]:
        """The renderer's."""
        return self._prepared.radiance(material, environment, pixels)

    def supported(self, spec: ModelSpec) -> ModelSpec | None:
        """Without indirect light, shading normals and per-texel BRDFs; None for other kinds of material or light."""
        if spec.kind not in self._kinds or spec.light_frame not in self._frames or spec.lamp:
            return None
        return replace(spec, bounces=0, normals="mesh", per_texel="none", colored=False)

    def fit(
        self,
        spec: ModelSpec,
        initial: GradientFit | None,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None = None,
        pixel_share: float = 1.0,
    ) -> GradientFit:
        """Adam on textures and light, from the earlier fit or from the texture and the light of the prepared scene."""
        start = self._start(spec, initial)
        stored = _stored(checkpoint, start)
        if stored is None:
            stored = self._fitted(start, self._prepared, spec, views, effort, report, checkpoint, pixel_share)
            if checkpoint is not None:
                _store(checkpoint, stored)
        report(1.0)
        return GradientFit(spec, stored)

    def errors(self, fit: GradientFit, views: Sequence[int]) -> NDArray[np.float64]:
        """Mean squared sRGB error of each view over at most `COMPARED_PIXELS` of its object pixels."""
        material, light = _parts(fit.scene)
        found = []
        for view in views:
            pixels = self._pixels([view])
            rows = torch.arange(0, len(pixels.index), -(-len(pixels.index) // COMPARED_PIXELS))
            with torch.no_grad():
                shown = self._prepared.radiance(material, light, pixels.index[rows]).clamp(0, 1)
            difference = linear_to_srgb(shown) - linear_to_srgb(pixels.color[rows].clamp(0, 1))
            difference = without_clipped_excess(difference, pixels.saturated[rows])
            found.append(float(difference.double().square().mean()))
        return np.array(found)

    def scene(self, fit: GradientFit, views: Sequence[int], report: Callable[[float], None]) -> Solved[GradientFit]:
        """The fitted scene: its textures are those of the fit."""
        report(1.0)
        error = significant(float(self.errors(fit, views).mean()))
        return Solved(fit.scene, self._prepared, fit, {"mean_squared_srgb_error": error})

    def refine(
        self,
        solved: Solved[GradientFit],
        traced: PreparedReflectance | None,
        views: Sequence[int],
        report: Callable[[float], None],
    ) -> Solved[GradientFit] | None:
        """The albedo after steps that explain the photographs less what `traced` shows more than this renderer."""
        scene, spec = solved.scene, solved.refinement.spec
        pixels = self._pixels(views)
        if traced is not None:
            material, light = _parts(scene)
            torch.manual_seed(self._seed)
            with torch.no_grad():
                offset = torch.cat(
                    [
                        traced.radiance(material, light, rows) - self._prepared.radiance(material, light, rows)
                        for rows in pixels.index.split(COMPARED_PIXELS)
                    ]
                )
            # a non-finite pixel asks for no change
            offset = torch.where(torch.isfinite(offset), offset, torch.zeros_like(offset))
            pixels = replace(pixels, color=(pixels.color - offset).clamp_min(0))
        refined = self._fitted(
            scene, self._prepared, spec, views, REFINEMENT_EFFORT, report, None, pixels=pixels, albedo_only=True
        )
        return replace(solved, scene=refined, refinement=GradientFit(spec, refined))

    def _fitted(
        self,
        start: Scene,
        prepared: PreparedReflectance,
        spec: ModelSpec,
        views: Sequence[int],
        effort: float,
        report: Callable[[float], None],
        checkpoint: CheckpointLocation | None,
        pixel_share: float = 1.0,
        *,
        pixels: ObjectPixels | None = None,
        albedo_only: bool = False,
    ) -> Scene:
        batch = max(1, round(pixel_share * self._settings.batch_pixels))
        # the photometric term is a sum over pixels and channels; a weight counts against their mean
        energies = {term.name: (3 * batch * term.weight, term.prepare(start)) for term in self._terms}
        warnings: list[str] = []
        run = _Run(
            self._seed,
            lambda progress: report(progress.step / progress.steps),
            None if checkpoint is None else checkpoint.stem.parent,
            0.0 if checkpoint is None else checkpoint.seconds,
            warnings.append,
        )
        fitted, _ = fit_by_gradient(
            start,
            prepared,
            self._pixels(views) if pixels is None else pixels,
            replace(self._settings, batch_pixels=batch),
            Energies(energies),
            run,
            steps=max(1, round(effort * self._steps)),
            fit_light=not (spec.light_is_known or albedo_only),
            fit_specular=spec.brdf != "diffuse" and not albedo_only,
            checkpoint="" if checkpoint is None else f"{checkpoint.stem.name}.state",
        )
        if warnings:
            raise StageError(f"the fit of {spec.name}: {warnings[0]}")
        return fitted

    def _start(self, spec: ModelSpec, initial: GradientFit | None) -> Scene:
        """The maps and the light that a model has, from the earlier fit or from the prepared scene."""
        scene = self._scene if initial is None else initial.scene
        material, light = _parts(scene)
        light = EnvironmentMap(light.radiance, light.to_world, spec.light_frame)
        diffuse = material.diffuse_albedo
        if spec.brdf == "diffuse":
            matt = Material("paper", diffuse, diffuse.new_zeros(3), diffuse.new_ones(1))
            return replace(scene, material=matt, environment=light)
        if initial is not None and initial.spec.brdf == "diffuse":
            material = _parts(self._scene)[0]
        shape = diffuse.shape[:2]
        specular, roughness = material.specular_albedo, material.roughness
        if spec.specular == "map" and specular.ndim == 1:
            specular = specular.expand(*shape, 3).contiguous()
        if spec.roughness == "map" and roughness.ndim == 1:
            roughness = roughness.expand(*shape, 1).contiguous()
        assert spec.brdf != "metallic", "`supported` returns no metal"
        return replace(scene, material=Material(spec.brdf, diffuse, specular, roughness), environment=light)

    def _pixels(self, views: Sequence[int]) -> ObjectPixels:
        return object_pixels(self._capture, views, self._downsample, str(self._scene.mesh.positions.device))


def _parts(scene: Scene) -> tuple[Material, EnvironmentMap]:
    assert scene.material is not None and scene.environment is not None
    return scene.material, scene.environment


def _named(scene: Scene) -> Mapping[str, Tensor]:
    material, light = _parts(scene)
    return {
        "diffuse_albedo": material.diffuse_albedo,
        "specular_albedo": material.specular_albedo,
        "roughness": material.roughness,
        "radiance": light.radiance,
    }


def _store(checkpoint: CheckpointLocation, scene: Scene) -> None:
    arrays = {name: value.cpu().numpy() for name, value in _named(scene).items()}
    write_arrays(checkpoint.stem.with_suffix(".npz"), arrays)
    checkpoint.stem.with_suffix(".state.npz").unlink(missing_ok=True)


def _stored(checkpoint: CheckpointLocation | None, start: Scene) -> Scene | None:
    """The scene of a finished fit; None where there is none of these shapes."""
    arrays = {} if checkpoint is None else read_arrays(checkpoint.stem.with_suffix(".npz"))
    named = _named(start)
    if any(name not in arrays or arrays[name].shape != tuple(value.shape) for name, value in named.items()):
        return None
    found = {name: torch.from_numpy(np.array(arrays[name])).to(value) for name, value in named.items()}
    material, light = _parts(start)
    radiance = found.pop("radiance")
    return replace(start, material=replace(material, **found), environment=replace(light, radiance=radiance))  # type: ignore[arg-type]
