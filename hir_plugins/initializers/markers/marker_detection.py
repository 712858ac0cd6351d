"""Printed markers (ArUco, AprilTag) in photographs, by OpenCV's detector."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import cv2
import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray

from hir_core.capture import View

DICTIONARIES: Final[Mapping[str, int]] = {
    "aruco_4x4": cv2.aruco.DICT_4X4_1000,
    "aruco_5x5": cv2.aruco.DICT_5X5_1000,
    "aruco_6x6": cv2.aruco.DICT_6X6_1000,
    "aruco_7x7": cv2.aruco.DICT_7X7_1000,
    "aruco_original": cv2.aruco.DICT_ARUCO_ORIGINAL,
    "apriltag_16h5": cv2.aruco.DICT_APRILTAG_16h5,
    "apriltag_25h9": cv2.aruco.DICT_APRILTAG_25h9,
    "apriltag_36h10": cv2.aruco.DICT_APRILTAG_36h10,
    "apriltag_36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
"""Name in the options → OpenCV's number. ArUco's smaller dictionaries are the first markers of these."""
COMPARED_VIEWS = 12
"""Photographs in which all dictionaries are tried."""
COMPARED_SIDE = 1600
"""Their longer side in pixels, at most: nine dictionaries in photographs of 12 megapixels take a second each."""
MIN_VIEWS = 2


@dataclass(frozen=True, eq=False)
class SeenMarker:
    """One marker in one photograph."""

    view: int
    number: int
    """Its number in the dictionary."""
    corners: Float[NDArray[np.float64], "4 2"]
    """Pixels of the photograph without lens distortion, pixel centres at ½; clockwise from the marker's own upper left
    corner, as seen from its front."""


def find_dictionary(views: Sequence[View]) -> str | None:
    """The dictionary of which most markers are seen in two or more of a few photographs; None where there is none."""
    if len(views) < MIN_VIEWS:
        return None
    chosen = [views[i] for i in np.unique(np.linspace(0, len(views) - 1, COMPARED_VIEWS).round().astype(int))]
    pictures = [_reduced(grey_picture(view)) for view in chosen]
    counts_of_dictionaries: Counter[str] = Counter()
    for name in DICTIONARIES:
        seen = Counter(number for picture in pictures for number, _ in _detect(picture, name))
        counts_of_dictionaries[name] = sum(count for count in seen.values() if count >= MIN_VIEWS)
    best, count = counts_of_dictionaries.most_common(1)[0]
    return best if count else None


def seen_markers(views: Sequence[View], dictionary: str) -> tuple[dict[int, list[SeenMarker]], set[int]]:
    """The photographs of each marker that two or more show, and the numbers that one photograph shows twice.

    A number that lies twice in one photograph cannot be told apart, and is left out everywhere.
    """
    found: dict[int, list[SeenMarker]] = defaultdict(list)
    repeated = set()
    for index, view in enumerate(views):
        detected = _detect(grey_picture(view), dictionary)
        counts = Counter(number for number, _ in detected)
        repeated |= {number for number, count in counts.items() if count > 1}
        for number, corners in detected:
            found[number].append(SeenMarker(index, number, corners))
    kept = {n: seen for n, seen in sorted(found.items()) if n not in repeated and len(seen) >= MIN_VIEWS}
    return kept, repeated


def grey_picture(view: View) -> NDArray[np.uint8]:
    """The photograph without lens distortion, in linear grey values (H, W), as OpenCV's detector takes it.

    Lenses blur linear light. In sRGB an edge between black and white seems to lie inside the black.
    """
    grey = view.pixels().color_linear.mean(axis=2)
    return np.asarray(255 * (grey / max(float(np.quantile(grey, 0.99)), 1e-6)).clip(0, 1) + 0.5).astype(np.uint8)


def _reduced(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    scale = COMPARED_SIDE / max(picture.shape)
    return (
        picture
        if scale >= 1
        else np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
    )


def _detect(picture: NDArray[np.uint8], dictionary: str) -> list[tuple[int, NDArray[np.float64]]]:
    parameters = cv2.aruco.DetectorParameters()
    # lines fitted to the edges; corners in whole pixels, or refined in a window that reaches the inner cells, are worse
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(DICTIONARIES[dictionary]), parameters)
    corners, numbers, _ = detector.detectMarkers(picture)
    if numbers is None:
        return []
    return [
        (int(number), corner.reshape(4, 2).astype(np.float64))  # the fitted lines have pixel centres at ½
        for number, corner in zip(np.asarray(numbers).reshape(-1), corners, strict=True)
    ]
