"""The KTX 1 container (Khronos) of a prefiltered cubemap in half floats, as Filament's `createIblFromKtx1` reads it."""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

_HALF_FLOAT_MAX: Final = 65504.0
_GL_HALF_FLOAT, _GL_RGB, _GL_RGB16F = 0x140B, 0x1907, 0x881B


def ktx1_bytes(levels: Sequence[NDArray[np.floating]], metadata: Mapping[str, str]) -> bytes:
    """The file of levels (6, S, S, 3): RGB16F, faces +X -X +Y -Y +Z -Z, top row first, and text metadata by key."""
    entries = b""
    for key, text in metadata.items():
        pair = key.encode() + b"\0" + text.encode() + b"\0"
        entries += struct.pack("<I", len(pair)) + pair + bytes(-len(pair) % 4)
    side = levels[0].shape[1]
    header = b"\xabKTX 11\xbb\r\n\x1a\n" + struct.pack(
        "<13I",
        0x04030201,  # endianness
        _GL_HALF_FLOAT,
        2,  # bytes of a half float
        _GL_RGB,
        _GL_RGB16F,
        _GL_RGB,
        side,
        side,
        0,  # depth
        0,  # array elements
        6,  # faces
        len(levels),
        len(entries),
    )
    body = b""
    for level in levels:
        # Rows are padded to 4 bytes in KTX. A pixel has 6 bytes and sides are even: no padding is needed.
        faces = np.clip(level, 0, _HALF_FLOAT_MAX).astype("<f2").tobytes()
        body += struct.pack("<I", len(faces) // 6) + faces
    return header + entries + body
