"""A regularizer: light is whiter than surfaces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, final

from hir_core.errors import StageError
from hir_core.plugins.interfaces import Regularizer
from hir_example.options import LightChromaOptions

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.scene import Scene


@final
class LightChroma(Regularizer):
    """Mean over texels of `‖L − grey(L)‖² / (grey(L) + floor)²`: the tint, whatever the brightness."""

    def __init__(self, config: LightChromaOptions) -> None:
        self._floor = config.floor

    def prepare(self, scene: Scene) -> Callable[[Scene], Tensor]:
        """Needs a light."""
        if scene.environment is None:
            raise StageError("light_chroma needs a light; it belongs to the reflectance stage")

        def energy(scene: Scene) -> Tensor:
            assert scene.environment is not None
            radiance = scene.environment.radiance
            grey = radiance.mean(dim=-1, keepdim=True)
            return ((radiance - grey) / (grey + self._floor)).square().sum(dim=-1).mean()

        return energy


def grey_light(scene: Scene) -> Scene:
    """The scene that minimises the term, for the contract tests: a light without colour."""
    assert scene.environment is not None
    grey = scene.environment.radiance.mean(dim=-1, keepdim=True).expand_as(scene.environment.radiance)
    return replace(scene, environment=replace(scene.environment, radiance=grey.contiguous()))
