"""Stage: from photographs to cameras, masks and a first mesh, in the working frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hir_core.capture import Capture
from hir_core.capture.capture_store import file_hash
from hir_core.config import RunConfig
from hir_core.errors import CaptureError, StageError
from hir_core.plugins.interfaces import Initializer, MaskSource
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext, passed_on
from hir_core.scene import Scene
from hir_core.scene.frames import move_scene, unit_similarity


def initialize(
    capture: Capture, config: RunConfig, context: StageContext
) -> tuple[tuple[Capture, Scene], dict[str, Any]]:
    """Runs the chain of initializers with mask sources between them (DESIGN section 5); all ends in the working frame.

    The report holds `working_from_asset`, 4×4: the asset's frame is the one that the initializers ended in.
    """
    scene: Scene | None = None
    capture = _apply_masks(capture, scene, config, context, with_cameras=False)
    # after the masks: what a capture still lacks without them decides on the chain
    chain = _chain(capture, config, context)
    report: dict[str, Any] = {"initializers": chain}
    details: dict[str, Any] = {}
    masked = False
    for i, name in enumerate(chain):
        if not masked and capture.views and all(view.camera is not None for view in capture.views):
            capture = _apply_masks(capture, scene, config, context, with_cameras=True)
            masked = True
        context.report(Progress("initializer", i, len(chain), 0.0, message=name))
        initializer: Initializer = context.plugins.create("initializer", name, config.initializer.get(name))
        workspace = context.workspace / f"{i + 1}-{name}"
        workspace.mkdir(parents=True, exist_ok=True)
        with passed_on(context):
            capture, scene = initializer.initialize(capture, scene, workspace)
        details |= {name: dict(found)} if (found := initializer.report()) else {}
        capture = _registered_only(capture, context)
    if scene is None:
        raise StageError(
            f"the initializers {', '.join(chain)} made no surface; end the chain with one that does, "
            "such as visual_hull or mesh_file"
        )
    working_from_asset = unit_similarity(scene.mesh)
    report |= {
        "working_from_asset": working_from_asset.tolist(),
        "views": len(capture.views),
        "masked_views": sum(view.pixels().mask is not None for view in capture.views),
        "vertices": len(scene.mesh.positions),
        "triangles": len(scene.mesh.faces),
        "details": details,
    }
    moved = move_scene(scene, working_from_asset).to(context.device)
    return (capture.transformed(working_from_asset), moved), report


def files_read(chain: Sequence[str], capture: Capture, config: RunConfig, plugins: PluginManager) -> list[str]:
    """Hashes of the files beyond the photographs that the stage's components read: other files, another result."""
    components = [("mask_source", name, config.mask_source) for name in _mask_sources(config, plugins)]
    components += [("initializer", name, config.initializer) for name in chain]
    hashes: list[str] = []
    for kind, name, options in components:
        if "reads_files" in plugins.find(kind, name).component.traits:
            component: MaskSource | Initializer = plugins.create(kind, name, options.get(name))
            hashes += [file_hash(path) for path in component.files(capture)]
    return hashes


def _mask_sources(config: RunConfig, plugins: PluginManager) -> list[str]:
    if config.masks != "auto":
        return list(config.masks)
    offered = plugins.components("mask_source")
    return [r.component.name for r in offered if "automatic" in r.component.traits and not r.missing]


def _chain(capture: Capture, config: RunConfig, context: StageContext) -> list[str]:
    if config.initializers != "auto":
        chain = list(config.initializers)
    else:
        chain = context.plugins.suggest_initializers(capture)
    if not chain:
        known = ", ".join(r.component.name for r in context.plugins.components("initializer")) or "none"
        raise CaptureError(
            f"{capture.path}: no plugin suggests how to start from it; name a chain, such as "
            f"--set 'initializers=[\"visual_hull\"]' (there are: {known})"
        )
    return chain


def _apply_masks(
    capture: Capture, scene: Scene | None, config: RunConfig, context: StageContext, with_cameras: bool
) -> Capture:
    """Asks the mask sources in their order for the masks that views still lack."""
    needed = [i for i, view in enumerate(capture.views) if view.pixels().mask is None]
    names = _mask_sources(config, context.plugins)
    if config.masks != "auto":
        needed = list(range(len(capture.views))) if names else []
    for name in names:
        needs_cameras = "needs_cameras" in context.plugins.find("mask_source", name).component.traits
        if not needed or needs_cameras is not with_cameras:
            continue
        source: MaskSource = context.plugins.create("mask_source", name, config.mask_source.get(name))
        with passed_on(context):
            masks = source.masks(capture, scene)
        views = list(capture.views)
        for i in needed:
            if masks[i] is not None:
                views[i] = replace(views[i], mask=masks[i])
        needed = [i for i in needed if masks[i] is None]
        capture = replace(capture, views=tuple(views))
    return capture


def _registered_only(capture: Capture, context: StageContext) -> Capture:
    """Without the views that an initializer for cameras could not place, once it placed any."""
    placed = tuple(view for view in capture.views if view.camera is not None)
    if placed and len(placed) < len(capture.views):
        lost = [view.name for view in capture.views if view.camera is None]
        context.warn(f"{len(lost)} of {len(capture.views)} photographs have no camera and are left out: {lost[0]}, …")
        return replace(capture, views=placed)
    return capture
