"""The bake stage: the fitted scene as an asset in the place and scale of the capture's own files, +Y up."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hir_exporters.asset import Asset, describe
from hir_exporters.light.environment_map import FIRST_VIEW_KEY

from hir_core.run.machine import versions
from hir_core.scene.asset_conversion import bake
from hir_core.scene.frames import move_scene

if TYPE_CHECKING:
    from hir_core.stages.run_state import RunState


@dataclass(frozen=True)
class BakeReport:
    """What the asset holds: counts, sizes of textures, the light."""

    description: dict[str, Any]

    def as_document(self) -> dict[str, Any]:
        """For run.json."""
        return self.description


def bake_stage(state: RunState) -> tuple[Asset, BakeReport]:
    """The asset; its provenance holds nothing that differs between two equal runs."""
    assert state.scene is not None and state.frames is not None
    provenance = {
        "generator": f"hir {versions().get('hir', '')}".strip(),
        "capture": state.source.name,
        "fingerprint": state.source.fingerprint,
        "preset": state.config.preset,
        "seed": state.config.seed,
    }
    if state.scene.environment is not None and state.scene.environment.frame == "camera":
        provenance[FIRST_VIEW_KEY] = state.capture.cameras[0].world_to_camera[:3, :3].T.tolist()
    moved = move_scene(state.scene, state.frames.asset_from_working)
    asset = bake(moved, name=state.source.name, provenance=provenance)
    return asset, BakeReport(describe(asset))
