"""Initializer: given cameras that are a little wrong are refined where masks and cameras disagree."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import final

import numpy as np

from hir_core.capture import Array, Camera, Capture
from hir_core.errors import CaptureError
from hir_core.plugins.interfaces import Initializer
from hir_core.run.determinism import threads
from hir_core.scene import Scene
from hir_plugins.initializers.options import CameraRefinementOptions
from hir_plugins.initializers.refinement.adjusted_cameras import adjusted_bundle
from hir_plugins.initializers.refinement.camera_alignment import aligned_cameras, camera_motion
from hir_plugins.initializers.refinement.held_out_silhouettes import HeldOutAgreement, held_out_agreement
from hir_plugins.initializers.refinement.silhouette_agreement import SilhouetteAgreement, silhouette_agreement
from hir_plugins.initializers.refinement.silhouette_poses import refine_poses
from hir_plugins.initializers.surface.silhouette_fields import (
    MIN_MASK_SHARE,
    SilhouetteField,
    focus_and_radius,
    silhouette_fields,
)

MIN_VIEWS = 12
"""Photographs with a mask below which cameras are kept: three of them would be held out, and hulls are coarse."""
MASK_SIDE = 256
"""Masks are reduced by the largest whole factor that leaves this many pixels on the longer side."""
_MAX_REMAINING_GAP = 0.5
"""Share of the gap between masks and hulls that refined cameras may leave: where more is left, masks are wrong."""
_SETTING = "initializer.camera_refinement"


@dataclass(frozen=True)
class _MaskedViews:
    """The views that take part: their indices in the capture, and their masks as fields."""

    indices: tuple[int, ...]
    fields: tuple[SilhouetteField, ...]

    def with_cameras(self, cameras: Sequence[Camera]) -> list[SilhouetteField]:
        """The fields with cameras of the photographs."""
        return [
            replace(field, camera=_reduced(cameras[i], field.camera))
            for i, field in zip(self.indices, self.fields, strict=True)
        ]


@final
class CameraRefinement(Initializer):
    """Compares each mask with the visual hull of the others, and refines all cameras where they disagree.

    Two ways: outlines of the masks, and bundle adjustment of matched features. Both start at the given cameras. The
    result is moved back to the given world. It replaces the given cameras where held-out views agree better.
    """

    def __init__(self, config: CameraRefinementOptions) -> None:
        self._config = replace(config, threads=threads(config.threads))
        self._report: dict[str, object] = {}

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The same capture where masks and cameras agree, or with refined cameras; a warning says what was done."""
        if self._config.when == "never":
            self._report = {"cameras": "kept: when is never"}
            return capture, scene
        masked = _masked_views(capture)
        if len(masked.indices) < MIN_VIEWS:
            self._report = {"cameras": f"kept: {len(masked.indices)} photographs with a mask are too few to tell"}
            if self._config.when == "always":
                warnings.warn(
                    f"cameras are not refined: that needs masks of {MIN_VIEWS} photographs, and there are "
                    f"{len(masked.indices)}",
                    stacklevel=2,
                )
            return capture, scene
        try:
            before = silhouette_agreement(masked.fields)
        except CaptureError as error:
            # an empty hull: cameras and masks are not "a little wrong"; the next initializer says so
            self._report = {"cameras": f"kept: {error}"}
            return capture, scene
        self._report = {"cameras": "kept: masks and cameras agree", "agreement": _scores(before)}
        if self._config.when == "auto" and float(np.median(before.gap)) <= self._config.max_gap:
            return capture, scene
        return self._refined(capture, masked, before, workspace), scene

    def report(self) -> Mapping[str, object]:
        """Whether cameras were refined, how far they moved, and the agreement before and after."""
        return self._report

    def _refined(self, capture: Capture, masked: _MaskedViews, before: SilhouetteAgreement, workspace: Path) -> Capture:
        given, focus = capture.cameras, focus_and_radius(masked.fields)[0]
        start, candidates = given, []
        if self._config.method != "bundle_adjustment":
            poses = self._poses_of_outlines(masked)
            if poses is not None:
                start = aligned_cameras(masked_poses(given, masked.indices, poses), given, focus)
                candidates.append(("outlines", start))
        if self._config.method != "silhouettes":
            bundle = adjusted_bundle(capture, start, focus, workspace, self._config)
            self._report["bundle_adjustment"] = "too few matched features" if bundle is None else bundle.document()
            if bundle is not None and bundle.better:
                candidates.append(("bundle adjustment", list(bundle.cameras)))
        # features that fit better than with the cameras of the outlines are the more accurate measurement
        for how, cameras in reversed(candidates):
            after = _agreement_of_candidate(masked.with_cameras(cameras))
            if after is not None and self._explains(before, after):
                self._describe(capture, cameras, how, focus, before, after)
                views = [replace(view, camera=camera) for view, camera in zip(capture.views, cameras, strict=True)]
                return replace(capture, views=tuple(views))
        self._report["cameras"] = "kept: refined ones are not better"
        warnings.warn(
            f"masks and cameras disagree: {_spoken(before)}; refined cameras were not better on held-out views, so "
            "the given ones are kept; check the masks (hir check shows the worst), or estimate new cameras with: "
            '--set \'initializers=["colmap", "visual_hull", "hollows", "stereo"]\' '
            "--set initializer.colmap.known_cameras=solve",
            stacklevel=3,
        )
        return capture

    def _poses_of_outlines(self, masked: _MaskedViews) -> list[SilhouetteField] | None:
        """The views with poses from their outlines; None where held-out views do not agree better, or a hull on the
        way is empty."""
        try:
            held_out = held_out_agreement(masked.fields, self._config.rounds)
            self._report["held_out_views"] = _held_out_scores(held_out)
            return refine_poses(masked.fields, self._config.rounds) if held_out.better else None
        except CaptureError as error:
            self._report["outlines"] = f"not used: {error}"
            return None

    def _explains(self, before: SilhouetteAgreement, after: SilhouetteAgreement) -> bool:
        """Whether the masks agree better, and most of their disagreement is gone: else it is not the cameras'."""
        gap_before, gap_after = float(np.median(before.gap)), float(np.median(after.gap))
        allowed = max(self._config.max_gap, _MAX_REMAINING_GAP * gap_before)
        return float(after.iou.mean()) > float(before.iou.mean()) and gap_after <= allowed

    def _describe(
        self,
        capture: Capture,
        cameras: Sequence[Camera],
        how: str,
        focus: Array,
        before: SilhouetteAgreement,
        after: SilhouetteAgreement,
    ) -> None:
        """Writes the report, and says to the user, how far cameras moved."""
        motion = camera_motion(cameras, capture.cameras, focus)
        worst = int(np.argmax(motion.degrees))
        self._report["cameras"] = f"refined by {how}"
        self._report["agreement_refined"] = _scores(after)
        self._report["turned_degrees"] = _sizes(motion.degrees)
        self._report["moved_percent"] = _sizes(motion.percent)
        warnings.warn(
            f"the given cameras were a little wrong and are refined by {how}: {_spoken(after)}, before "
            f"{_spoken(before, short=True)}; they turned by {np.median(motion.degrees):.2f}° and moved by "
            f"{np.median(motion.percent):.2f} % of their distance (median), {capture.views[worst].name} most, by "
            f"{motion.degrees[worst]:.2f}° and {motion.percent[worst]:.2f} %; --set {_SETTING}.when=never keeps the "
            "given ones",
            stacklevel=4,
        )


def masked_poses(cameras: Sequence[Camera], indices: Sequence[int], fields: Sequence[SilhouetteField]) -> list[Camera]:
    """The cameras of all views with the poses of some."""
    result = list(cameras)
    for index, field in zip(indices, fields, strict=True):
        result[index] = replace(result[index], world_to_camera=field.camera.world_to_camera)
    return result


def _masked_views(capture: Capture) -> _MaskedViews:
    indices, fields = [], []
    for index, view in enumerate(capture.views):
        if view.camera is None:
            continue
        factor = max(1, max(view.camera.width, view.camera.height) // MASK_SIDE)
        mask = view.pixels(factor).mask
        if mask is None or not MIN_MASK_SHARE < mask.mean() < 1 - MIN_MASK_SHARE:
            continue
        indices.append(index)
        fields += silhouette_fields([view], factor)
    return _MaskedViews(tuple(indices), tuple(fields))


def _reduced(camera: Camera, like: Camera) -> Camera:
    """A photograph's camera at the resolution of `like`."""
    return camera.downsampled(max(1, max(camera.width, camera.height) // max(like.width, like.height)))


def _agreement_of_candidate(fields: Sequence[SilhouetteField]) -> SilhouetteAgreement | None:
    """The agreement with refined cameras; None where no point is in all masks any more."""
    try:
        return silhouette_agreement(fields)
    except CaptureError:
        return None


def _scores(agreement: SilhouetteAgreement) -> dict[str, float]:
    return {
        "median": round(float(np.median(agreement.iou)), 4),
        "worst": round(float(agreement.iou.min()), 4),
        "gap_pixels": round(float(np.median(agreement.gap)), 3),
    }


def _sizes(values: Array) -> dict[str, float]:
    return {"median": round(float(np.median(values)), 4), "largest": round(float(values.max()), 4)}


def _held_out_scores(agreement: HeldOutAgreement) -> dict[str, float | int]:
    return {
        "views": len(agreement.before),
        "before": round(float(agreement.before.mean()), 4),
        "after": round(float(agreement.after.mean()), 4),
    }


def _spoken(agreement: SilhouetteAgreement, short: bool = False) -> str:
    scores = f"{np.median(agreement.iou):.3f} (worst {agreement.iou.min():.2f})"
    return scores if short else f"each mask agrees with the hull of the others to {scores}"
