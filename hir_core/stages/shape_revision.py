"""Shape after material: held-out views decide what initializers with the trait `revises_mesh` change in the mesh.

The first mesh comes from photographs alone. Where a surface reflects other parts of the object or its surroundings,
photographs say little about it before the material and the light are known. So the mesh without what these initializers
changed is compared with the changed one, with a material and a light; and afterwards they are asked again, with the
fitted material and light. Another mesh is fitted like the first one: geometry, atlas, material and light. It replaces
the first one where photographs that no fit has seen are explained better.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from hir_core.config import RunConfig
from hir_core.plugins.interfaces import Initializer
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from hir_core.run.machine import return_freed_memory
from hir_core.run.stage_context import StageContext, forward_warnings
from hir_core.stages.atlas import unwrap
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_core.stages.initializer_result import checked_report, checked_result
from hir_core.stages.reflectance.reflectance_fit import FittedReflectance, fit_reflectance
from hir_core.stages.reflectance.reflectance_report import RevisionReport, unchanged_mesh_report
from hir_core.stages.reflectance.selection.held_out_comparison import is_within_noise, paired_gain
from hir_core.stages.reflectance.selection.shape_selection import OtherMeshSelectedError
from hir_core.stages.unchanged_mesh import UnchangedMesh

if TYPE_CHECKING:
    from jaxtyping import Float
    from torch import Tensor

    from hir_core.capture import Capture
    from hir_core.scene import Scene


@dataclass(frozen=True, eq=False)
class _RevisedMesh:
    """What the initializers made of the fitted scene."""

    scene: Scene
    details: Mapping[str, Mapping[str, Any]]
    """The report of each initializer that was asked."""
    changed: bool


def fit_reflectance_and_revise(
    scene: Scene,
    capture: Capture,
    config: RunConfig,
    context: StageContext,
    silhouette_positions: Float[Tensor, "V 3"] | None = None,
    unchanged_scene: Scene | None = None,
) -> FittedReflectance:
    """`fit_reflectance`, a second time on the mesh that the initializers of the chain with the trait `revises_mesh`
    make of its result, where they change it.

    Not where the settings switch the geometry stage off, or where no held-out views judge a fit. `unchanged_scene` is
    the one before such an initializer changed the mesh; None where none did.
    """
    warnings: list[str] = []
    names = revising_initializers(config, context.plugins)
    first = _fit_on_better_mesh(
        scene,
        capture,
        config,
        replace(context, warn=warnings.append),
        silhouette_positions,
        unchanged_scene if names else None,
    )
    if not names or first.held_out_errors is None:
        _repeat(warnings, context)
        return first
    revised = _revised(first, capture, config, names, context)
    if not revised.changed:
        _repeat(warnings, context)
        return _reported(first, RevisionReport(tuple(names), revised.details, changed=False))
    warnings_of_second: list[str] = []
    bare = replace(revised.scene, material=None, environment=None, take_radiance={})
    second = _fitted_again(bare, capture, config, replace(context, warn=warnings_of_second.append), "revised")
    assert second.held_out_errors is not None
    gain, standard_error = paired_gain(first.held_out_errors, second.held_out_errors)
    accepted = gain > 0
    views = len(first.held_out_errors)
    report = RevisionReport(
        tuple(names),
        revised.details,
        True,
        accepted,
        round(gain, 3),
        round(standard_error, 3),
        views,
        is_within_noise(gain, standard_error, views),
        _sentence(gain, standard_error, accepted),
    )
    _repeat(warnings_of_second if accepted else warnings, context)
    return _reported(second if accepted else first, report)


def _fit_on_better_mesh(
    scene: Scene,
    capture: Capture,
    config: RunConfig,
    context: StageContext,
    silhouette_positions: Float[Tensor, "V 3"] | None,
    unchanged_scene: Scene | None,
) -> FittedReflectance:
    """`fit_reflectance` with the mesh of the scene, or, where held-out views prefer it, with the unchanged one."""
    if unchanged_scene is None:
        return fit_reflectance(scene, capture, config.reflectance, context, silhouette_positions)
    unchanged = UnchangedMesh(unchanged_scene, capture, config, context)
    warnings: list[str] = []
    found, comparison = None, None
    try:
        found = fit_reflectance(
            scene,
            capture,
            config.reflectance,
            replace(context, warn=warnings.append),
            silhouette_positions,
            unchanged.fitted_to_silhouettes,
        )
        comparison = found.with_other_mesh
        _repeat(warnings, context)
    except OtherMeshSelectedError as error:  # the warnings were about the other mesh
        comparison = error.comparison
    if found is None:  # after the handler, as the error keeps the solvers of both meshes in memory
        return_freed_memory()
        found = _fitted_again(unchanged.initialized, capture, config, context, "unchanged")
    report = unchanged_mesh_report(comparison, unchanged.left_out)
    return replace(found, report=replace(found.report, unchanged_mesh=report))


def revising_initializers(config: RunConfig, plugins: PluginManager) -> list[str]:
    """Those of the resolved chain that revise a mesh after the material is known; none where the settings forbid it."""
    if not (config.reflectance.revise_mesh and config.geometry.enabled):
        return []
    return [
        name for name in config.initializers if "revises_mesh" in plugins.find("initializer", name).component.traits
    ]


def _revised(
    fitted: FittedReflectance, capture: Capture, config: RunConfig, names: list[str], context: StageContext
) -> _RevisedMesh:
    """By the first initializer that changes the mesh: others would need a fit to the changed one."""
    exposed = fitted.exposures.applied_to(capture)
    details = {}
    for name in names:
        context.report(Progress("reflectance", 0, 1, 0.0, message=f"{name} with the fitted material"))
        initializer: Initializer = context.plugins.create(
            "initializer", name, config.initializer.get(name), context.seed, context.device
        )
        owner = context.plugins.find("initializer", name).label
        workspace = context.workspace / f"revision-{name}"
        workspace.mkdir(parents=True, exist_ok=True)
        with forward_warnings(context):
            _, found = checked_result(initializer.initialize(exposed, fitted.scene, workspace), owner)
        details[name] = checked_report(initializer, owner)
        if found is not None and found.mesh is not fitted.scene.mesh:
            return _RevisedMesh(replace(fitted.scene, mesh=found.mesh), details, True)
    return _RevisedMesh(fitted.scene, details, False)


def _fitted_again(
    scene: Scene, capture: Capture, config: RunConfig, context: StageContext, which: str
) -> FittedReflectance:
    """Geometry, atlas, material and light on another mesh, from the beginning: a first wrong mesh led to a wrong
    material. `which` mesh it is, for the progress and the folder.
    """

    def report(progress: Progress) -> None:
        # curves and milestones are those of the first fit
        message = f"{which} mesh: {progress.message or progress.stage}"
        context.report(replace(progress, stage="reflectance", message=message, scalars={}, milestone=""))

    again = replace(context, workspace=context.checkpoints / which, report=report)
    again.workspace.mkdir(parents=True, exist_ok=True)
    geometry, _ = fit_geometry(scene.to(context.device), capture, config.geometry, again)
    again.report(Progress("atlas", 0, 1, 0.0))
    unwrapped, _ = unwrap(geometry.scene, capture, config.atlas, again)
    again.report(Progress("reflectance", 0, 1, 0.0, message="material and light"))
    return fit_reflectance(unwrapped, capture, config.reflectance, again, geometry.silhouette_positions)


def _reported(fitted: FittedReflectance, revision: RevisionReport) -> FittedReflectance:
    return replace(fitted, report=replace(fitted.report, revision=revision))


def _repeat(warnings: list[str], context: StageContext) -> None:
    for sentence in warnings:
        context.warn(sentence)


def _sentence(gain: float, standard_error: float, accepted: bool) -> str:
    kept = "the revised mesh is kept" if accepted else "the first mesh is kept"
    change = "gain" if gain >= 0 else "lose"
    return f"{kept}: with the revised one held-out views {change} {abs(gain):.1f} ± {standard_error:.1f} dB"
