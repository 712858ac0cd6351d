"""Descriptors of the built-in initializers, and the chain suggested for a capture."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hir_core.plugins import Component, hookimpl
from hir_plugins.initializers.options import (
    CameraRefinementOptions,
    ColmapOptions,
    ColorCheckerOptions,
    FiducialMarkersOptions,
    HollowsOptions,
    MeshFileOptions,
    PoissonOptions,
    SensorDepthOptions,
    StereoOptions,
    VisualHullOptions,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from hir_core.capture import Capture, View

MIN_MATCHED_VIEWS = 16
"""Photographs of one take from which hollows and stereo are suggested: on the upper hemisphere they are then about 35
degrees apart. A choice that was not measured (docs/studies/default_values.md)."""

MIN_MATCHED_SIDE = 128
"""Shorter side of a photograph, in pixels, from which hollows and stereo are suggested: the first level has half of
them, and its windows are 7 pixels wide."""

SEARCHED_PHOTOGRAPHS = 6
"""In which a ColorChecker is looked for: 0.6 processor seconds for a photograph of 1,600 pixels."""

VISUAL_HULL = Component(
    name="visual_hull",
    target="hir_plugins.initializers.hull.visual_hull:VisualHull",
    config=VisualHullOptions,
    summary="The visual hull, the largest object that fits all masks; needs cameras and masks.",
    requires=("torch", "jaxtyping", "open3d", "cv2", "skimage"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras", "needs_masks", "makes_surface"}),
)

SENSOR_DEPTH = Component(
    name="sensor_depth",
    target="hir_plugins.initializers.depth.sensor_depth:SensorDepth",
    config=SensorDepthOptions,
    summary="The visual hull, carved by the depth maps of the capture; needs cameras, masks and depth maps.",
    requires=("torch", "jaxtyping", "open3d", "cv2", "skimage", "scipy"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras", "needs_masks", "makes_surface"}),
    testing="hir_plugins.initializers.contract_inputs:with_depth_maps",
)

MESH_FILE = Component(
    name="mesh_file",
    target="hir_plugins.initializers.existing_mesh.mesh_file:MeshFile",
    config=MeshFileOptions,
    summary="A mesh file that already exists, in any format that trimesh reads.",
    requires=("torch", "jaxtyping", "open3d", "scipy"),
    extra="reconstruct",
    traits=frozenset({"makes_surface", "reads_files"}),
    testing="hir_plugins.initializers.contract_inputs:object_mesh_file",
)

COLMAP = Component(
    name="colmap",
    target="hir_plugins.initializers.sfm.colmap:Colmap",
    config=ColmapOptions,
    summary="Estimates cameras and sparse points from photographs by structure from motion.",
    requires=("torch", "jaxtyping", "pycolmap", "cv2", "scipy"),
    extra="reconstruct",
    traits=frozenset({"finds_cameras", "reads_files"}),
)

FIDUCIAL_MARKERS = Component(
    name="fiducial_markers",
    target="hir_plugins.initializers.markers.fiducial_markers:FiducialMarkers",
    config=FiducialMarkersOptions,
    summary="Metres and the horizontal from printed ArUco or AprilTag markers beside the object.",
    requires=("torch", "jaxtyping", "cv2"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras", "sets_scale"}),
    testing="hir_plugins.initializers.contract_inputs:with_markers",
)

COLOR_CHECKER = Component(
    name="color_checker",
    target="hir_plugins.initializers.color_chart.color_checker:ColorChecker",
    config=ColorCheckerOptions,
    summary="Brightness and white balance from a ColorChecker beside the object.",
    requires=("torch", "jaxtyping", "cv2"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras"}),
    testing="hir_plugins.initializers.contract_inputs:with_color_checker",
)

CAMERA_REFINEMENT = Component(
    name="camera_refinement",
    target="hir_plugins.initializers.refinement.camera_refinement:CameraRefinement",
    config=CameraRefinementOptions,
    summary="Refines given cameras that are a little wrong, where masks and cameras disagree.",
    requires=("torch", "jaxtyping", "pycolmap", "cv2", "skimage", "scipy"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras", "needs_masks", "refines_cameras"}),
)

HOLLOWS = Component(
    name="hollows",
    target="hir_plugins.initializers.hollows.hollows:Hollows",
    config=HollowsOptions,
    summary="Sinks openings of the visual hull, such as a mug's, as deep as explains the photographs best.",
    requires=("torch", "jaxtyping", "open3d", "cv2", "skimage", "scipy", "mitsuba", "drjit"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras", "needs_masks", "needs_surface", "makes_surface", "revises_mesh"}),
)

STEREO = Component(
    name="stereo",
    target="hir_plugins.initializers.stereo.stereo:Stereo",
    config=StereoOptions,
    summary="Multi-view stereo: carves hollows that no silhouette shows into the visual hull.",
    requires=("torch", "jaxtyping", "open3d", "cv2", "skimage", "pycolmap"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras", "makes_surface", "measures_points"}),
)

POISSON = Component(
    name="poisson",
    target="hir_plugins.initializers.poisson.poisson:Poisson",
    config=PoissonOptions,
    summary="A surface through the oriented points of stereo (screened Poisson reconstruction).",
    requires=("torch", "jaxtyping", "open3d", "scipy"),
    extra="reconstruct",
    traits=frozenset({"needs_cameras", "needs_points", "makes_surface"}),
    testing="hir_plugins.initializers.contract_inputs:without_masks",
)


@hookimpl
def hir_register_initializers() -> list[Component]:
    return [
        CAMERA_REFINEMENT,
        VISUAL_HULL,
        SENSOR_DEPTH,
        MESH_FILE,
        COLMAP,
        FIDUCIAL_MARKERS,
        COLOR_CHECKER,
        HOLLOWS,
        STEREO,
        POISSON,
    ]


@hookimpl
def hir_suggest_initializers(capture: Capture) -> list[str] | None:
    """The visual hull, hollows and stereo, which carve it; structure from motion before them if cameras, or both masks
    and points, are missing. A capture with cameras and depth maps gets `sensor_depth` in place of the hull, and no
    `hollows`. Cameras of a capture with masks for at least half of the photographs are checked, and refined where masks
    and cameras disagree.

    Without `hollows` and `stereo` where photographs are too few or too small to be matched. With `color_checker` where
    the photographs show one.
    """
    if not capture.views:
        return None
    posed = all(view.camera is not None for view in capture.views)
    measured = posed and any(view.depth is not None for view in capture.views)
    surface = ["color_checker"] if _shows_color_checker(capture) else []
    surface.append("sensor_depth" if measured else "visual_hull")
    if _can_be_matched(capture):
        surface += ["stereo"] if measured else ["hollows", "stereo"]
    if posed and _most_have_masks(capture.views):
        return ["camera_refinement", *surface]
    return surface if posed and capture.points is not None else ["colmap", *surface]


def _most_have_masks(views: Sequence[View]) -> bool:
    """Whether at least half of the views have a mask; photographs are read until that is known."""
    masked = unmasked = 0
    for view in views:
        if view.mask is not None or view.pixels().mask is not None:
            masked += 1
        else:
            unmasked += 1
        if 2 * masked >= len(views) or 2 * unmasked > len(views):
            break
    return 2 * masked >= len(views)


def _shows_color_checker(capture: Capture) -> bool:
    """Photographs without their background show none, and are not searched."""
    from hir_plugins.initializers.color_chart.chart_detection import (
        can_detect,
        is_cut_out,
        shows_chart,
    )

    first = [view for view in capture.views if view.take == capture.takes[0]]
    return can_detect() and not is_cut_out(first[0].pixels()) and shows_chart(first, SEARCHED_PHOTOGRAPHS)


def _can_be_matched(capture: Capture) -> bool:
    from hir_core.capture.capture_size import size_of

    size, takes = size_of(capture), capture.take_numbers
    matched = max((takes.count(take) for take in set(takes)), default=0)
    return matched >= MIN_MATCHED_VIEWS and min(size.width, size.height) >= MIN_MATCHED_SIDE
