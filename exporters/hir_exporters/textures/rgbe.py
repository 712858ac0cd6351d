"""Encodes and decodes Radiance RGBE (.hdr), three mantissas and a shared exponent (Ward, Graphics Gems II).

A value is `mantissa * 2^(exponent - 136)`, as stb_image, three.js, Mitsuba and Blender read it. Mantissas are rounded:
the error is at most 1/256 of a pixel's largest channel. Why not a library: docs/adr/own_implementations.md.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

_LARGEST_VALUE = 255.0 * 2.0 ** (255 - 136)
_RESOLUTION = re.compile(rb"^([-+])Y (\d{1,9}) ([-+])X (\d{1,9})$")
_MAX_HEADER_BYTES = 1 << 16


class RgbeError(ValueError):
    """The bytes are not a readable Radiance file; the message says why."""


def encode_rgbe(radiance: NDArray[np.floating]) -> bytes:
    """The bytes of a .hdr file of radiance (H, W, 3), clipped to the range from 0 to the largest RGBE value.

    NaN raises `ValueError`.
    """
    height, width, _ = radiance.shape
    if np.isnan(radiance).any():
        raise ValueError("the radiance contains NaN, which a .hdr file cannot store")
    pixels = _to_rgbe(np.asarray(radiance, dtype=np.float64))
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode("ascii")
    if 8 <= width <= 0x7FFF:
        return header + _literal_scanlines(pixels)
    # Uncompressed pixels are no run codes: (1, 1, 1, e) and (2, 2, b < 128, e) have no mantissa of 128 or more.
    return header + pixels.tobytes()


def read_size(data: bytes) -> tuple[int, int]:
    """(height, width) in the header."""
    header = _parse_header(data)
    return header[0], header[1]


def decode_rgbe(data: bytes) -> NDArray[np.float32]:
    """Radiance (H, W, 3), row 0 at the top, of the bytes of a .hdr file: uncompressed, old or new run lengths.

    `EXPOSURE` and `COLORCORR` are divided out, as the format requires. XYZE files and transposed images raise
    `RgbeError`.
    """
    height, width, offset, flips, scale = _parse_header(data)
    pixels = _read_scanlines(memoryview(data)[offset:], height, width)[tuple(flips)]
    exponent = pixels[..., 3:].astype(np.int32)
    value = np.ldexp(pixels[..., :3].astype(np.float64), np.where(exponent > 0, exponent - 136, -1100)) / scale
    if not np.isfinite(value).all() or value.max(initial=0.0) > np.finfo(np.float32).max:
        raise RgbeError("its EXPOSURE gives values beyond float32")
    return value.astype(np.float32)


def _to_rgbe(radiance: NDArray[np.float64]) -> NDArray[np.uint8]:
    clipped = np.clip(radiance, 0.0, _LARGEST_VALUE)
    _, exponent = np.frexp(clipped.max(axis=-1))
    # A mantissa of 255.5 or more rounds to 256 and needs the next exponent.
    exponent += np.rint(np.ldexp(clipped.max(axis=-1), 8 - exponent)) > 255
    visible = (exponent > -128) & (clipped.max(axis=-1) > 0)
    pixels = np.zeros((*radiance.shape[:2], 4), dtype=np.uint8)
    mantissas = np.rint(np.ldexp(clipped, (8 - exponent)[..., None]))
    pixels[..., :3] = np.where(visible[..., None], mantissas, 0)
    pixels[..., 3] = np.where(visible, exponent + 128, 0)
    return pixels


def _literal_scanlines(pixels: NDArray[np.uint8]) -> bytes:
    """New-style scanlines of literal blocks only: noisy radiance hardly compresses."""
    height, width, _ = pixels.shape
    planar = np.ascontiguousarray(pixels.transpose(0, 2, 1))
    parts = [np.broadcast_to(np.array([2, 2, width >> 8, width & 255], np.uint8), (height, 4))]
    for channel in range(4):
        for start in range(0, width, 128):
            block = planar[:, channel, start : start + 128]
            parts += [np.full((height, 1), block.shape[1], np.uint8), block]
    return np.concatenate(parts, axis=1).tobytes()


def _parse_header(data: bytes) -> tuple[int, int, int, list[slice], NDArray[np.float64]]:
    if not data.startswith((b"#?RADIANCE", b"#?RGBE")):
        raise RgbeError("it does not begin with #?RADIANCE")
    offset, scale = data.index(b"\n") + 1 if b"\n" in data[:256] else len(data), np.ones(3)
    while True:
        end = data.find(b"\n", offset, offset + _MAX_HEADER_BYTES)
        if end < 0:
            raise RgbeError("its header has no end")
        line, offset = data[offset:end].strip(), end + 1
        key, _, value = line.partition(b"=")
        try:
            if key == b"FORMAT" and value.strip() != b"32-bit_rle_rgbe":
                raise RgbeError(f"its format is {value.decode('ascii', 'replace')!r}, only 32-bit_rle_rgbe is read")
            if key == b"EXPOSURE":
                scale = scale * float(value)
            if key == b"COLORCORR":
                scale = scale * np.array([float(part) for part in value.split()]).reshape(3)
        except RgbeError:
            raise
        except ValueError:
            raise RgbeError(f"its header line {line.decode('ascii', 'replace')!r} is not a number") from None
        if not line:
            break
    if not (np.isfinite(scale).all() and (scale > 0).all()):
        raise RgbeError("its EXPOSURE is not a positive number")
    end = data.find(b"\n", offset, offset + 64)
    match = _RESOLUTION.match(data[offset:end].strip()) if end >= 0 else None
    if match is None:
        raise RgbeError("its resolution line is not of the form '-Y height +X width'")
    height, width = int(match[2]), int(match[4])
    if height == 0 or width == 0:
        raise RgbeError("it has no pixels")
    flips = [slice(None, None, -1 if match[1] == b"+" else 1), slice(None, None, 1 if match[3] == b"+" else -1)]
    return height, width, end + 1, flips, scale


def _read_scanlines(body: memoryview, height: int, width: int) -> NDArray[np.uint8]:
    new_style = 8 <= width <= 0x7FFF and bytes(body[:2]) == b"\x02\x02" and len(body) > 2 and body[2] < 128
    if not new_style:
        return _read_flat(body, height, width)
    # A scanline of runs needs at least 2 bytes for each 127 values: refuse sizes that the file cannot hold.
    if len(body) < height * (4 + 4 * 2 * -(-width // 127)):
        raise RgbeError("it ends before its last row")
    pixels = np.empty((height, 4, width), dtype=np.uint8)
    position = 0
    for row in range(height):
        if bytes(body[position : position + 4]) != bytes((2, 2, width >> 8, width & 255)):
            raise RgbeError(f"row {row} does not start where it should")
        position += 4
        line = bytearray()
        while len(line) < 4 * width:
            if position + 1 >= len(body):
                raise RgbeError("it ends before its last row")
            count = body[position]
            if count > 128:
                line += bytes(body[position + 1 : position + 2]) * (count - 128)
                position += 2
            elif count > 0:
                line += body[position + 1 : position + 1 + count]
                position += 1 + count
            else:
                raise RgbeError(f"row {row} contains an empty run")
        if len(line) != 4 * width or position > len(body):
            raise RgbeError(f"row {row} has too many values")
        pixels[row] = np.frombuffer(line, np.uint8).reshape(4, width)
    return pixels.transpose(0, 2, 1)


def _read_flat(body: memoryview, height: int, width: int) -> NDArray[np.uint8]:
    count = height * width
    raw = np.frombuffer(body, np.uint8)[: len(body) // 4 * 4].reshape(-1, 4)
    repeats = (raw[:, :3] == 1).all(axis=1)
    if not repeats.any():
        if len(raw) < count:
            raise RgbeError("it ends before its last row")
        return raw[:count].reshape(height, width, 4)
    return _expand_old_runs(raw, repeats, count).reshape(height, width, 4)


def _expand_old_runs(raw: NDArray[np.uint8], repeats: NDArray[np.bool_], count: int) -> NDArray[np.uint8]:
    """Old run lengths: (1, 1, 1, n) repeats the pixel before it n times, n in base 256 over consecutive codes."""
    times = np.zeros(len(raw), dtype=np.int64)
    shift = 0
    for index, is_code in enumerate(repeats.tolist()):
        shift = shift + 8 if is_code and index and repeats[index - 1] else 0
        if shift > 24:
            raise RgbeError("a run is longer than any image")
        times[index] = int(raw[index, 3]) << shift if is_code else 1
    if repeats[0]:
        raise RgbeError("it starts with a run that repeats no pixel")
    last = np.maximum.accumulate(np.where(repeats, 0, np.arange(len(raw))))
    stop = int(np.searchsorted(np.cumsum(times), count)) + 1
    expanded = np.repeat(raw[last[:stop]], np.minimum(times[:stop], count), axis=0)
    if len(expanded) < count:
        raise RgbeError("it ends before its last row")
    return expanded[:count]
