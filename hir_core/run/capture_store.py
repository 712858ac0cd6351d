"""What a run keeps of its capture: cameras, masks and points that initializers found, and a mark of the input."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.files.atomic import atomic_path
from numpy.typing import NDArray

from hir_core.capture.camera import Camera
from hir_core.capture.capture import Capture, OrientedPoints, View
from hir_core.capture.measured_irradiance import MeasuredIrradiance
from hir_core.capture.photograph_exposures import EQUAL_EXPOSURES, PhotographExposures
from hir_core.errors import InputError
from hir_core.files.array_files import read_arrays
from hir_core.files.file_checksums import file_hash
from hir_core.files.json_documents import read_json, write_json


def fingerprint(capture: Capture) -> str:
    """Hash of all that a fit may look at: each view's name, camera, exposure, file and mask, and points that were read.

    No other file is opened.
    """
    digest = hashlib.blake2b(digest_size=16)
    hash_once = cache(file_hash)  # all frames of a video are in one file
    digest.update(repr((capture.split, capture.light_frame, capture.reader)).encode())
    digest.update(np.ascontiguousarray(capture.world_from_source, dtype=np.float64).tobytes())
    if capture.irradiance is not None:
        digest.update(repr(capture.irradiance).encode())
    for view in capture.views:
        digest.update(repr((view.name, view.gain.tolist(), view.distortion, camera_document(view.camera))).encode())
        if view.take:
            digest.update(repr(("take", view.take)).encode())
        for path in (view.path, view.mask_path):
            # one that is missing counts too: a photograph's bytes must not pass for its mask's
            digest.update(b"-" if path is None else hash_once(path).encode())
        if view.depth is not None:
            digest.update(repr(view.depth.world_per_unit).encode())
            for path in view.depth.paths:
                digest.update(hash_once(path).encode())
    if capture.points is not None:
        for array in (capture.points.positions, capture.points.normals, capture.points.colors):
            digest.update(b"-" if array is None else np.ascontiguousarray(array, dtype=np.float64).tobytes())
    return digest.hexdigest()


def camera_document(camera: Camera | None) -> dict[str, Any] | None:
    """A camera as JSON, every digit of it."""
    if camera is None:
        return None
    return {
        "width": camera.width,
        "height": camera.height,
        "K": np.asarray(camera.intrinsics, dtype=np.float64).tolist(),
        "distortion": [float(k) for k in camera.distortion],
        "world_to_camera": np.asarray(camera.world_to_camera, dtype=np.float64).tolist(),
    }


def camera_from_document(document: Mapping[str, Any], source: str) -> Camera:
    """The inverse of `camera_document`; what is wrong is an error that names `source`."""
    try:
        intrinsics = np.array(document["K"], dtype=np.float64)
        pose = np.array(document["world_to_camera"], dtype=np.float64)
        width, height = int(document["width"]), int(document["height"])
        distortion = tuple(float(k) for k in document.get("distortion", ()))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{source}: a camera is malformed ({type(error).__name__}: {error})") from error
    finite = all(np.isfinite(a).all() for a in (intrinsics, pose, np.array(distortion)))
    if intrinsics.shape != (3, 3) or pose.shape != (4, 4) or width < 1 or height < 1 or not finite:
        raise InputError(f"{source}: a camera needs a finite K (3×3), world_to_camera (4×4) and a size of at least 1×1")
    if not abs(np.linalg.det(pose)) > 0 or not abs(np.linalg.det(intrinsics)) > 0:
        raise InputError(f"{source}: the pose or the K of a camera cannot be inverted; run again with --resume")
    return Camera(intrinsics, pose, width, height, distortion)


def save_capture(capture: Capture, folder: Path) -> None:
    """Writes what `restore_capture` needs: everything but the photographs."""
    views = [
        {
            "name": v.name,
            "camera": camera_document(v.camera),
            "distortion": list(v.distortion),
            "exposure": v.exposure,
            "white_balance": list(v.white_balance),
            "depth_world_per_unit": None if v.depth is None else v.depth.world_per_unit,
            "depth_min_confidence": None if v.depth is None else v.depth.min_confidence,
        }
        for v in capture.views
    ]
    arrays = {f"mask_{i}": v.mask for i, v in enumerate(capture.views) if v.mask is not None}
    if capture.points is not None:
        named = {
            "positions": capture.points.positions,
            "normals": capture.points.normals,
            "colors": capture.points.colors,
        }
        arrays |= {f"points_{name}": np.asarray(value) for name, value in named.items() if value is not None}
    with atomic_path(folder / "capture.npz") as temporary:
        np.savez_compressed(temporary, **arrays)  # type: ignore[arg-type]
    write_json(
        folder / "capture.json",
        {
            "views": views,
            "world_from_source": capture.world_from_source,
            "light_frame": capture.light_frame,
            "irradiance": None if capture.irradiance is None else capture.irradiance.as_document(),
        },
    )


def restore_capture(capture: Capture, folder: Path) -> Capture:
    """What `save_capture` saw, with the photographs of `capture`, by name; `InputError` where it is damaged."""
    document, arrays = read_json(folder / "capture.json"), read_arrays(folder / "capture.npz")
    known = {view.name: view for view in capture.views}
    try:
        views = tuple(
            _restored(known, entry, arrays.get(f"mask_{i}"), str(folder / "capture.json"))
            for i, entry in enumerate(document["views"])
        )
        irradiance = document.get("irradiance")  # older runs have none
        return replace(
            capture,
            views=views,
            points=_points(arrays),
            light_frame={"world": "world", "camera": "camera"}[document["light_frame"]],  # type: ignore[arg-type]
            world_from_source=np.array(document["world_from_source"], dtype=np.float64).reshape(4, 4),
            irradiance=None if irradiance is None else MeasuredIrradiance.from_document(irradiance),
        )
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"{folder} is no whole capture of a run ({reason}); run without --resume") from error


def _restored(known: Mapping[str, View], entry: Mapping[str, Any], mask: NDArray[Any] | None, source: str) -> View:
    if entry["name"] not in known:
        raise InputError(f"{source} names {entry['name']!r}, which the capture lacks")
    camera = None if entry["camera"] is None else camera_from_document(entry["camera"], source)
    if mask is not None and (mask.dtype.kind not in "fiub" or mask.ndim != 2):
        raise ValueError(f"the mask of {entry['name']} is no picture")
    red, green, blue = (float(factor) for factor in entry.get("white_balance", (1, 1, 1)))  # older runs have none
    view, scale = known[entry["name"]], entry.get("depth_world_per_unit")
    # without a scale an initializer gave up the depth: its cameras are others
    depth = None if scale is None else view.depth
    if depth is not None and scale is not None:
        least = entry.get("depth_min_confidence", depth.min_confidence)  # older runs have none
        depth = replace(depth, world_per_unit=float(scale), min_confidence=float(least))
    return replace(
        view,
        depth=depth,
        camera=camera,
        mask=mask,
        distortion=tuple(float(k) for k in entry["distortion"]),
        exposure=float(entry["exposure"]),
        white_balance=(red, green, blue),
    )


def _points(arrays: Mapping[str, NDArray[Any]]) -> OrientedPoints | None:
    named = {name: arrays[key] for name in ("positions", "normals", "colors") if (key := f"points_{name}") in arrays}
    if "positions" not in named:
        return None
    shape = (len(named["positions"]), 3)
    if any(a.shape != shape or a.dtype.kind not in "fiu" for a in named.values()):
        raise ValueError("its points are not three numbers each")
    return OrientedPoints(**named)


def read_exposures(path: Path) -> PhotographExposures:
    """The exposures in the model.json of a reflectance stage, equal ones where it has none; `InputError` where they are
    damaged.
    """
    document = read_json(path).get("exposures")
    if document is None:
        return EQUAL_EXPOSURES
    try:
        return PhotographExposures.from_document(document)
    except (AttributeError, TypeError, ValueError, OverflowError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise InputError(f"{path} holds damaged exposures ({reason}); run without --resume") from error


def write_cameras(path: Path, capture: Capture, all_names: Sequence[str]) -> None:
    """capture/cameras.json: every view that was read, in the world of `capture`; one without a camera says so."""
    known = {view.name: view for view in capture.views}
    views = []
    for name in all_names:
        camera = known[name].camera if name in known else None
        document = camera_document(camera)
        if document is not None and known[name].distortion:
            document["distortion"] = [float(k) for k in known[name].distortion]
        views.append({"name": name, "split": capture.split, "registered": camera is not None} | (document or {}))
    write_json(path, {"axes": "right-handed, +Y up; cameras: OpenCV, pixel centres at .5", "views": views})


def read_cameras(path: Path) -> dict[str, Camera]:
    """The registered cameras of capture/cameras.json, by name; `distortion` is that of the photographs on disk."""
    document = read_json(path)
    views = document.get("views")
    if not isinstance(views, list) or not all(isinstance(v, dict) for v in views):
        raise InputError(f"{path} has no list of views")
    return {str(v.get("name")): camera_from_document(v, str(path)) for v in views if v.get("registered") is True}
