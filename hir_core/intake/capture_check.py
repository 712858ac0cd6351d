"""Checks a capture before a fit: sharpness, exposure, duplicates, coverage, agreement of masks and cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hir_core.capture import Array, Camera, Capture, Pixels, View
from hir_core.capture.exif import camera_record
from hir_core.intake.capture_advice import advice_for
from hir_core.intake.check_result import GAP_SIDE_PIXELS, CaptureCheck, TakeCheck, ViewCheck
from hir_core.intake.light_motion import headlight_score
from hir_core.intake.mask_agreement import mask_agreement
from hir_core.intake.picture_statistics import find_duplicates, sharpness
from hir_core.intake.reduced_pictures import reduce_to_side
from hir_core.intake.view_directions import directions_covered

_SIDE_PIXELS = 160
"""Longer side at which photographs are compared."""
_SHARPNESS_SIDE_PIXELS = 640
"""Longer side at which blur is measured: blur below this resolution does not matter."""


def check_capture(capture: Capture, surface: tuple[Array, Array] | None = None) -> CaptureCheck:
    """The check of a capture; each photograph is read once and reduced.

    `surface` are points and outward normals (N, 3) of the object, to detect a light that moves with the camera.
    """
    read = [_read(view) for view in capture.views]
    small = [(pixels, camera) for pixels, camera, *_ in read]
    sharpness_values = np.array([sharp for *_, sharp, _ in read])
    middle = float(np.median(sharpness_values)) if len(sharpness_values) else 0.0
    agreement = mask_agreement([c for _, c in small], [p.mask for p, _ in small])
    views = tuple(
        _view_check(view, pixels, size, clipped, sharp / middle if middle > 0 else 1.0, agreed)
        for view, (pixels, _, size, sharp, clipped), agreed in zip(capture.views, read, agreement.iou, strict=True)
    )
    cameras = [camera for _, camera in small if camera is not None]
    headlight = None
    if surface is not None and len(cameras) == len(small) and len(cameras) >= 3:
        # the light of each take is another; the take of most photographs stands for all
        take = Counter(capture.take_numbers).most_common(1)[0][0]
        chosen = [i for i, number in enumerate(capture.take_numbers) if number == take]
        headlight = headlight_score([small[i][0] for i in chosen], [cameras[i] for i in chosen], *surface)
    check = CaptureCheck(
        views=views,
        duplicates=tuple(
            (capture.views[i].name, capture.views[j].name) for i, j in find_duplicates([p for p, _ in small])
        ),
        with_camera=len(cameras),
        directions_covered=directions_covered(cameras),
        flashes=sum(camera_record(view.path).flash is True for view in capture.views if view.path is not None),
        headlight=headlight,
        takes=_takes(capture),
        points=0 if capture.points is None else len(capture.points.positions),
        mask_gap=None if agreement.gap is None else agreement.gap * _gap_scale([(size, p) for p, _, size, *_ in read]),
    )
    return replace(check, advice=tuple(advice_for(check)))


def _takes(capture: Capture) -> tuple[TakeCheck, ...]:
    counts = Counter(view.take for view in capture.views)
    return tuple(TakeCheck(name, counts[name]) for name in capture.takes if capture.takes != ("",))


def _gap_scale(sizes: Sequence[tuple[tuple[int, int], Pixels]]) -> float:
    """Pixels of masks reduced to `GAP_SIDE_PIXELS` for one of the reduced pixels, the median of all views."""
    scales = []
    for size, small in sizes:
        side = max(size)
        scales.append(side / max(1, side // GAP_SIDE_PIXELS) / max(small.color_linear.shape[:2]))
    return float(np.median(scales))


def _read(view: View) -> tuple[Pixels, Camera | None, tuple[int, int], float, float]:
    """Reduced pixels and camera; width and height, sharpness and clipped share at full resolution."""
    pixels = view.pixels()
    height, width = pixels.color_linear.shape[:2]
    weight = np.ones(pixels.saturated.shape, np.float32) if pixels.mask is None else pixels.mask
    clipped = float((pixels.saturated * weight).sum() / max(float(weight.sum()), 1e-9))
    small, camera = reduce_to_side(view, pixels, _SIDE_PIXELS)
    return small, camera, (width, height), sharpness(reduce_to_side(view, pixels, _SHARPNESS_SIDE_PIXELS)[0]), clipped


def _view_check(
    view: View,
    pixels: Pixels,
    size: tuple[int, int],
    clipped: float,
    relative_sharpness: float,
    agreement: float | None,
) -> ViewCheck:
    weight = np.ones(pixels.saturated.shape) if pixels.mask is None else pixels.mask
    total = max(float(weight.sum()), 1e-9)
    border = False
    if pixels.mask is not None:
        solid = pixels.mask > 0.5
        border = bool(solid[0].any() or solid[-1].any() or solid[:, 0].any() or solid[:, -1].any())
    return ViewCheck(
        name=view.name,
        width=size[0],
        height=size[1],
        saturated=clipped,
        brightness=float((pixels.color_linear.mean(axis=2) * weight).sum() / total),
        sharpness=float(relative_sharpness),
        mask_share=None if pixels.mask is None else float(pixels.mask.mean()),
        touches_border=border,
        agreement=agreement,
        take=view.take,
    )
