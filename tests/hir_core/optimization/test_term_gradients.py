"""Why a regularizer had no effect."""

from __future__ import annotations

from typing import Any

import pytest
import torch

from hir_core.optimization.term_gradients import value_and_gradients, why_without_effect
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology


def scene(roughness: Any) -> Scene:
    """A triangle with a map of albedo."""
    mesh = Mesh(torch.eye(3), Topology(torch.tensor([[0, 1, 2]])))
    albedo = torch.linspace(0.1, 0.9, 48).reshape(4, 4, 3)
    return Scene(mesh, Material("paper", albedo, torch.zeros(3), roughness), EnvironmentMap(torch.ones(2, 4, 3)))


def of_roughness(scene: Scene) -> torch.Tensor:
    """A term of the roughness alone."""
    assert scene.material is not None
    return (scene.material.roughness - scene.material.roughness.mean()).square().sum()


def of_albedo(scene: Scene) -> torch.Tensor:
    """A term of the albedo alone."""
    assert scene.material is not None
    return scene.material.diffuse_albedo.square().sum()


def of_the_mesh(scene: Scene) -> torch.Tensor:
    """A term of neither material nor light."""
    return scene.mesh.positions.sum()


CONSTANT, MAP = torch.tensor([0.3]), torch.linspace(0.1, 0.9, 16).reshape(4, 4, 1)


@pytest.mark.parametrize(
    ("term", "roughness", "traits", "sentence"),
    [
        (of_the_mesh, CONSTANT, {"material"}, "depends on neither material nor light"),
        (of_roughness, CONSTANT, {"material"}, "whose roughness is one value for the whole surface"),
        (of_roughness, CONSTANT, None, "whose roughness is one value for the whole surface"),
        (of_roughness, MAP, {"material"}, ""),
        (of_albedo, CONSTANT, {"material"}, ""),
        (of_albedo, CONSTANT, set(), "depends on diffuse_albedo, but lacks the trait 'material'"),
        (of_albedo, CONSTANT, None, ""),  # gradient steps use no traits
    ],
)
def test_why_a_term_had_no_effect(term: Any, roughness: Any, traits: set[str] | None, sentence: str) -> None:
    """Each reason, and none for a term that acts."""
    fitted = scene(roughness)
    said = why_without_effect(fitted, value_and_gradients(term, fitted)[1], traits)
    assert sentence in said and bool(said) == bool(sentence)
