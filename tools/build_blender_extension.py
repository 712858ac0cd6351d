"""Builds the extension of Blender: `python tools/build_blender_extension.py [FOLDER]` writes FOLDER/hir-VERSION.zip.

FOLDER is build/ unless it is given. Nothing is compressed and all dates are the same: each machine writes the same
bytes.
"""

from __future__ import annotations

import io
import sys
import tomllib
import zipfile
from pathlib import Path
from typing import Final

ROOT: Final = Path(__file__).resolve().parent.parent
SOURCE: Final = ROOT / "examples" / "engines" / "blender_extension"
MANIFEST: Final = "blender_manifest.toml"
DATE: Final = (1980, 1, 1, 0, 0, 0)
"""The oldest date that a zip can hold."""

FILE_MODE: Final = 0o644 << 16


def members() -> dict[str, bytes]:
    """Name in the archive → content: the manifest, the modules and the licence."""
    files = [SOURCE / MANIFEST, *sorted(SOURCE.glob("*.py")), ROOT / "LICENSE"]
    # the same bytes where git writes \r\n
    return {file.name: file.read_bytes().replace(b"\r\n", b"\n") for file in files}


def archive() -> bytes:
    """The bytes of the zip."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as target:
        for name, content in members().items():
            entry = zipfile.ZipInfo(name, DATE)
            entry.create_system, entry.external_attr = 3, FILE_MODE  # Unix, whatever the system is
            target.writestr(entry, content)
    return buffer.getvalue()


def build(folder: Path) -> Path:
    """Writes the extension to `folder`; returns its path."""
    manifest = tomllib.loads((SOURCE / MANIFEST).read_text(encoding="utf-8"))
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{manifest['id']}-{manifest['version']}.zip"
    file.write_bytes(archive())
    return file


if __name__ == "__main__":
    print(build(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build"))
