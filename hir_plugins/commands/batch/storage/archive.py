"""What a group adds to a run, as one tar: an object of a store is there as a whole or not at all."""

from __future__ import annotations

import io
import tarfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from hir_core.errors import InputError
from hir_core.run.run_directory import RunDirectory
from hir_plugins.commands.batch.stage_groups import Group

RECORDS = ("run.json", "timings.json", "capture/cameras.json")
"""What every group writes again."""


def kept_files(run: Path) -> Iterator[Path]:
    """The files of a run that others need: without its lock, its partial files and the workspaces of its stages."""
    for file in sorted(run.rglob("*")):
        parts = file.relative_to(run).parts
        private = parts[0] == "stages" and len(parts) > 2 and parts[2] == "work"
        if file.is_file() and not private and not any(part.startswith(".") for part in parts):
            yield file


def pack(run: Path, group: Group) -> bytes:
    """The stages of a group and the run's records so far."""
    directory = RunDirectory(run)
    folders = [directory.stage(stage) for stage in group.stages]
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w", format=tarfile.PAX_FORMAT) as archive:
        for file in kept_files(run):
            name = file.relative_to(run).as_posix()
            if name in RECORDS or any(folder in file.parents for folder in folders):
                archive.add(file, name, recursive=False)
    return stream.getvalue()


def unpack(content: bytes, run: Path) -> None:
    """Adds what `pack` packed to the folder of a run; links and names that lead out of it are an `InputError`."""
    try:
        with tarfile.open(fileobj=io.BytesIO(content)) as archive:
            for member in archive:
                place = PurePosixPath(member.name)
                stream = archive.extractfile(member) if member.isreg() else None
                if stream is None or place.is_absolute() or ".." in place.parts:
                    raise InputError(f"stored stages are damaged (they hold {member.name!r}); they are made again")
                (run / place).parent.mkdir(parents=True, exist_ok=True)
                (run / place).write_bytes(stream.read())
    except (tarfile.TarError, EOFError) as error:
        raise InputError(f"stored stages are damaged ({error}); they are made again") from error
