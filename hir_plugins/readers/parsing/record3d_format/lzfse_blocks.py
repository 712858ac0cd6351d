"""Decompresses LZFSE with a bound on memory, which the library lacks.

A stream is a list of blocks, each with the number of bytes that it stands for (github.com/lzfse/lzfse,
src/lzfse_internal.h). A block of a few bytes may copy 10,000 times 2,359 bytes, so the numbers of copies are bounded,
too.
"""

from __future__ import annotations

import struct
from typing import Final

from hir_core.errors import ConfigError

BYTES_PER_COPY: Final = 3
"""Least mean length of a copy: the format's shortest copies have 4 bytes, and one entry in 315 only skips literals."""

_END: Final = b"bvx$"
_STORED: Final = b"bvx-"
_LZVN: Final = b"bvxn"
_LZFSE: Final = b"bvx2"
_LZFSE_HEADER: Final = 32
"""Bytes of the header without its tables."""


def decompress(content: bytes, length: int) -> bytes:
    """`length` bytes from a compressed stream; anything else raises `ValueError`."""
    try:
        import lzfse
    except ImportError:
        raise ConfigError(
            "depth maps of Record3D need their decompression; install it with: pip install lzfse"
        ) from None
    stated, copies = measured_blocks(content)
    if stated != length or copies * BYTES_PER_COPY > length:
        raise ValueError(f"it holds {stated} bytes instead of {length}")
    if length == 0:
        return b""
    try:
        decompressed = bytes(lzfse.decompress(content))
    except (lzfse.error, MemoryError):  # the library asks for twice the memory while a block says that it needs more
        raise ValueError("it is not compressed with LZFSE") from None
    if len(decompressed) != length:
        raise ValueError(f"it holds {len(decompressed)} bytes instead of {length}")
    return decompressed


def measured_blocks(content: bytes) -> tuple[int, int]:
    """Number of bytes that the blocks stand for, and number of their copies; `ValueError` where it is no stream."""
    at, length, copies = 0, 0, 0
    while content[at : at + 4] != _END:
        kind = content[at : at + 4]
        try:
            (stated,) = struct.unpack_from("<I", content, at + 4)
            if kind == _STORED:
                size = 8 + stated
            elif kind == _LZVN:
                size = 12 + struct.unpack_from("<I", content, at + 8)[0]
            elif kind == _LZFSE:
                literals, entries, states = struct.unpack_from("<QQQ", content, at + 8)
                header = states & 0xFFFFFFFF
                if header < _LZFSE_HEADER:
                    raise ValueError("a block ends within its header")
                size = header + (literals >> 20 & 0xFFFFF) + (entries >> 40 & 0xFFFFF)
                copies += literals >> 40 & 0xFFFFF
            else:
                raise ValueError("it is not compressed with LZFSE")
        except struct.error:
            raise ValueError("it is cut off") from None
        at, length = at + size, length + stated
    return length, copies
