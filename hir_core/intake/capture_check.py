"""What can be said about a capture before anything is fitted: is it sharp and complete, do masks and cameras agree?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, Pixels, View
from hir_core.capture.exif import camera_record

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import MaskSource
    from hir_core.plugins.manager import PluginManager

_SIDE = 160
"""Longer side at which pictures are compared."""
_SHARP_SIDE = 640
"""Longer side at which blur is measured: what is blurred less costs nothing."""
_GRID = 56
_HEADLIGHT_SLOPE = 0.5
_HEADLIGHT_CORRELATION = 0.4


@dataclass(frozen=True)
class ViewCheck:
    """One photograph. Shares are of the object's pixels where there is a mask, else of all."""

    name: str
    width: int
    height: int
    saturated: float
    """Share of clipped pixels."""
    brightness: float
    """Mean linear value."""
    sharpness: float
    """Relative to the capture's median; much below 1 is blurred or out of focus."""
    mask_share: float | None
    """Share of the picture that is object; None without a mask."""
    touches_border: bool = False
    agreement: float | None = None
    """Intersection over union of the mask and of what all masks and cameras together leave there."""


@dataclass(frozen=True)
class CaptureCheck:
    """The findings, and sentences for what should be mended or known."""

    views: tuple[ViewCheck, ...]
    duplicates: tuple[tuple[str, str], ...]
    with_camera: int
    directions_covered: float | None
    """Share of the sphere of directions within 30° of some camera, seen from the object; None without cameras."""
    flashes: int
    """Photographs whose record says that the flash fired."""
    headlight: float | None
    """1 for a light carried by the camera, 0 for one that stands in the world; None where it cannot be told."""
    advice: tuple[str, ...] = field(default=())


def masked(capture: Capture, plugins: PluginManager) -> Capture:
    """The capture with the masks that a run would find without cameras, for views that have none yet."""
    for registered in plugins.components("mask_source"):
        traits = registered.component.traits
        if "automatic" not in traits or "needs_cameras" in traits or registered.missing:
            continue
        lacking = [i for i, view in enumerate(capture.views) if view.pixels().mask is None]
        if not lacking:
            break
        source: MaskSource = plugins.create("mask_source", registered.component.name)
        views, masks = list(capture.views), source.masks(capture, None)
        for i in lacking:
            views[i] = replace(views[i], mask=masks[i]) if masks[i] is not None else views[i]
        capture = replace(capture, views=tuple(views))
    return capture


def check_capture(capture: Capture, surface: tuple[Array, Array] | None = None) -> CaptureCheck:
    """Reads every photograph once, small. `surface`: points and outward normals (N, 3), to tell how the light moves."""
    read = [_read(view) for view in capture.views]
    small = [(pixels, camera) for pixels, camera, *_ in read]
    sharpness = np.array([sharp for *_, sharp, _ in read])
    middle = float(np.median(sharpness)) if len(sharpness) else 0.0
    agreement = mask_agreement([c for _, c in small], [p.mask for p, _ in small])
    views = tuple(
        _view_check(view, pixels, size, clipped, sharp / middle if middle > 0 else 1.0, agreed)
        for view, (pixels, _, size, sharp, clipped), agreed in zip(capture.views, read, agreement, strict=True)
    )
    cameras = [camera for _, camera in small if camera is not None]
    headlight = None
    if surface is not None and len(cameras) == len(small) and len(cameras) >= 3:
        headlight = headlight_score([p for p, _ in small], cameras, *surface)
    check = CaptureCheck(
        views=views,
        duplicates=tuple((capture.views[i].name, capture.views[j].name) for i, j in _duplicates([p for p, _ in small])),
        with_camera=len(cameras),
        directions_covered=directions_covered(cameras),
        flashes=sum(camera_record(view.path).flash is True for view in capture.views if view.path is not None),
        headlight=headlight,
    )
    return CaptureCheck(**{**vars(check), "advice": tuple(_advice(check))})


def mask_agreement(cameras: Sequence[Camera | None], masks: Sequence[NDArray[np.float32] | None]) -> list[float | None]:
    """Per view the IoU of its mask and the re-projected hull of all masks; None for views without mask or camera.

    The hull is carved on a coarse grid with a vote of nine in ten views, so that a wrong mask shows in its own figure.
    """
    result: list[float | None] = [None] * len(cameras)
    pairs = {
        i: (camera, mask)
        for i, (camera, mask) in enumerate(zip(cameras, masks, strict=True))
        if camera is not None and mask is not None and mask.any()
    }
    if len(pairs) < 3:
        return result
    hull = _voted_hull(list(pairs.values()))
    for index, (camera, mask) in pairs.items():
        if hull is None:
            result[index] = 0.0
            continue
        points, cell = hull
        shown = _splat(points, cell, camera)
        solid = mask > 0.5
        result[index] = float((shown & solid).sum() / max((shown | solid).sum(), 1))
    return result


def directions_covered(cameras: Sequence[Camera]) -> float | None:
    """Share of directions from what the cameras look at that lie within 30° of a camera."""
    if len(cameras) < 2:
        return None
    focus, _ = _focus(cameras)
    toward = np.array([c.center - focus for c in cameras])
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-300)
    i = np.arange(2000) + 0.5
    y, turn = 1 - i / 1000, np.pi * (3 - np.sqrt(5)) * i
    r = np.sqrt(1 - y * y)
    sphere = np.stack([r * np.cos(turn), y, r * np.sin(turn)], axis=1)
    return float(((sphere @ toward.T).max(axis=1) > np.cos(np.radians(30))).mean())


def headlight_score(
    pixels: Sequence[Pixels], cameras: Sequence[Camera], positions: Array, normals: Array
) -> float | None:
    """How much the surface's brightness follows the camera: 0 for a light in the world, 1 for a lamp at the camera.

    A matt place keeps its brightness from all sides under a light that stands still. Under a lamp at the camera it goes
    with the cosine of the view. So the logarithm of brightness is regressed on the logarithm of that cosine, each
    place's own mean taken out. None where fewer than 200 places are seen from three views.
    """
    step = max(1, len(positions) // 4000)
    points, facing = positions[::step], normals[::step]
    logs = np.full((len(cameras), len(points)), np.nan)
    cosines = np.full_like(logs, np.nan)
    for row, (picture, camera) in enumerate(zip(pixels, cameras, strict=True)):
        at, depth = camera.project(points)
        toward = camera.center - points
        cosine = (facing * toward).sum(axis=1) / np.maximum(np.linalg.norm(toward, axis=1), 1e-300)
        x, y = np.floor(np.clip(at, -1, 1e6)).astype(int).T
        seen = (depth > 0) & (cosine > 0.25) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
        if picture.mask is not None:
            seen[seen] = picture.mask[y[seen], x[seen]] > 0.99
        seen[seen] = ~picture.saturated[y[seen], x[seen]]
        value = picture.color_linear[y[seen], x[seen]].mean(axis=1)
        index = np.nonzero(seen)[0][value > 1e-3]
        logs[row, index] = np.log(value[value > 1e-3])
        cosines[row, index] = np.log(cosine[index])
    often = np.isfinite(logs).sum(axis=0) >= 3
    if often.sum() < 200:
        return None
    a, b = logs[:, often], cosines[:, often]
    a, b = a - np.nanmean(a, axis=0), b - np.nanmean(b, axis=0)
    known = np.isfinite(a)
    x, y = b[known], a[known]
    spread = float((x * x).sum())
    if spread < 1e-6 or float((y * y).sum()) < 1e-9:
        return 0.0
    slope = float((x * y).sum()) / spread
    correlation = float((x * y).sum()) / np.sqrt(spread * float((y * y).sum()))
    return float(np.clip(slope, 0, 1)) if correlation > _HEADLIGHT_CORRELATION else 0.0


def contact_sheet(capture: Capture, columns: int = 8, side: int = 160) -> NDArray[np.uint8]:
    """A picture of all photographs; what the masks leave out is dimmed."""
    rows = -(-len(capture.views) // columns)
    sheet = np.full((max(rows, 1) * side, columns * side, 3), 24, np.uint8)
    for i, view in enumerate(capture.views):
        pixels, _ = _reduced(view, view.pixels(), side)
        shown = linear_to_srgb(np.clip(pixels.color_linear, 0, 1))
        if pixels.mask is not None:
            shown = shown * (0.25 + 0.75 * pixels.mask[..., None])
        height, width = min(shown.shape[0], side), min(shown.shape[1], side)
        top, left = (i // columns) * side, (i % columns) * side
        sheet[top : top + height, left : left + width] = np.rint(shown[:height, :width] * 255)
    return sheet


def _read(view: View) -> tuple[Pixels, Camera | None, tuple[int, int], float, float]:
    """Small pixels and camera; width and height, sharpness and clipped share of the full size."""
    pixels = view.pixels()
    height, width = pixels.color_linear.shape[:2]
    weight = np.ones(pixels.saturated.shape, np.float32) if pixels.mask is None else pixels.mask
    clipped = float((pixels.saturated * weight).sum() / max(float(weight.sum()), 1e-9))
    small, camera = _reduced(view, pixels, _SIDE)
    return small, camera, (width, height), _sharpness(_reduced(view, pixels, _SHARP_SIDE)[0]), clipped


def _reduced(view: View, pixels: Pixels, side: int) -> tuple[Pixels, Camera | None]:
    factor = max(1, -(-max(pixels.color_linear.shape[:2]) // side))
    return pixels.downsampled(factor), None if view.camera is None else view.camera.downsampled(factor)


def _sharpness(pixels: Pixels) -> float:
    """Energy of the finest detail over the energy of coarser detail, inside the mask: blind to contrast."""
    image = linear_to_srgb(np.clip(pixels.color_linear.mean(axis=2), 0, 1))
    inner = np.ones_like(image, dtype=bool) if pixels.mask is None else pixels.mask > 0.99
    if min(image.shape) < 8 or inner.sum() < 64:
        return 0.0

    def detail(step: int) -> float:
        change = (image[:-step, :-step] - image[step:, step:]) ** 2
        both = inner[:-step, :-step] & inner[step:, step:]
        return float(change[both].mean()) if both.any() else 0.0

    return detail(1) / max(detail(4), 1e-12)


def _view_check(
    view: View, pixels: Pixels, size: tuple[int, int], clipped: float, sharpness: float, agreement: float | None
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
        sharpness=float(sharpness),
        mask_share=None if pixels.mask is None else float(pixels.mask.mean()),
        touches_border=border,
        agreement=agreement,
    )


def _duplicates(pixels: Sequence[Pixels]) -> list[tuple[int, int]]:
    """Pairs of pictures that are the same but for noise."""
    prints = []
    for picture in pixels:
        image = linear_to_srgb(np.clip(picture.color_linear.mean(axis=2), 0, 1))
        rows = np.linspace(0, image.shape[0] - 1, 24).astype(int)
        columns = np.linspace(0, image.shape[1] - 1, 24).astype(int)
        prints.append(image[np.ix_(rows, columns)].reshape(-1))
    if len(prints) < 2:
        return []
    table = np.array(prints)
    squares = (table**2).mean(axis=1)
    gap = squares[:, None] + squares[None, :] - 2 * table @ table.T / table.shape[1]
    return [(int(i), int(j)) for i, j in np.argwhere(np.triu(gap < 2e-5, 1))]


def _focus(cameras: Sequence[Camera]) -> tuple[Array, float]:
    """Where the cameras look (least squares), and their median distance from there."""
    o = np.array([c.center for c in cameras])
    d = np.array([c.world_to_camera[2, :3] for c in cameras])
    across = np.eye(3) - d[:, :, None] * d[:, None, :]
    focus = np.linalg.lstsq(across.sum(axis=0), np.einsum("vij,vj->i", across, o), rcond=None)[0]
    return focus, float(np.median(np.linalg.norm(o - focus, axis=1)))


def _voted_hull(pairs: Sequence[tuple[Camera, NDArray[np.float32]]]) -> tuple[Array, float] | None:
    """Grid points (N, 3) that nine in ten of the masks that show them call object, and the grid's spacing."""
    focus, distance = _focus([c for c, _ in pairs])
    low, high = focus - 0.8 * distance, focus + 0.8 * distance
    points, cell = np.zeros((0, 3)), 0.0
    for _ in range(3):  # zoom onto what is left
        axes = [np.linspace(low[i], high[i], _GRID) for i in range(3)]
        cell = float(max(a[1] - a[0] for a in axes))
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        shown, inside = np.zeros(len(grid)), np.zeros(len(grid))
        for camera, mask in pairs:
            at, depth = camera.project(grid)
            x, y = np.floor(np.clip(at, -1, 1e6)).astype(int).T
            seen = (depth > 0) & (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
            shown += seen
            inside[seen] += mask[y[seen], x[seen]] > 0.5
        points = grid[(inside >= 0.9 * shown) & (shown >= max(2.0, shown.max() / 2))]
        if len(points) < 2:
            return None
        low, high = points.min(axis=0) - 1.5 * cell, points.max(axis=0) + 1.5 * cell
    return points, cell


def _splat(points: Array, cell: float, camera: Camera) -> NDArray[np.bool_]:
    """Pixels (H, W) whose centre lies within half a cell of a point, as seen by the camera."""
    shown = np.zeros((camera.height, camera.width), dtype=bool)
    at, depth = camera.project(points)
    ahead = depth > 0
    at, half = at[ahead], 0.5 * cell * camera.intrinsics[0, 0] / depth[ahead]
    reach = int(np.ceil(half.max(initial=0.0)))
    x0, y0 = np.floor(at).astype(int).T
    for dy in range(-reach, reach + 1):
        for dx in range(-reach, reach + 1):
            x, y = x0 + dx, y0 + dy
            near = (np.abs(x + 0.5 - at[:, 0]) <= half + 0.5) & (np.abs(y + 0.5 - at[:, 1]) <= half + 0.5)
            near &= (x >= 0) & (y >= 0) & (x < camera.width) & (y < camera.height)
            shown[y[near], x[near]] = True
    return shown


def _advice(check: CaptureCheck) -> list[str]:
    """One sentence for each thing worth knowing, the gravest first."""
    views, said = check.views, []
    if len(views) < 20:
        said.append(f"{len(views)} photographs are few; 30 to 80 from all sides give a better shape")
    if 0 < check.with_camera < len(views):
        said.append(f"{len(views) - check.with_camera} of {len(views)} photographs have no camera")
    scores = [v.agreement for v in views if v.agreement is not None]
    if scores:
        middle = float(np.median(scores))
        if middle < 0.7:
            said.append(f"cameras and masks do not agree (IoU {middle:.2f}): check the cameras' axes and the masks")
        bad = [v.name for v in views if v.agreement is not None and v.agreement < middle - 0.12]
        if bad and middle >= 0.7:
            said.append(f"the masks of {', '.join(bad[:5])} disagree with the others")
    empty = [v.name for v in views if v.mask_share == 0]
    if empty:
        said.append(
            f"the masks of {len(empty)} photographs show nothing, such as {empty[0]}: mend them, or leave "
            "these photographs out"
        )
    sizes = {(v.width, v.height) for v in views}
    if len(sizes) > 1:
        said.append(f"the photographs have {len(sizes)} sizes")
    blurred = [v.name for v in views if v.sharpness < 0.5]
    if blurred:
        said.append(f"{len(blurred)} photographs are blurred compared with the others: {', '.join(blurred[:5])}")
    flat = [v.name for v in views if v.sharpness == 0 and v.saturated == 0 and v.brightness == 0]
    if flat:
        said.append(f"{len(flat)} photographs are black, such as {flat[0]}")
    if check.duplicates:
        said.append(
            f"{len(check.duplicates)} pairs of photographs are the same, such as {' and '.join(check.duplicates[0])}"
        )
    clipped = [v.name for v in views if v.saturated > 0.05]
    if clipped:
        said.append(f"{len(clipped)} photographs have more than 5 % clipped pixels, such as {clipped[0]}")
    brightness = np.array([v.brightness for v in views if v.brightness > 0])
    if len(brightness) and brightness.max() > 4 * np.median(brightness):
        said.append("the photographs' brightness differs by more than a factor of 4: were exposures fixed?")
    cut = [v.name for v in views if v.touches_border]
    if cut:
        said.append(f"the object reaches the border of {len(cut)} photographs, such as {cut[0]}")
    if check.directions_covered is not None and check.directions_covered < 0.25:
        said.append("the photographs look from few sides: what no camera sees will be guessed")
    if check.flashes > len(views) / 2:
        said.append(
            f"the flash fired in {check.flashes} photographs: its light moves with the camera, which "
            "light_frame = camera fits"
        )
    if check.headlight is not None and check.headlight > _HEADLIGHT_SLOPE:
        said.append("the light moves with the camera (a flash, or a turntable): light_frame = camera fits it")
    return said
