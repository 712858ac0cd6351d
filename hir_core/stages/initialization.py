"""Stage: from photographs to cameras, masks and a first mesh, in the working frame."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from hir_core.capture import Capture, CoordinateFrames, Pixels
from hir_core.config import RunConfig
from hir_core.errors import CaptureError, StageError
from hir_core.files.file_checksums import file_hash
from hir_core.intake.depth_scale import DepthScale, with_depth_scale
from hir_core.intake.mask_sources import (
    Known,
    apply_mask_sources,
    mask_source_names,
    needed_by,
    without_unmasked_views,
)
from hir_core.plugins.interfaces import Initializer, MaskSource
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.progress import Progress
from hir_core.run.stage_context import StageContext, forward_warnings
from hir_core.scene import Mesh, Scene
from hir_core.scene.frames import move_scene, unit_similarity
from hir_core.scene.scan import Scan
from hir_core.stages.held_out_views import MIN_VIEWS, model_selection_folds
from hir_core.stages.initializer_result import checked_report, checked_result, checked_scan

MAX_DISTANCE_FROM_ORIGIN = 1e4
"""Largest distance of the cameras from the origin, in their own extent: float32 is then exact to 6e-4 of the extent."""


@dataclass(frozen=True)
class InitializationReport:
    """Result of the chain of initializers, for run.json."""

    initializers: tuple[str, ...]
    frames: CoordinateFrames
    views: int
    masked_views: int
    vertices: int
    triangles: int
    details: Mapping[str, Mapping[str, Any]]
    """What each initializer says about its own result."""
    scale_from: str = ""
    """What gave the length of the world's unit, and its spread; empty where nothing is known of it."""
    depth_scale: DepthScale | None = None
    """The correction of measured depths; None without them, and where the settings leave it out."""

    def as_document(self) -> dict[str, Any]:
        """For run.json."""
        names = ("views", "masked_views", "vertices", "triangles", "scale_from", "details")
        fields = {name: getattr(self, name) for name in names}
        scale = None if self.depth_scale is None else asdict(self.depth_scale)
        frames = self.frames.as_document()
        return {"initializers": list(self.initializers), "frames": frames, "depth_scale": scale} | fields


@dataclass(frozen=True)
class InitializedCapture:
    """Value of the initializer stage: capture and mesh in the working frame."""

    capture: Capture
    scene: Scene
    frames: CoordinateFrames
    """The asset's frame is the one that the initializers ended in."""
    scan: Scan | None = None
    """The file of the scene's mesh, where one was read. For the report and for `hir evaluate`; no later stage receives
    its texture."""
    unchanged_scene: Scene | None = None
    """Before the first initializer with the trait `revises_mesh`; None where none of them changed the mesh."""


def initialize(
    capture: Capture, config: RunConfig, context: StageContext
) -> tuple[InitializedCapture, InitializationReport]:
    """Runs the resolved chain of initializers with mask sources between them."""
    assert config.initializers != "auto", "`resolve_initializers` comes first"
    scene: Scene | None = None
    unchanged: tuple[Scene, Capture] | None = None
    mesh_changed = False
    scan: Scan | None = None
    scanned: Mesh | None = None
    _check_distance_from_origin(capture)
    capture = _with_min_confidence(capture, config.depth_maps.min_confidence)
    capture = apply_masks(capture, scene, config, context, "photographs")
    chain = config.initializers
    details: dict[str, Mapping[str, Any]] = {}
    masked = False
    # sources of masks that need cameras may need points too, which the same initializers find
    finders = [i for i, name in enumerate(chain) if _has_trait(name, "finds_cameras", context.plugins)]
    depth_scale: DepthScale | None = None
    scaled = config.depth_maps.scale == "as_measured"
    for i, name in enumerate(chain):
        posed = bool(capture.views) and all(view.camera is not None for view in capture.views)
        if not masked and posed and i > max(finders, default=-1):
            capture = apply_masks(capture, scene, config, context, "cameras")
            if not _mesh_gives_masks(config, context.plugins):
                capture = _masked_only(capture, context)
            masked = True
        if not scaled and _has_trait(name, "makes_surface", context.plugins):
            # cameras are final where a surface is made from them
            capture, depth_scale = with_depth_scale(capture, context.seed)
            scaled = True
        context.report(Progress("initializer", i, len(chain), 0.0, message=name))
        initializer: Initializer = context.plugins.create(
            "initializer", name, config.initializer.get(name), context.seed, context.device
        )
        owner = context.plugins.find("initializer", name).label
        workspace = context.workspace / f"{i + 1}-{name}"
        workspace.mkdir(parents=True, exist_ok=True)
        before, revises = scene, _has_trait(name, "revises_mesh", context.plugins)
        if revises and unchanged is None and before is not None:
            unchanged = before, capture
        with forward_warnings(context):
            capture, scene = checked_result(initializer.initialize(capture, scene, workspace), owner)
        if revises and before is not None and scene is not None:
            mesh_changed |= scene.mesh is not before.mesh
        if own_report := checked_report(initializer, owner):
            details[name] = own_report
        if own_scan := checked_scan(initializer, owner):
            scan, scanned = own_scan, None if scene is None else scene.mesh
        capture = _registered_only(capture, context)
        _check_distance_from_origin(capture)
    if scene is None:
        raise StageError(
            f"the initializers {', '.join(chain)} made no surface; end the chain with one that makes a surface"
        )
    if unchanged is not None and not (mesh_changed and _same_cameras(unchanged[1], capture)):
        unchanged = None  # the same mesh, or a later initializer moved the world
    capture = _masked_only(apply_masks(capture, scene, config, context, "mesh"), context)
    if len(capture.views) < MIN_VIEWS:
        context.warn(
            f"there are only {len(capture.views)} photographs: the shape is a guess where they do not look, and with "
            f"fewer than {MIN_VIEWS} no view is held out, so no models are compared; take 20 or more around the object"
        )
    elif not model_selection_folds(len(capture.views), capture.take_numbers):
        context.warn(
            f"the {len(capture.takes)} takes have too few photographs each to hold some out, so no models are "
            "compared; take 20 or more of one take around the object"
        )
    if scanned is not None and not _has_surface_of(scene.mesh, scanned):
        scan = None  # an initializer made another surface, to which the texture does not belong
    working_from_asset = unit_similarity(scene.mesh)
    moved_capture = capture.transformed(working_from_asset)
    asset_from_working = np.linalg.inv(working_from_asset)
    frames = CoordinateFrames(asset_from_working, asset_from_working @ moved_capture.world_from_source)
    report = InitializationReport(
        initializers=chain,
        frames=frames,
        views=len(capture.views),
        masked_views=sum(view.pixels().mask is not None for view in capture.views),
        vertices=len(scene.mesh.positions),
        triangles=len(scene.mesh.faces),
        details=details,
        scale_from=scale_source(capture, details),
        depth_scale=depth_scale,
    )

    def moved(found: Scene) -> Scene:
        return move_scene(found, working_from_asset).to(context.device)

    return InitializedCapture(
        moved_capture, moved(scene), frames, scan, None if unchanged is None else moved(unchanged[0])
    ), report


def _same_cameras(first: Capture, second: Capture) -> bool:
    if [view.name for view in first.views] != [view.name for view in second.views]:
        return False
    pairs = zip(first.cameras, second.cameras, strict=True)
    return all(np.array_equal(a.world_to_camera, b.world_to_camera) for a, b in pairs)


def _has_surface_of(mesh: Mesh, scanned: Mesh) -> bool:
    """Whether a mesh has the triangles and texture coordinates of another; its vertices may have moved."""
    return mesh.topology is scanned.topology and mesh.uvs is scanned.uvs


def scale_source(capture: Capture, details: Mapping[str, Mapping[str, Any]]) -> str:
    """The last initializer that says what gave the scale, or else what measured the world of the cameras' files."""
    stated = [str(report["scale_from"]) for report in details.values() if report.get("scale_from")]
    return stated[-1] if stated else capture.metres_from


def _with_min_confidence(capture: Capture, least: float) -> Capture:
    views = (
        view if view.depth is None else replace(view, depth=replace(view.depth, min_confidence=least))
        for view in capture.views
    )
    return replace(capture, views=tuple(views))


def _check_distance_from_origin(capture: Capture) -> None:
    """Raises `CaptureError` where float32 positions are too coarse for the object, because the origin is far away."""
    centers = np.array([view.camera.center for view in capture.views if view.camera is not None])
    if len(centers) < 2:
        return
    middle = centers.mean(axis=0)
    distance, extent = float(np.linalg.norm(middle)), float(np.linalg.norm(centers - middle, axis=1).max())
    if distance > MAX_DISTANCE_FROM_ORIGIN * extent > 0:
        raise CaptureError(
            f"{capture.path}: the cameras are {distance:.3g} from the origin of their coordinates and only "
            f"{extent:.3g} from their centre, too far for float32; subtract "
            f"({', '.join(f'{c:.6g}' for c in middle)}) from every camera position"
        )


def resolve_initializers(capture: Capture, config: RunConfig, plugins: PluginManager) -> tuple[str, ...]:
    """The chain of initializers: the one in the settings, else what a plugin suggests for the capture with its masks.

    Mask sources that the settings name are assumed to find masks: they may take minutes, and run in the stage.
    """
    if config.initializers != "auto":
        chain = tuple(config.initializers)
    else:
        chain = tuple(plugins.suggest_initializers(_with_expected_masks(capture, config, plugins)))
        chain = _with_scale(chain, config, plugins)
    if not chain:
        known = ", ".join(r.component.name for r in plugins.components("initializer")) or "none"
        raise CaptureError(
            f"{capture.path}: no plugin suggests initializers for it; name them with --set 'initializers=[…]' "
            f"(installed: {known})"
        )
    for name in chain:
        plugins.find("initializer", name)
    return chain


def _with_scale(chain: tuple[str, ...], config: RunConfig, plugins: PluginManager) -> tuple[str, ...]:
    """The chain with those that set the scale and whose options the settings give, before what makes the surface."""
    if not chain:
        return chain
    makers = (i for i, name in enumerate(chain) if _has_trait(name, "makes_surface", plugins))
    first = next(makers, len(chain))
    return (*chain[:first], *_scale_setters(chain, config, plugins), *chain[first:])


def _scale_setters(chain: tuple[str, ...], config: RunConfig, plugins: PluginManager) -> list[str]:
    """Initializers outside the chain that set the scale and whose options the settings give."""
    return [name for name in config.initializer if name not in chain and _has_trait(name, "sets_scale", plugins)]


def _has_trait(name: str, trait: str, plugins: PluginManager) -> bool:
    return trait in plugins.find("initializer", name).component.traits


def _with_expected_masks(capture: Capture, config: RunConfig, plugins: PluginManager) -> Capture:
    """The capture with the masks that the stage will give it, as far as a suggestion depends on them."""
    if config.masks == "auto":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # the stage repeats them, for the user and run.json
            return apply_mask_sources(
                capture, None, "auto", config.mask_source, plugins, known="photographs", seed=config.seed
            )
    if not config.masks or not capture.views:
        return capture
    height, width = capture.views[0].pixels().color_linear.shape[:2]
    expected = np.ones((height, width), np.float32)
    others = (replace(view, read=_WithFullMask(view.read)) for view in capture.views[1:])  # sizes may differ
    return replace(capture, views=(replace(capture.views[0], mask=expected), *others))


@dataclass(frozen=True)
class _WithFullMask:
    """Reads a photograph with a mask that is object everywhere."""

    read: Callable[[], Pixels]

    def __call__(self) -> Pixels:
        pixels = self.read()
        return replace(pixels, mask=np.ones(pixels.color_linear.shape[:2], np.float32))


def hashes_of_files_read(capture: Capture, config: RunConfig, plugins: PluginManager) -> list[str]:
    """Hashes of the files, besides the photographs, that the stage's components read; part of the stage's cache key."""
    components = [("mask_source", name, config.mask_source) for name in mask_source_names(config.masks, plugins)]
    components += [("initializer", name, config.initializer) for name in config.initializers]
    hashes: list[str] = []
    for kind, name, options in components:
        if "reads_files" in plugins.find(kind, name).component.traits:
            component: MaskSource | Initializer = plugins.create(kind, name, options.get(name))
            hashes += [file_hash(path) for path in component.files(capture)]
    return hashes


def apply_masks(
    capture: Capture, scene: Scene | None, config: RunConfig, context: StageContext, known: Known
) -> Capture:
    """The capture with masks of the configured sources; their warnings go to the user and to run.json."""
    with forward_warnings(context):
        return apply_mask_sources(
            capture,
            scene,
            config.masks,
            config.mask_source,
            context.plugins,
            known=known,
            seed=context.seed,
        )


def _mesh_gives_masks(config: RunConfig, plugins: PluginManager) -> bool:
    """Whether a source of masks waits for the initializers' mesh."""
    found = (plugins.find("mask_source", name) for name in mask_source_names(config.masks, plugins))
    return any(needed_by(registered.component.traits) == "mesh" for registered in found)


def _masked_only(capture: Capture, context: StageContext) -> Capture:
    """As `without_unmasked_views`; the warning goes to the user and to run.json."""
    with forward_warnings(context):
        return without_unmasked_views(capture)


def _registered_only(capture: Capture, context: StageContext) -> Capture:
    """The capture without unregistered views, if any view has a camera; a warning reports their number."""
    registered = tuple(view for view in capture.views if view.camera is not None)
    if registered and len(registered) < len(capture.views):
        unregistered = [view.name for view in capture.views if view.camera is None]
        context.warn(
            f"{len(unregistered)} of {len(capture.views)} photographs have no camera and are left out: "
            f"{', '.join(unregistered[:8])}{', …' if len(unregistered) > 8 else ''}"
        )
        return replace(capture, views=registered)
    return capture
