"""Warnings about a fitted mesh: what a user should check, and what to change."""

from __future__ import annotations

from hir_core.mesh.mesh_validity import MeshState
from hir_core.run.stage_context import StageContext
from hir_core.stages.geometry.geometry_report import IouChange
from hir_core.stages.geometry.silhouettes.silhouette_fit import SilhouetteFit
from hir_core.stages.geometry.silhouettes.silhouette_residual import SilhouetteResidual

NOTABLE_MASK_SHARE = 1e-3
"""Share of the masks' area from which missing or filled parts cause a warning."""

NOTABLE_IOU_LOSS = 0.005
"""Loss of IoU of held-out views over the stage that causes a warning."""


def warn_of_iou_loss(held_out: IouChange, context: StageContext) -> None:
    """Warns where the silhouettes of held-out views fit worse than those of the initial mesh."""
    before, after = held_out.before, held_out.after
    if before is not None and after is not None and before - after > NOTABLE_IOU_LOSS:
        context.warn(
            "the silhouettes of the held-out views fit worse than those of the initial mesh "
            f"(IoU {before:.4f} → {after:.4f}); try more triangles (geometry.triangles), "
            "or geometry.photo_consistency='off'"
        )


def warn_of_residual(residual: SilhouetteResidual, names: list[str], context: StageContext) -> None:
    """Warns of parts that the mesh misses and of gaps that it fills."""
    if residual.missing > NOTABLE_MASK_SHARE:
        view, share = residual.worst_missing
        context.warn(
            f"the mesh misses {residual.missing:.1%} of the masks' area away from the outline (most in view "
            f"{names[view]}: {share:.1%}): thin parts that the initial mesh lacks cannot grow back; "
            "use a finer initial mesh"
        )
    if residual.filled > NOTABLE_MASK_SHARE:
        view, share = residual.worst_filled
        context.warn(
            f"the mesh covers {residual.filled:.1%} more than the masks away from the outline (most in view "
            f"{names[view]}: {share:.1%}): gaps that the initial mesh has closed cannot open again; "
            "use a finer initial mesh"
        )


def warn_of_masks(fit: SilhouetteFit) -> None:
    """Names the views whose masks contradict the others."""
    for view, weight in fit.view_weights.down_weighted().items():
        fit.context.warn(
            f"the mask of view {fit.names[view]} contradicts the others and counts {weight:.0%}; "
            "check it or leave the view out"
        )


def warn_of_defects(before: MeshState, after: MeshState, context: StageContext) -> None:
    """Warns where the stage broke the mesh: holes, other components, self-intersections."""
    if before.watertight and not after.watertight:
        context.warn("the fitted mesh is no longer watertight; try fewer triangles or geometry.remesh=false")
    if after.components != before.components:
        context.warn(f"the fitted mesh has {after.components} components, the initial mesh {before.components}")
    if after.self_intersecting > before.self_intersecting:
        context.warn(
            f"{after.self_intersecting} triangles of the fitted mesh pass through others "
            f"(initial mesh: {before.self_intersecting}); a larger geometry.smoothness avoids that"
        )
