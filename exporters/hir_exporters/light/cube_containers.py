"""KTX 1 and DDS bytes of a cubemap with its levels, half floats."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

_HALF_MAX = 65504.0
_GL_HALF_FLOAT, _GL_RGB, _GL_RGB16F = 0x140B, 0x1907, 0x881B


def ktx_bytes(levels: Sequence[NDArray[np.floating]], metadata: Mapping[str, str]) -> bytes:
    """KTX 1 (Khronos) of levels (6, S, S, 3): RGB16F, faces +X -X +Y -Y +Z -Z, top row first."""
    entries = b""
    for key, text in metadata.items():
        pair = key.encode() + b"\0" + text.encode() + b"\0"
        entries += struct.pack("<I", len(pair)) + pair + bytes(-len(pair) % 4)
    side = levels[0].shape[1]
    header = b"\xabKTX 11\xbb\r\n\x1a\n" + struct.pack(
        "<13I",
        0x04030201,
        _GL_HALF_FLOAT,
        2,
        _GL_RGB,
        _GL_RGB16F,
        _GL_RGB,
        side,
        side,
        0,
        0,
        6,
        len(levels),
        len(entries),
    )
    body = b""
    for level in levels:
        # rows of 6 bytes a pixel, padded to 4: sides are even, so there is nothing to pad
        faces = _halves(level).tobytes()
        body += struct.pack("<I", len(faces) // 6) + faces
    return header + entries + body


def dds_bytes(levels: Sequence[NDArray[np.floating]]) -> bytes:
    """DDS with a DX10 header of levels (6, S, S, 3): R16G16B16A16_FLOAT, each face followed by its smaller levels."""
    side, count = levels[0].shape[1], len(levels)
    flags, caps, caps2 = 0x1 | 0x2 | 0x4 | 0x1000 | 0x20000 | 0x8, 0x8 | 0x1000 | 0x400000, 0x200 | 0xFC00
    pixel_format = struct.pack("<II4s5I", 32, 0x4, b"DX10", 0, 0, 0, 0, 0)
    header = struct.pack("<7I", 124, flags, side, side, side * 8, 0, count) + bytes(44) + pixel_format
    header += struct.pack("<5I", caps, caps2, 0, 0, 0)
    float16_rgba, texture2d, cube = 10, 3, 0x4
    dx10 = struct.pack("<5I", float16_rgba, texture2d, cube, 1, 0)
    body = b""
    for face in range(6):
        for level in levels:
            alpha = np.ones((*level[face].shape[:2], 1))
            body += _halves(np.concatenate([level[face], alpha], axis=-1)).tobytes()
    return b"DDS " + header + dx10 + body


def _halves(values: NDArray[np.floating]) -> NDArray[np.float16]:
    return np.clip(values, 0, _HALF_MAX).astype("<f2")
