"""The stages of one task as one tar file, because an object store replaces one object atomically, but not several."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Final

from hir_core.errors import InputError
from hir_core.run.run_directory import RunDirectory
from hir_plugins.commands.batch.stage_groups import StageGroup

RECORDS: Final = ("run.json", "timings.json", "capture/cameras.json")
"""Files that every task rewrites."""


def result_files(run: Path) -> Iterator[Path]:
    """The files of a run directory without its lock, partial files and the workspaces of its stages."""
    for file in sorted(run.rglob("*")):
        parts = file.relative_to(run).parts
        in_workspace = parts[0] == "stages" and len(parts) > 2 and parts[2] == "work"
        if file.is_file() and not in_workspace and not any(part.startswith(".") for part in parts):
            yield file


def pack(run: Path, group: StageGroup) -> bytes:
    """A tar file of the group's stages and the run's records."""
    directory = RunDirectory(run)
    folders = [directory.stage(stage) for stage in group.stages]
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for file in result_files(run):
            name = file.relative_to(run).as_posix()
            if name in RECORDS or any(folder in file.parents for folder in folders):
                archive.add(file, name, recursive=False)
    return stream.getvalue()


def unpack(content: bytes, run: Path) -> None:
    """Adds the files of `pack` to a run directory.

    Raises `InputError` for damaged archives, for links, and for names that lead out of the directory.
    """
    try:
        with tarfile.open(fileobj=io.BytesIO(content)) as archive:
            for member in archive:
                name = PurePosixPath(member.name)
                stream = archive.extractfile(member) if member.isreg() else None
                if stream is None or name.is_absolute() or ".." in name.parts:
                    raise InputError(f"stored stages are damaged (unexpected {member.name!r}); they are computed again")
                (run / name).parent.mkdir(parents=True, exist_ok=True)
                (run / name).write_bytes(stream.read())
    except (tarfile.TarError, EOFError) as error:
        raise InputError(f"stored stages are damaged ({error}); they are computed again") from error
