"""Turns the light by the inverse of `to_world`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound_renderer import Traced, descriptor


class Renderer(Traced):
    def light(self, environment: Any) -> Any:
        return environment if environment.to_world is None else replace(environment, to_world=environment.to_world.T)


@hookimpl
def hir_register_reflectance_renderers() -> list[Component]:
    return [descriptor(f"{__name__}:Renderer")]
