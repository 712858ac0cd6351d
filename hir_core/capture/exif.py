"""EXIF metadata of a photograph: camera model, focal length, exposure, flash and GPS position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from hir_exporters.textures.pillow_images import open_image

_FOCAL_LENGTH, _FOCAL_35MM = 0x920A, 0xA405
_PIXELS_ACROSS, _PLANE_RESOLUTION, _PLANE_UNIT = 0xA002, 0xA20E, 0xA210
_MODEL, _EXIF, _FLASH = 0x0110, 0x8769, 0x9209
_EXPOSURE_TIME, _F_NUMBER, _ISO = 0x829A, 0x829D, 0x8827
_GPS = 0x8825
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}


@dataclass(frozen=True)
class CameraRecord:
    """EXIF fields of a camera; a field that is not recorded is empty."""

    model: str = ""
    focal_over_width: float = 0.0
    """Focal length divided by the width of the image (its longer side)."""
    flash: bool | None = None
    """Whether the flash fired."""
    exposure: float = 0.0
    """Exposure time in seconds × ISO / f-number², to which the linear values of a photograph are proportional."""


def camera_record(path: Path) -> CameraRecord:
    """The EXIF record of a photograph; an empty one where there is none or it is broken."""
    try:
        with open_image(path) as image:
            exif = image.getexif()
            model, table = str(exif.get(_MODEL, "")).strip("\0 "), dict(exif.get_ifd(_EXIF))
    except Exception:  # decoders raise many types on broken records; without a record only the guess is lost
        return CameraRecord()
    flash = table.get(_FLASH)
    fired = bool(flash & 1) if isinstance(flash, int) else None
    return CameraRecord(model, _focal_over_width(table), fired, _exposure(table))


def gps_position(path: Path) -> tuple[float, float, float] | None:
    """Latitude and longitude in degrees and height in metres that a photograph records; None where it does not."""
    try:
        with open_image(path) as image:
            table = dict(image.getexif().get_ifd(_GPS))
        degrees = [sum(float(part) / 60**i for i, part in enumerate(table[key])) for key in (2, 4)]
        height = float(table.get(6, 0.0)) * (-1 if table.get(5) in (1, b"\x01") else 1)
        south, west = str(table.get(1, "N")).upper().startswith("S"), str(table.get(3, "E")).upper().startswith("W")
    except Exception:  # as above: a broken record only loses the position
        return None
    latitude, longitude = (-degrees[0] if south else degrees[0]), (-degrees[1] if west else degrees[1])
    known = all(map(math.isfinite, (latitude, longitude, height))) and (latitude, longitude) != (0.0, 0.0)
    return (latitude, longitude, height) if known and abs(latitude) <= 90 and abs(longitude) <= 180 else None


def _exposure(table: Mapping[int, object]) -> float:
    iso = table.get(_ISO)
    time, aperture, sensitivity = (
        _number(value) for value in (table.get(_EXPOSURE_TIME), table.get(_F_NUMBER), _first(iso))
    )
    return _ratio(time * sensitivity, aperture * aperture)


def _first(value: object) -> object:
    """Some cameras record several sensitivities."""
    return value[0] if isinstance(value, tuple) and value else value


def _focal_over_width(table: Mapping[int, object]) -> float:
    focal, across, resolution = (_number(table.get(k)) for k in (_FOCAL_LENGTH, _PIXELS_ACROSS, _PLANE_RESOLUTION))
    unit = _UNIT_MM.get(int(_number(table.get(_PLANE_UNIT)) or 2), 25.4)
    if focal and across and resolution:
        # the width at capture, which a later resize leaves in the record, divided by the sensor's pixels per unit
        return _ratio(focal, across / resolution * unit)
    equivalent = _number(table.get(_FOCAL_35MM))
    return equivalent / 36.0 if equivalent else 0.0


def _ratio(numerator: float, denominator: float) -> float:
    """0 where it is not a positive finite number, as of an aperture of 1e-200."""
    ratio = numerator / denominator if denominator > 0 else 0.0
    return ratio if math.isfinite(ratio) else 0.0


def _number(value: object) -> float:
    """A positive finite number; 0 for anything else."""
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return 0.0
    return number if math.isfinite(number) and number > 0 else 0.0
