"""The .usdz container: an uncompressed zip whose files begin at multiples of 64 bytes.

Why not OpenUSD's own writer: its bytes depend on the clock, see docs/adr/own_implementations.md.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence

_ALIGNMENT = 64
_DOS_DATE = 1 << 5 | 1  # the earliest date of zip, so that bytes do not depend on the clock
_PADDING_ID = 0x1986  # the extra field that OpenUSD's writer uses for padding
_MAX_ZIP32_BYTES = 0xFFFFFFFF


class PackageSizeError(ValueError):
    """The package would need zip64, which usdz does not allow."""


def usdz_bytes(files: Sequence[tuple[str, bytes]]) -> bytes:
    """The package of (name, content); the first file must be the root layer. The same files give the same bytes."""
    body, directory = bytearray(), bytearray()
    for name, data in files:
        encoded = name.encode("utf-8")
        padding = -(len(body) + 30 + len(encoded)) % _ALIGNMENT
        if 0 < padding < 4:  # an extra field has a header of four bytes
            padding += _ALIGNMENT
        extra = struct.pack("<HH", _PADDING_ID, padding - 4) + bytes(padding - 4) if padding else b""
        flags = 0 if name.isascii() else 0x0800
        size, check, offset = len(data), zlib.crc32(data), len(body)
        if offset + size > _MAX_ZIP32_BYTES:
            raise PackageSizeError
        common = struct.pack("<HHHHIIIHH", flags, 0, 0, _DOS_DATE, check, size, size, len(encoded), len(extra))
        body += struct.pack("<IH", 0x04034B50, 10) + common + encoded + extra + data
        central = struct.pack("<IHH", 0x02014B50, 10, 10) + common[:-2] + struct.pack("<HHHHII", 0, 0, 0, 0, 0, offset)
        directory += central + encoded
    end = struct.pack("<IHHHHIIH", 0x06054B50, 0, 0, len(files), len(files), len(directory), len(body), 0)
    return bytes(body + directory + end)
