"""Contracts of mask sources, on photographs whose coverage is known."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hir_core.errors import HirError
from hir_core.plugins.registration import a_value
from hir_core.testing.captures import StoredPixels, TinyCapture, surface_mesh, tiny_capture
from hir_core.testing.contract import BrokenContract, Subject, contract, require
from hir_core.testing.exercise import Exercise, seeded
from hir_core.testing.files_read import require_files

if TYPE_CHECKING:
    from hir_core.capture import Capture, View
    from hir_core.plugins.interfaces import MaskSource
    from hir_core.scene import Scene


def _case(subject: Subject) -> tuple[TinyCapture, Capture, Scene | None, MaskSource]:
    """The truth; opaque photographs, with cameras and points where the source needs them, or what `testing` makes of
    them; the mesh where the source needs it; the source.
    """
    if "case" not in subject.memory:
        truth = tiny_capture(subject.folder(), views=8, size=96)
        input_capture, options = truth.without_masks(), dict[str, Any]()
        if not {"needs_cameras", "needs_mesh"} & subject.component.traits:
            views = tuple(replace(view, camera=None) for view in input_capture.views)
            input_capture = replace(input_capture, views=views, points=None)
        if subject.testing is not None:
            input_capture, options = subject.testing(truth, input_capture, subject.folder())
        subject.memory["case"] = truth, input_capture, options
    truth, input_capture, options = subject.memory["case"]
    scene = surface_mesh() if "needs_mesh" in subject.component.traits else None
    return truth, input_capture, scene, subject.create(**options)


def exercise(subject: Subject, device: str) -> Exercise:
    """All masks."""
    del device
    _, input_capture, scene, source = _case(subject)

    def run() -> dict[str, np.ndarray]:
        found = source.masks(input_capture, scene)
        return {input_capture.views[i].name: mask for i, mask in enumerate(found) if mask is not None}

    return Exercise({"capture": input_capture}, run)


@contract("mask_source")
def masks_are_the_true_ones(subject: Subject) -> None:
    """One mask (height, width) of float32 in 0…1 for each view, or None; those that it gives overlap the true coverage
    by an IoU of at least 0.9, and it gives at least one. Without the traits `needs_cameras` and `needs_mesh` the
    capture has neither cameras nor points; with the trait `reads_files`, `files` lists files that are there.
    """
    truth, input_capture, scene, source = _case(subject)
    seeded(0)
    masks: object = source.masks(input_capture, scene)
    if not isinstance(masks, list):
        raise BrokenContract(
            f"masks returns {a_value(masks)}; return a list of numpy arrays, one for each view, or None"
        )
    require(
        len(masks) == len(input_capture.views),
        f"{len(input_capture.views)} views get {len(masks)} masks; return one for each view, or None",
    )
    other = next((mask for mask in masks if mask is not None and not isinstance(mask, np.ndarray)), None)
    require(other is None, f"masks returns a list with {a_value(other)}; return a list of numpy arrays, or None")
    if subject.has("reads_files"):
        require_files(source.files(input_capture))
    require(any(mask is not None for mask in masks), "no view of a capture made for it gets a mask")
    for view, mask, true in zip(input_capture.views, masks, truth.masks, strict=True):
        if mask is None:
            continue
        require(mask.shape == true.shape, f"the mask of view {view.name} is {mask.shape}, its picture {true.shape}")
        require(mask.dtype == np.float32, f"the mask of view {view.name} is {mask.dtype}, not float32")
        low, high = float(mask.min()), float(mask.max())
        require(
            np.isfinite(mask).all() and low >= 0 and high <= 1,
            f"the mask of view {view.name} goes from {low:.3g} to {high:.3g}",
        )
        overlap = float(np.minimum(mask, true).sum() / np.maximum(mask, true).sum())
        require(overlap >= 0.9, f"the mask of view {view.name} overlaps the true one by an IoU of {overlap:.3f}")


@contract("mask_source")
def unusable_photographs_are_refused(subject: Subject) -> None:
    """No views, photographs of one colour, of noise, of one pixel: masks in 0…1, None, or a `HirError`."""
    _, input_capture, scene, source = _case(subject)
    random = np.random.default_rng(0)
    pictures = {
        "photographs of one colour": np.full((32, 32, 3), 0.2, np.float32),
        "photographs of noise": random.random((32, 32, 3)).astype(np.float32),
        "photographs of one pixel": np.full((1, 1, 3), 0.2, np.float32),
    }
    cases = {"no views": replace(input_capture, views=(), points=None)}
    for name, picture in pictures.items():
        cases[name] = replace(input_capture, views=tuple(_with(v, picture) for v in input_capture.views), points=None)
    for name, capture in cases.items():
        try:
            masks = source.masks(capture, scene)
        except HirError as error:
            require(len(str(error)) > 15, f"given {name}, it raises {type(error).__name__}({str(error)!r})")
            continue
        except Exception as error:
            require(False, f"given {name}, it raises {type(error).__name__}: {error}")
            continue
        require(len(masks) == len(capture.views), f"given {name}, {len(capture.views)} views get {len(masks)} masks")
        sound = all(m is None or (np.isfinite(m).all() and m.min() >= 0 and m.max() <= 1) for m in masks)
        require(sound, f"given {name}, masks leave 0…1")


def _with(view: View, picture: np.ndarray) -> View:
    """The view with another picture, and a camera of the size of the picture."""
    height, width = picture.shape[:2]
    camera = None if view.camera is None else replace(view.camera, width=width, height=height)
    return replace(view, camera=camera, read=StoredPixels(picture, None), path=None, mask=None)
