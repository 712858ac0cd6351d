"""Agisoft Metashape: cameras exported as XML (File, Export, Export Cameras), beside the photographs.

Camera model: appendix C of the Metashape Professional user manual. Camera axes are OpenCV's; principal points are
offsets from the middle of the image.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Final, final
from xml.etree.ElementTree import Element

import numpy as np

from hir_core.capture import Array
from hir_core.errors import CaptureError
from hir_plugins.readers.parsing.camera_axes import rigid_inverse, rigid_transform
from hir_plugins.readers.parsing.lens_camera import LensCamera
from hir_plugins.readers.parsing.number_text import finite_number, finite_numbers
from hir_plugins.readers.parsing.posed_photos import PhotoFinder, PosedPhoto, PosedPhotosReader
from hir_plugins.readers.parsing.text_files import file_head
from hir_plugins.readers.parsing.xml_files import read_xml

_DISABLED: Final = ("0", "false")

EARTH_DISTANCE = 1e5
"""Longer translations, in metres, place the object on the Earth. They are dropped: float32 is too coarse for them."""

LARGEST_SKEW_PIXELS = 0.5
"""Skew (`b2`) up to this is neglected. It moves a pixel by `b2` times its height over the middle in focal lengths."""


@final
class MetashapeReader(PosedPhotosReader[Path]):
    """The first chunk with aligned cameras; cameras that are disabled or not aligned are left out."""

    name = "metashape"
    remedy = "no cameras of Metashape; export them as XML into this folder"

    def find(self, path: Path) -> Path | None:
        """The first XML file that has a chunk."""
        return next((f for f in sorted(path.glob("*.xml"))[:20] if b"<chunk" in file_head(f)), None)

    def cameras(self, source: Path, finder: PhotoFinder) -> list[PosedPhoto]:
        """In the chunk's world, in metres if the chunk has a scale."""
        del finder
        return _cameras(_chunk(source), source)

    def metres_source(self, source: Path) -> str:
        """The distances and coordinates that the project was scaled by; empty if it has none of them, or no scale."""
        chunk = _chunk(source)
        if not any(place.find("scale") is not None for place in chunk.iter("transform")):
            return ""
        measured = {
            "scale bar": _measured(chunk, "scalebars", "scalebar", ("distance",)),
            "marker with coordinates": _measured(chunk, "markers", "marker", ("x", "y", "z")),
            "photograph with coordinates": _measured(chunk, "cameras", "camera", ("x", "y", "z")),
        }
        # one point with coordinates gives no scale
        used = [_counted(n, what) for what, n in measured.items() if n >= (1 if what == "scale bar" else 2)]
        return f"Metashape, by {' and '.join(used)}" if used else ""


def _chunk(source: Path) -> Element:
    """The first chunk with an aligned camera."""
    chunk = next((chunk for chunk in read_xml(source).iter("chunk") if _aligned(chunk)), None)
    if chunk is None:
        raise CaptureError(f"{source} has no aligned camera; align the photographs and export the cameras again")
    return chunk


def _measured(chunk: Element, group: str, kind: str, values: tuple[str, ...]) -> int:
    """Number of entries with an enabled reference that has these values."""
    references = [entry.find("reference") for entry in chunk.iterfind(f"{group}//{kind}")]
    return sum(
        r is not None and r.get("enabled", "1") not in _DISABLED and all(r.get(value) is not None for value in values)
        for r in references
    )


def _counted(number: int, what: str) -> str:
    first, _, rest = what.partition(" with ")
    plural = first if number == 1 else f"{first}s"
    return f"{number} {plural} with {rest}" if rest else f"{number} {plural}"


def _aligned(chunk: Element) -> list[Element]:
    return [
        camera
        for camera in chunk.iterfind(".//cameras//camera")
        if camera.find("transform") is not None and camera.get("enabled", "1") not in _DISABLED
    ]


def _cameras(chunk: Element, source: Path) -> list[PosedPhoto]:
    lenses = {s.get("id"): s for s in chunk.iterfind(".//sensors//sensor")}
    components = {c.get("id"): c for c in chunk.iterfind(".//components//component")}
    found = []
    for camera in _aligned(chunk):
        label = camera.get("label") or ""
        owner = f"{source}, camera {label!r}"
        sensor = lenses.get(camera.get("sensor_id"))
        if sensor is None:
            raise CaptureError(f"{owner} has no sensor; export the cameras again")
        pose = rigid_transform(np.reshape(finite_numbers(camera.findtext("transform"), 16, owner), (4, 4)), owner)
        component = components.get(camera.get("component_id"))
        own = None if component is None else component.find("transform")
        place = chunk.find("transform") if own is None else own
        found.append(PosedPhoto(label, owner, _lens(sensor, owner), rigid_inverse(_in_world(pose, place, owner))))
    return found


def _in_world(pose: Array, place: Element | None, owner: str) -> Array:
    """A camera's pose in the world of a chunk's rotation, translation and scale; one that has none stays as it is."""
    if place is None:
        return pose
    parts = [place.findtext(name) for name in ("rotation", "translation", "scale")]
    if any(part is None for part in parts):
        return pose
    rotation = rigid_transform(
        np.concatenate([np.reshape(finite_numbers(parts[0], 9, owner), (3, 3)), np.zeros((3, 1))], axis=1), owner
    )
    translation, scale = np.array(finite_numbers(parts[1], 3, owner)), finite_numbers(parts[2], 1, owner)[0]
    if scale <= 0:
        raise CaptureError(f"{owner}: the scale {scale:g} of its chunk is not positive; export the cameras again")
    if np.linalg.norm(translation) > EARTH_DISTANCE:
        translation = np.zeros(3)
        warnings.warn(
            "the cameras are placed on the Earth; that position is dropped, so a scan of the same project fits them "
            "only if it was exported in local coordinates",
            stacklevel=2,
        )
    result = rotation @ pose
    result[:3, 3] = scale * (rotation[:3, :3] @ pose[:3, 3]) + translation
    return result


def _lens(sensor: Element, owner: str) -> LensCamera:
    kind = sensor.get("type", "frame")
    if kind not in ("frame", "fisheye"):
        raise CaptureError(f"{owner}: the sensor type {kind!r} is not supported; use frame or fisheye photographs")
    calibrations = sensor.findall("calibration")
    calibration = next(
        (c for c in calibrations if c.get("class") == "adjusted"), calibrations[-1] if calibrations else None
    )
    size = None if calibration is None else calibration.find("resolution")
    size = sensor.find("resolution") if size is None else size
    if calibration is None or size is None or calibration.find("f") is None:
        raise CaptureError(f"{owner}: its sensor has no calibration with a focal length; export the cameras again")
    width, height = (finite_number(size.get(key), owner) for key in ("width", "height"))
    names = ("f", "cx", "cy", "b1", "b2", "k1", "k2", "k3", "k4", "p1", "p2", "p3", "p4")
    value = {name: finite_number(calibration.findtext(name, "0"), owner) for name in names}
    unsupported = ("p3", "p4") if kind == "frame" else ("p1", "p2", "p3", "p4")
    if kind == "frame":
        unsupported = ("k4", *unsupported)
    used = [name for name in unsupported if value[name]]
    if used or abs(value["b2"]) > LARGEST_SKEW_PIXELS:
        named = ", ".join(used or ["b2"])
        raise CaptureError(
            f"{owner}: the lens uses {named}, which is not supported; optimize the cameras without it, or export "
            "undistorted photographs"
        )
    if kind == "frame":  # Metashape's p1 acts along x, OpenCV's along y
        coefficients = tuple(value[name] for name in ("k1", "k2", "p2", "p1", "k3"))
    else:
        coefficients = tuple(value[name] for name in ("k1", "k2", "k3", "k4"))
    return LensCamera(
        value["f"] + value["b1"],
        value["f"],
        width / 2 + value["cx"],
        height / 2 + value["cy"],
        width,
        height,
        coefficients,
        "radial" if kind == "frame" else "fisheye",
    )
