"""The folder of a run: settings, stages, timings. Files are complete or absent; one process at a time works on it."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from filelock import FileLock, Timeout
from hir_exporters.files.atomic import is_partial, remove_partials

from hir_core.errors import ConfigError, HirError, InputError, StageError
from hir_core.files.file_checksums import changed_file, checksums, regular_files
from hir_core.files.file_names import check_text_path
from hir_core.files.json_documents import json_text, jsonable, read_json, write_json

STAGE_NAMES: Final = ("initializer", "geometry", "atlas", "reflectance", "bake", "export")
"""The stages in the order of a run; folders are numbered from 1."""
LAST_STAGE: Final = STAGE_NAMES[-1]

SCENE_STAGE: Final = "bake"
"""Writes `RunDirectory.scene`."""

RECORD: Final = "stage.json"
WORKSPACE: Final = "work"
"""The entries of a stage's folder that are not its result."""

FORMAT: Final = "hir-run"
VERSION: Final = 2


@dataclass(frozen=True)
class StageRecord:
    """What stage.json holds."""

    stage: str
    key: str
    """Hash of everything the result depends on."""
    finished: bool = False
    report: Mapping[str, Any] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    """Hash of each file that the stage wrote, by its path in the run; without stage.json and the workspace."""

    def as_document(self) -> dict[str, Any]:
        """For stage.json, with a hash of everything else in it."""
        document = dict(jsonable(asdict(self)))
        return document | {"checksum": hashlib.blake2b(json_text(document).encode(), digest_size=16).hexdigest()}


@dataclass(frozen=True)
class RunDirectory:
    """The folder of one run."""

    path: Path

    @property
    def scene(self) -> Path:
        """The finished asset in the open scene format."""
        return self.path / "scene"

    @property
    def exports(self) -> Path:
        return self.path / "exports"

    @property
    def report(self) -> Path:
        return self.path / "report"

    @property
    def cameras(self) -> Path:
        return self.path / "capture" / "cameras.json"

    @property
    def log(self) -> Path:
        """Messages with their time; rotates."""
        return self.path / "log.txt"

    def evaluation(self, split: str) -> Path:
        """The folder for metrics and pictures that `hir evaluate` writes for a split."""
        return self.path / "evaluation" / split

    def stage(self, name: str) -> Path:
        """Folder of a stage, such as `stages/2-geometry`."""
        return self.path / "stages" / f"{STAGE_NAMES.index(name) + 1}-{name}"

    def read_run(self) -> dict[str, Any]:
        """run.json: settings, versions, plugins, seeds, reports, metrics."""
        document = read_json(self.path / "run.json")
        if document.get("format") != FORMAT:
            raise InputError(f"{self.path / 'run.json'} is no run: its format is {document.get('format')!r}")
        _check_version(self.path / "run.json", document)
        return document

    @property
    def has_finished_scene(self) -> bool:
        """Whether `scene` is the result of the stages that run.json lists. It is of an earlier call where the latest
        one ended before `bake`: the fit may be another one since then.
        """
        return self.scene.is_dir() and SCENE_STAGE in self.read_run().get("stages", {})

    def write_run(self, document: Mapping[str, Any]) -> None:
        """Replaces run.json."""
        write_json(self.path / "run.json", {"format": FORMAT, "version": VERSION} | dict(document))

    def read_timings(self) -> dict[str, Any]:
        """timings.json: seconds, machine, dates, memory; empty where there is none yet."""
        path = self.path / "timings.json"
        return read_json(path) if path.exists() else {}

    def write_timings(self, document: Mapping[str, Any]) -> None:
        write_json(self.path / "timings.json", document)

    def record(self, stage: str) -> StageRecord | None:
        """The record of a stage; None if the stage was never started or its record is damaged."""
        path = self.stage(stage) / RECORD
        if not path.exists():
            return None
        try:
            document = read_json(path)
            record = StageRecord(
                stage,
                str(document["key"]),
                document["finished"] is True,
                dict(document["report"]),
                tuple(document["warnings"]),
                {str(name): str(written) for name, written in document["files"].items()},
            )
            return record if path.read_bytes() == json_text(record.as_document()).encode() else None
        except (InputError, AttributeError, KeyError, TypeError, ValueError):
            return None

    def checksums(self, stage: str, folders: Sequence[str] = ()) -> dict[str, str]:
        """Hash of each file in a stage's folder and in other folders of the run, by its path in the run."""
        files = [path for path in regular_files(self.stage(stage), WORKSPACE) if path.name != RECORD]
        files += [path for name in folders for path in regular_files(self.path / name)]
        return checksums(self.path, files)

    def damage(self, record: StageRecord) -> str | None:
        """Which file of a finished stage is missing, changed or not the stage's own; None where all are as written."""
        for path in regular_files(self.stage(record.stage), WORKSPACE):
            if path.name != RECORD and path.relative_to(self.path).as_posix() not in record.files:
                return f"{path} was not written by it"
        return changed_file(self.path, record.files)

    def begin(self, stage: str, key: str) -> Path:
        """Prepares a stage's folder and returns its workspace; files of an unfinished attempt of the same key stay.

        A finished attempt is removed: it is only computed again where its files are damaged.
        """
        folder = self.stage(stage)
        record = self.record(stage)
        if record is None or record.key != key or record.finished:
            # the record is removed first: a folder without one is never read as a result
            (folder / RECORD).unlink(missing_ok=True)
            shutil.rmtree(folder, ignore_errors=True)
        workspace = folder / WORKSPACE
        workspace.mkdir(parents=True, exist_ok=True)
        self._write_record(StageRecord(stage, key))
        return workspace

    def finish(self, record: StageRecord) -> None:
        """Marks a stage as finished; its result must already be on disk."""
        self._write_record(record)

    def _write_record(self, record: StageRecord) -> None:
        write_json(self.stage(record.stage) / RECORD, record.as_document())


def _check_version(path: Path, document: Mapping[str, Any]) -> None:
    """Raises `InputError` for a run of another version of `hir`."""
    version = document.get("version")
    if version != VERSION or isinstance(version, bool):
        raise InputError(
            f"{path} has format version {version!r}, this program reads {VERSION}; "
            "reconstruct the capture again into a new folder"
        )


def _refuse_other_version(folder: Path) -> None:
    """Raises `InputError` if the folder holds a run of another version; a damaged run.json is written again."""
    try:
        document = read_json(folder / "run.json")
    except InputError:
        return
    if document.get("format") == FORMAT:
        _check_version(folder / "run.json", document)


def check_stage_name(name: str) -> str:
    """The name of a stage; another one is a `ConfigError`."""
    if name not in STAGE_NAMES:
        raise ConfigError(f"there is no stage {name!r}; the stages are: {', '.join(STAGE_NAMES)}")
    return name


def open_run(path: str | os.PathLike[str]) -> RunDirectory:
    """An existing run; `InputError` says what is missing."""
    folder = Path(path)
    if folder.is_dir():
        refuse_links(folder)
    if not folder.is_dir():
        raise InputError(f"{folder} is not a folder; make a run with: hir reconstruct CAPTURE -o RUN")
    if not (folder / "run.json").is_file():
        raise InputError(f"{folder} has no run.json, so it is not a run; make one with: hir reconstruct CAPTURE -o RUN")
    return RunDirectory(folder)


def refuse_links(folder: Path) -> None:
    """Raises `InputError` for a symbolic link, pipe, socket or device in a run's folder.

    Writing through a link would change a file outside; reading a pipe would block. The folder itself may be a link.
    """
    pending = [folder]
    while pending:
        try:
            entries = list(os.scandir(pending.pop()))
        except OSError as error:
            raise InputError(f"{error.filename} cannot be read: {error.strerror}") from error
        for entry in entries:
            if entry.is_symlink():
                raise InputError(f"{entry.path} is a symbolic link, which a run does not contain; remove it")
            if entry.is_dir(follow_symlinks=False):
                pending.append(Path(entry.path))
            elif not entry.is_file(follow_symlinks=False) and os.path.lexists(entry.path):
                raise InputError(f"{entry.path} is not a regular file, which a run does not contain; remove it")


@contextlib.contextmanager
def refuse_damaged_documents(folder: Path) -> Iterator[None]:
    """Turns errors about unexpected content of run files in the block into one `InputError`."""
    try:
        yield
    except HirError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(
            f"{folder}: run.json or a file beside it is damaged ({reason}); run again with --resume"
        ) from error


@contextlib.contextmanager
def claimed_run(path: str | os.PathLike[str], resume: bool) -> Iterator[RunDirectory]:
    """The folder of a run, created if missing and locked against other processes until the block ends.

    Raises `InputError` if the folder holds something else, or a run without `resume`.
    """
    folder = Path(path)
    check_text_path(folder)
    if folder.is_dir():
        refuse_links(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder} is a file; give a folder for the run")
    if folder.is_dir():
        entries = {entry.name for entry in folder.iterdir() if not is_partial(entry)} - {".lock"}
        if "run.json" not in entries and entries - {"stages", "capture"}:
            raise InputError(f"{folder} holds {sorted(entries)[0]!r} and is not a run; choose an empty or new folder")
        if entries and not resume:
            raise InputError(f"{folder} already holds a run; continue it with --resume, or choose another folder")
        _refuse_other_version(folder)
    lock = FileLock(folder / ".lock")  # the operating system releases it when the process ends, however it ends
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire(blocking=False)
    except Timeout:
        raise StageError(f"another process works on {folder}; wait for it to end, or choose another folder") from None
    except OSError as error:
        raise InputError(f"cannot write into {folder}: {error.strerror}; choose another folder") from error
    try:
        remove_partials(folder)  # left by a killed run
        yield RunDirectory(folder)
    finally:
        lock.release()
