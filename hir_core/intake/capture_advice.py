"""Advice of `hir check`: one sentence for each problem of a capture."""

from __future__ import annotations

import json
from collections.abc import Collection, Sequence

import numpy as np

from hir_core.intake.check_result import GAP_SIDE_PIXELS, CaptureCheck, ViewCheck
from hir_core.intake.mask_agreement import MAX_BELOW_MEDIAN, MIN_AGREEMENT

_MIN_HEADLIGHT_SCORE = 0.5

MIN_PHOTOGRAPHS_OF_TAKE = 6
"""Below it a take is said to be under-observed: its light has as many parameters as that of a whole capture. A choice
that was not measured."""

MAX_MASK_GAP = 0.5
"""Above it the given cameras are a little wrong; in the unit of `CaptureCheck.mask_gap`."""


def cameras_are_inexact(check: CaptureCheck) -> bool:
    """Whether masks lie beside the hull of other masks, though they agree roughly."""
    return check.mask_gap is not None and check.mask_gap > MAX_MASK_GAP


def advice_on_cameras(check: CaptureCheck, chain: Sequence[str], refining: Collection[str]) -> str:
    """The sentence on cameras that are a little wrong; `refining` are those of a run's initializers that mend them."""
    assert check.mask_gap is not None
    fact = (
        f"the given cameras seem a little wrong: masks lie {check.mask_gap:.1f} pixels (of {GAP_SIDE_PIXELS}) beside "
        "the hull of the others (median)"
    )
    used = [name for name in chain if name in refining]
    if not used:
        return f"{fact}; export them again, or have them estimated again"
    rest = json.dumps([name for name in chain if name not in refining])
    return (
        f"{fact}; hir reconstruct refines them ({', '.join(used)}) where held-out views then agree better, and "
        f"--set 'initializers={rest}' keeps them"
    )


def advice_for(check: CaptureCheck) -> list[str]:
    """One sentence for each problem, the most severe first."""
    views, advice = check.views, []
    if len(views) < 20:
        advice.append(f"{len(views)} photographs are few: take 30 to 80 from all sides for an accurate shape")
    if 0 < check.with_camera < len(views):
        advice.append(f"{len(views) - check.with_camera} of {len(views)} photographs have no camera: they are left out")
    few = [take for take in check.takes if take.photographs < MIN_PHOTOGRAPHS_OF_TAKE]
    if few and len(check.takes) > 1:
        advice.append(
            f"the take {few[0].name} has {few[0].photographs} photographs, so its light is under-observed: take "
            f"{MIN_PHOTOGRAPHS_OF_TAKE} or more, better 30, or leave the take out"
        )
    if unmasked := [v.name for v in views if v.mask_share is None]:
        advice.append(_advice_on_masks(check, unmasked))
    scores = [v.agreement for v in views if v.agreement is not None]
    if scores:
        middle = float(np.median(scores))
        if middle < MIN_AGREEMENT:
            advice.append(f"masks and cameras do not agree (IoU {middle:.2f}): check the cameras' axes and the masks")
        bad = [v.name for v in views if v.agreement is not None and v.agreement < middle - MAX_BELOW_MEDIAN]
        if bad and middle >= MIN_AGREEMENT:
            advice.append(
                f"the masks of {', '.join(bad[:5])} disagree with the others: correct them, or remove these photographs"
            )
    empty = [v.name for v in views if v.mask_share == 0]
    if empty:
        advice.append(
            f"the masks of {len(empty)} photographs are empty, such as {empty[0]}: correct them, or remove these "
            "photographs"
        )
    full = [v.name for v in views if v.mask_share == 1]
    if full:
        advice.append(
            f"the masks of {len(full)} photographs show only object, such as {full[0]}: check the alpha channel or the "
            "masks"
        )
    sizes = {(v.width, v.height) for v in views}
    if len(sizes) > 1:
        advice.append(f"the photographs have {len(sizes)} sizes")
    blurred = [v.name for v in views if v.sharpness < 0.5]
    if blurred:
        advice.append(f"{len(blurred)} photographs are blurred compared with the others: {', '.join(blurred[:5])}")
    flat = [v.name for v in views if v.sharpness == 0 and v.saturated == 0 and v.brightness == 0]
    if flat:
        advice.append(f"{len(flat)} photographs are black, such as {flat[0]}: remove them")
    if check.duplicates:
        advice.append(
            f"photographs that repeat another one: {len(check.duplicates)}, such as {' and '.join(check.duplicates[0])}"
        )
    clipped = [v.name for v in views if v.saturated > 0.05]
    if clipped:
        advice.append(
            f"{len(clipped)} photographs have more than 5 % clipped pixels, such as {clipped[0]}: reduce the exposure"
        )
    if any(_brightness_range(views, take) > 4 for take in {v.take for v in views}):
        advice.append(
            "the photographs' brightness differs by more than a factor of 4: hir reconstruct fits their exposures, "
            "and one fixed exposure would be more accurate"
        )
    cut = [v.name for v in views if v.touches_border and v.mask_share != 1]
    if cut:
        advice.append(
            f"the object reaches the border of {len(cut)} photographs, such as {cut[0]}: keep it inside the frame"
        )
    if check.directions_covered is not None and check.directions_covered < 0.25:
        advice.append("the photographs cover few directions: parts that are in no photograph will be inpainted")
    if check.flashes > len(views) / 2:
        advice.append(
            f"the flash fired in {check.flashes} photographs, so a lamp near the camera lit the object: "
            "hir reconstruct compares that with other lights, and light_frame = lamp forces it"
        )
    if check.headlight is not None and check.headlight > _MIN_HEADLIGHT_SCORE:
        advice.append(
            "the light moves with the camera (a flash, or a turntable): set light_frame = camera, or lamp for a flash"
        )
    return advice


def _advice_on_masks(check: CaptureCheck, unmasked: Sequence[str]) -> str:
    """The sentence on photographs without a mask, of which there is at least one."""
    count = len(check.views)
    fact = f"{len(unmasked)} of {count} photographs have no mask, such as {unmasked[0]}"
    if len(check.takes) > 1 and check.with_camera < count:
        return (
            f"{fact}: to estimate cameras of several takes, all need one, because takes are joined by features of the "
            "object alone"
        )
    if check.with_camera == count and 2 * len(unmasked) <= count and not check.points:
        return (
            f"{fact}, and the capture has no points to make one from: hir reconstruct leaves these photographs out; "
            "add their masks to use them"
        )
    return (
        f"{fact}: hir reconstruct makes them from colours and reconstructed points; where these are wrong, put masks "
        "into a folder 'masks'"
    )


def _brightness_range(views: Sequence[ViewCheck], take: str) -> float:
    """Brightest photograph of a take over its median: the light of another take may be another."""
    brightness = np.array([v.brightness for v in views if v.brightness > 0 and v.take == take])
    return float(brightness.max() / np.median(brightness)) if len(brightness) else 0.0
