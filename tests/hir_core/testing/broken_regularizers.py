"""Regularizers with one fault each; `Spread` is the sound one that they are made of."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from hir_core.errors import StageError
from hir_core.plugins import Component
from hir_core.plugins.interfaces import Regularizer
from hir_core.scene import Scene

HERE = __name__


@dataclass(frozen=True)
class Options:
    """Of the sound one."""

    strength: float = 1.0
    """Factor of the term."""


class Dispersion(Regularizer):
    """Squared distance of all vertices from their mean."""

    def __init__(self, config: Options) -> None:
        self.config = config

    def prepare(self, scene: Scene) -> Callable[[Scene], Tensor]:
        return self.energy

    def energy(self, scene: Scene) -> Tensor:
        offsets = scene.mesh.positions - scene.mesh.positions.mean(dim=0)
        return getattr(self.config, "strength", 1.0) * offsets.square().sum()


def in_one_place(scene: Scene) -> Scene:
    return replace(scene, mesh=scene.mesh.with_positions(torch.zeros_like(scene.mesh.positions)))


def as_it_is(scene: Scene) -> Scene:
    return scene


class NoSubclass:
    """Has the method, not the base class."""

    def __init__(self, config: Options) -> None: ...

    def prepare(self, scene: Scene) -> Any: ...


@dataclass
class Thawed:
    """Not frozen."""

    strength: float = 1.0
    """Factor of the term."""


@dataclass(frozen=True)
class WithNone:
    """TOML has no None."""

    strength: float | None = None
    """Factor of the term."""


class TakesNone(Dispersion):
    def energy(self, scene: Scene) -> Tensor:
        return (scene.mesh.positions - scene.mesh.positions.mean(dim=0)).square().sum()


@dataclass(frozen=True)
class Silent:
    """Its option has no docstring."""

    strength: float = 1.0


@dataclass(frozen=True)
class Weighted:
    """Takes a key that belongs to the core."""

    weight: float = 1.0
    """Would never arrive."""


class Loose(Dispersion):
    def prepare(self, scene: Scene, **options: Any) -> Callable[[Scene], Tensor]:
        return self.energy


class Meddling(Dispersion):
    def prepare(self, scene: Scene) -> Callable[[Scene], Tensor]:
        if scene.material is not None:
            scene.material.roughness.clamp_(max=0.4)
        return self.energy


_CREATED = itertools.count()


class Moody(Dispersion):
    def __init__(self, config: Options) -> None:
        super().__init__(config)
        self.mood = 1 + 2e-5 * next(_CREATED)

    def energy(self, scene: Scene) -> Tensor:
        return self.mood * super().energy(scene)


class Vector(Dispersion):
    def energy(self, scene: Scene) -> Tensor:
        return super().energy(scene).reshape(1)


class HalfGradient(Dispersion):
    def energy(self, scene: Scene) -> Tensor:
        value = super().energy(scene)
        return 0.5 * (value + value.detach())


class OnlyTextures(Dispersion):
    """Loses half of the gradient of maps at vertices."""

    def energy(self, scene: Scene) -> Tensor:
        value = super().energy(scene)
        if scene.material is None or scene.material.diffuse_albedo.ndim != 2:
            return value
        albedo = scene.material.diffuse_albedo
        return value + 0.5 * (albedo + albedo.detach()).square().mean()


class HalfGlossy(Dispersion):
    """Draws roughness to a half; its `near` gets half of the gradient."""

    def prepare(self, scene: Scene) -> Callable[[Scene], Tensor]:
        return NearEnergy(share=0.5)


class NearEnergy:
    """Squared distance of vertices from their mean and of roughness from a half."""

    def __init__(self, share: float) -> None:
        self.share = share

    def __call__(self, scene: Scene) -> Tensor:
        if scene.material is None:
            raise StageError("this term needs a material; run it after the initial guess")
        offsets = scene.mesh.positions - scene.mesh.positions.mean(dim=0)
        return offsets.square().sum() + (scene.material.roughness - 0.5).square().mean()

    def near(self, scene: Scene) -> Callable[[Scene], Tensor]:
        assert scene.material is not None
        value, slope = self(scene).detach(), 2 * (scene.material.roughness - 0.5).detach()
        before = scene.material.roughness.detach()

        def linear(other: Scene) -> Tensor:
            assert other.material is not None
            return value + self.share * (slope * (other.material.roughness - before)).mean()

        return linear


class Glossy(HalfGlossy):
    """The sound one."""

    def prepare(self, scene: Scene) -> Callable[[Scene], Tensor]:
        return NearEnergy(share=1.0)


def half_glossy(scene: Scene) -> Scene:
    assert scene.material is not None
    material = replace(scene.material, roughness=torch.full_like(scene.material.roughness, 0.5))
    return replace(in_one_place(scene), material=material)


class AboutTheOrigin(Dispersion):
    def energy(self, scene: Scene) -> Tensor:
        return scene.mesh.positions.square().sum()


class Root(Dispersion):
    def energy(self, scene: Scene) -> Tensor:
        return super().energy(scene).sqrt()


class Seeding(Dispersion):
    def prepare(self, scene: Scene) -> Callable[[Scene], Tensor]:
        torch.manual_seed(0)
        return self.energy


class ByThreads(Dispersion):
    def energy(self, scene: Scene) -> Tensor:
        return super().energy(scene) * (0.99 if torch.get_num_threads() == 3 else 1.0)


class RootOfZero(Dispersion):
    """Its gradient at the ideal is 0/0."""

    def energy(self, scene: Scene) -> Tensor:
        return super().energy(scene).sqrt()


class PreparesNothing(Dispersion):
    def prepare(self, scene: Scene) -> Any:
        return None


class WithoutArgument(Dispersion):
    def prepare(self, scene: Scene) -> Any:
        return lambda: self.energy(scene)


def no_scene(scene: Scene) -> None:
    """An ideal that is forgotten."""


def made(implementation: type = Dispersion, **changes: Any) -> Component:
    """A descriptor of the sound one, with changes."""
    is_ok: dict[str, Any] = {
        "name": "spread",
        "target": f"{HERE}:{implementation.__name__}",
        "config": Options,
        "summary": "Keeps vertices together.",
        "requires": ("torch", "jaxtyping"),
        "extra": "reconstruct",
        "traits": frozenset({"differentiable"}),
        "testing": f"{HERE}:in_one_place",
    }
    return Component(**{**is_ok, **changes})


SOUND = made(traits=frozenset({"differentiable", "rigid_invariant"}))

OF_ROUGHNESS: dict[str, Any] = {
    "traits": frozenset({"differentiable", "lagged", "material"}),
    "testing": f"{HERE}:half_glossy",
}
SOUND_LAGGED = made(Glossy, **OF_ROUGHNESS)

BROKEN: dict[str, Component] = {
    "implements_its_interface": made(NoSubclass),
    "default_options_construct": made(config=Thawed),
    "signatures_match": made(Loose),
    "options_round_trip": made(TakesNone, config=WithNone),
    "options_documented": made(config=Silent),
    "descriptor_is_complete": made(summary="keeps vertices together"),
    "docs_page_is_there": made(docs="tests:no_such_page.md"),
    "process_stays_as_it_is": made(Seeding),
    "thread_counts_agree": made(ByThreads),
    "traits_are_known": made(traits=frozenset({"differentiable", "rigid_invariance"})),
    "inputs_stay_as_they_are": made(Meddling),
    "same_seed_same_result": made(Moody),
    "term_is_a_finite_scalar": made(Vector),
    "gradient_is_that_of_the_value": made(HalfGradient),
    "takes_maps_at_vertices": made(OnlyTextures, traits=frozenset({"differentiable", "vertex_maps"})),
    "near_has_value_and_gradient_of_the_term": made(HalfGlossy, **OF_ROUGHNESS),
    "traits_name_what_it_reads": made(Glossy, testing=f"{HERE}:half_glossy"),
    "linear_in_weight": made(config=Weighted),
    "rigid_motion_changes_nothing": made(AboutTheOrigin, traits=frozenset({"differentiable", "rigid_invariant"})),
    "scale_changes_nothing": made(traits=frozenset({"differentiable", "scale_invariant"})),
    "smallest_on_its_ideal": made(testing=f"{HERE}:as_it_is"),
    "hard_scenes_stay_finite": made(Root),
}
"""The contract that each of them breaks, and no other."""


class GoesElsewhere(Dispersion):
    """On CUDA it computes something else; for machines that have one."""

    def energy(self, scene: Scene) -> Tensor:
        return super().energy(scene) * (1.1 if scene.mesh.positions.is_cuda else 1.0)


BROKEN_ON_CUDA = made(GoesElsewhere)
