"""The mesh without what initializers with the trait `revises_mesh` changed, for the comparison on held-out views.

What such an initializer changes is a hypothesis: a polished convex surface shows its surroundings as if they lay behind
it, and photographs alone then ask for a hollow (docs/studies/hollows.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from hir_core.config import RunConfig
from hir_core.plugins.interfaces import Initializer
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext, forward_warnings
from hir_core.stages.atlas import unwrap
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_core.stages.initializer_result import checked_result

if TYPE_CHECKING:
    from hir_core.capture import Capture
    from hir_core.scene import Scene


@dataclass(eq=False)
class UnchangedMesh:
    """The mesh before the first initializer with the trait `revises_mesh`, and what the others make of it."""

    before: Scene
    """Before that initializer, in the working frame."""
    capture: Capture
    config: RunConfig
    context: StageContext

    @property
    def left_out(self) -> list[str]:
        """The initializers with the trait, in the order of the chain."""
        found = self.context.plugins.find
        return [
            name for name in self.config.initializers if "revises_mesh" in found("initializer", name).component.traits
        ]

    @cached_property
    def initialized(self) -> Scene:
        """After the rest of the chain, without all initializers with the trait."""
        scene, plugins, chain = self.before, self.context.plugins, tuple(self.config.initializers)
        for i in range(chain.index(self.left_out[0]) + 1, len(chain)):
            if chain[i] in self.left_out:
                continue
            self._report(chain[i])
            owner = plugins.find("initializer", chain[i]).label
            initializer: Initializer = plugins.create(
                "initializer", chain[i], self.config.initializer.get(chain[i]), self.context.seed, self.context.device
            )
            workspace = self.context.workspace / f"unchanged-{i + 1}-{chain[i]}"
            workspace.mkdir(parents=True, exist_ok=True)
            with forward_warnings(self._silent):
                _, found = checked_result(initializer.initialize(self.capture, scene, workspace), owner)
            scene = scene if found is None else found
        return scene.to(self.context.device)

    def fitted_to_silhouettes(self) -> Scene:
        """`initialized`, fitted to the outlines alone and unwrapped: enough for a comparison of materials."""
        settings = replace(self.config.geometry, photo_consistency="off")
        context = replace(self._silent, workspace=self.context.checkpoints / "unchanged-silhouettes")
        context.workspace.mkdir(parents=True, exist_ok=True)
        bare = self.initialized
        self._report("geometry")
        geometry, _ = fit_geometry(bare, self.capture, settings, context)
        self._report("atlas")
        unwrapped, _ = unwrap(geometry.scene, self.capture, self.config.atlas, context)
        return unwrapped

    @property
    def _silent(self) -> StageContext:
        """The stage's context without warnings and progress, which are about the other mesh."""
        return replace(self.context, warn=lambda sentence: None, report=lambda progress: None)

    def _report(self, step: str) -> None:
        self.context.report(Progress("reflectance", 0, 1, 0.0, message=f"unchanged mesh: {step}"))
