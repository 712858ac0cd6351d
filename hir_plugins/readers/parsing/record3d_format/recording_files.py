"""Files of a recording, inside its .r3d (a zip archive) or unpacked: read one by one, with bounds."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

from hir_exporters.files.regular_files import check_regular_file

from hir_core.errors import CaptureError, InputError

MAX_FILE_BYTES: Final = 64 << 20
"""Of one photograph, one depth map, or the metadata; those of an hour take 20 MB."""

MAX_DIRECTORY_BYTES: Final = 32 << 20
"""Of the archive's list of files, which is held in memory: an hour has 650,000 files."""

_LOCAL_HEADER: Final = struct.Struct("<4s22xHH")
_END: Final = struct.Struct("<4s8xI6x")
_END_64_LOCATOR: Final = struct.Struct("<4s4xQ4x")
_END_64: Final = struct.Struct("<4s36xQ8x")
_MAX_COMMENT: Final = 65535
_IN_END_64: Final = 0xFFFFFFFF


@dataclass(frozen=True)
class RecordingFile:
    """Where the bytes of one file are; picklable."""

    path: Path
    """The archive, or the file itself."""
    name: str
    """For messages."""
    archived: zipfile.ZipInfo | None = None

    def read(self) -> bytes:
        """The bytes; what is damaged or too large raises `CaptureError`."""
        try:
            with check_regular_file(self.path).open("rb") as stream:
                content = _bounded(stream, self.name) if self.archived is None else _extracted(stream, self.archived)
        except InputError as error:
            raise CaptureError(str(error)) from None
        except OSError as error:
            raise CaptureError(f"{self.name} cannot be read ({error.strerror})") from None
        except (ValueError, zlib.error, struct.error) as error:
            raise CaptureError(f"{self.name} is damaged ({error}); export the recording again") from None
        return content


def files_of_archive(path: Path) -> Mapping[str, RecordingFile]:
    """The files of a .r3d by their names. A file that is no zip archive raises `CaptureError`."""
    try:
        with check_regular_file(path).open("rb") as stream:
            size = _directory_bytes(stream)
            if size > MAX_DIRECTORY_BYTES:
                raise CaptureError(f"{path} lists files in {size >> 20} MB, more than {MAX_DIRECTORY_BYTES >> 20} MB")
            with zipfile.ZipFile(stream) as archive:
                entries = archive.infolist()
    except InputError as error:
        raise CaptureError(str(error)) from None
    except (OSError, ValueError, NotImplementedError, struct.error, zipfile.BadZipFile) as error:
        raise CaptureError(f"{path} is no recording of Record3D ({error}); export it again as .r3d") from None
    return {entry.filename: RecordingFile(path, f"{path}/{entry.filename}", entry) for entry in entries}


def _bounded(stream: BinaryIO, name: str) -> bytes:
    content = stream.read(MAX_FILE_BYTES + 1)
    if len(content) > MAX_FILE_BYTES:
        raise CaptureError(f"{name} is larger than {MAX_FILE_BYTES >> 20} MB; export the recording again")
    return content


def _extracted(stream: BinaryIO, entry: zipfile.ZipInfo) -> bytes:
    """Bytes of an entry. `zipfile` itself would read the whole list of files again for each."""
    if max(entry.file_size, entry.compress_size) > MAX_FILE_BYTES:
        raise ValueError(f"it is larger than {MAX_FILE_BYTES >> 20} MB")
    if entry.flag_bits & 1 or entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ValueError("it is encrypted or compressed in a way that Record3D does not use")
    stream.seek(entry.header_offset)
    signature, name_bytes, extra_bytes = _LOCAL_HEADER.unpack(stream.read(_LOCAL_HEADER.size))
    if signature != b"PK\3\4":
        raise ValueError("its header is missing")
    stream.seek(name_bytes + extra_bytes, 1)
    content = stream.read(entry.compress_size)
    if entry.compress_type == zipfile.ZIP_DEFLATED:
        content = zlib.decompressobj(-zlib.MAX_WBITS).decompress(content, entry.file_size + 1)
    if len(content) != entry.file_size or zlib.crc32(content) != entry.CRC:
        raise ValueError("its checksum is wrong")
    return content


def _directory_bytes(stream: BinaryIO) -> int:
    """Length of the list of files that `zipfile` would read (APPNOTE.TXT of PKWARE, 4.3.14 to 4.3.16)."""
    end_of_file = stream.seek(0, 2)
    start = max(0, end_of_file - _END.size - _MAX_COMMENT)
    stream.seek(start)
    tail = stream.read()
    at = tail.rfind(b"PK\5\6")
    if at < 0:
        raise ValueError("it is no zip archive")
    size = int(_END.unpack_from(tail, at)[1])
    if size != _IN_END_64 and tail[max(at - _END_64_LOCATOR.size, 0) :][:4] != b"PK\6\7":
        return size
    _, offset = _END_64_LOCATOR.unpack_from(tail, at - _END_64_LOCATOR.size)
    if offset >= end_of_file:
        raise ValueError("the list of its files is missing")
    stream.seek(offset)
    signature, large = _END_64.unpack(stream.read(_END_64.size))
    if signature != b"PK\6\6":
        raise ValueError("the list of its files is missing")
    return int(large)
