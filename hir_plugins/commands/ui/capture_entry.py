"""One capture of `hir ui`: its folder, the commands that run on it, and what the page displays of it."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from hir_core.errors import HirError, InputError
from hir_core.files.contained_files import regular_file_within
from hir_core.files.file_checksums import regular_files
from hir_core.files.json_documents import read_json, write_json
from hir_core.run.run_directory import LAST_STAGE, STAGE_NAMES, RunDirectory, refuse_links
from hir_core.terminal.run_results import decisions
from hir_plugins.commands.ui.hir_process import HirProcess
from hir_plugins.commands.ui.scan_files import scan_file, scans_in
from hir_plugins.commands.ui.upload import capture_name

RECORD: Final = "capture.json"
UPLOADED: Final = "photographs"
"""Holds the folder that was dropped, under its own name: an asset is called as the folder of its photographs."""
LOG_BYTES: Final = 32 << 10
LOG_LINES: Final = 40
OBSERVERS: Final = ("observers.progress_file={}", "observers.previews={}")
"""Settings by which the page sees how far a run is."""


@dataclass
class CaptureEntry:
    """The folder `folder` holds capture.json, uploaded photographs, the check and the run."""

    folder: Path
    name: str
    source: Path
    """The capture: `folder/photographs/NAME`, or a folder elsewhere that is only read."""
    preset: str = ""
    """As last chosen; empty before the first run."""
    settings: tuple[str, ...] = ()
    """Settings besides the preset, as last chosen."""
    scan: str = ""
    """The scan whose mesh is kept, as last named; empty before."""
    scans: tuple[str, ...] = ()
    """Meshes among the photographs when they were checked last."""
    check: HirProcess | None = None
    run: HirProcess | None = None
    changes: threading.Lock = field(default_factory=threading.Lock)

    @property
    def id(self) -> str:
        return self.folder.name

    @property
    def sheet(self) -> Path:
        return self.folder / "check" / "sheet.png"

    @property
    def check_document(self) -> Path:
        """What `hir check --json` prints."""
        return self.folder / "check" / "check.json"

    @property
    def run_directory(self) -> RunDirectory:
        return RunDirectory(self.folder / "run")

    @property
    def is_own(self) -> bool:
        """Whether the photographs are copies that were dropped."""
        return self.source.is_relative_to(self.folder)

    @property
    def is_busy(self) -> bool:
        return any(process is not None and process.is_running for process in (self.check, self.run))

    @property
    def state(self) -> str:
        """`checking`, `running`, `failed`, `check_failed`, `finished`, `stopped`, `checked` or `new`."""
        if self.run is not None:
            if self.run.is_running:
                return "running"
            if self.run.has_failed:
                return "failed"
            if self.run.was_stopped:
                return "stopped"
        if self.check is not None and self.check.is_running:
            return "checking"
        if (self.run_directory.path / "run.json").is_file():
            return "finished" if self._has_result() else "stopped"
        if self.check is not None and self.check.has_failed:
            return "check_failed"
        if self.check is None or not self.check.was_stopped:
            return "checked" if self.sheet.is_file() and self.check_document.is_file() else "new"
        return "new"

    def write_record(self) -> None:
        """Writes capture.json: what another session needs."""
        record = {
            "name": self.name,
            "source": None if self.is_own else str(self.source),
            "preset": self.preset,
            "settings": list(self.settings),
            "scan": self.scan,
        }
        write_json(self.folder / RECORD, record)

    def start_check(self) -> None:
        """Starts `hir check`; an earlier result is removed."""
        with self.changes:
            self._refuse_if_busy()
            shutil.rmtree(self.sheet.parent, ignore_errors=True)
            self.sheet.parent.mkdir()
            self.run = None
            self.scans = scans_in(self.source)
            arguments = ["check", str(self.source), "--json", "--sheet", str(self.sheet)]
            self.check = HirProcess(arguments, self.check_document)

    def start_run(self, preset: str, assignments: Sequence[str], scan: str | None = None) -> None:
        """Starts `hir reconstruct`, or `hir delight` with the mesh of `scan`; of an earlier run they reuse the stages
        whose settings are unchanged.
        """
        with self.changes:
            self._refuse_if_busy()
            kept = None if scan is None else scan_file(scan, self.source)
            if self.check is not None and self.check.has_failed:
                self.check = None  # the run says itself what cannot be read
            self.preset, self.settings, self.scan = preset, tuple(assignments), scan or self.scan
            self.write_record()
            run = self.run_directory.path
            if kept is None:
                arguments = ["reconstruct", str(self.source), "-o", str(run), "-q", f"--preset={preset}"]
            else:
                arguments = ["delight", str(kept), str(self.source), "-o", str(run), "-q"]
            arguments += [f"--set={text}" for text in (*OBSERVERS, *assignments)]
            if (run / "run.json").is_file():
                arguments.append("--resume")
                (run / "progress.json").unlink(missing_ok=True)
            else:
                shutil.rmtree(run, ignore_errors=True)  # it failed before its first stage
            self.run = HirProcess(arguments, self.folder / "reconstruct.txt")

    def stop(self) -> None:
        """Stops what runs."""
        for process in (self.check, self.run):
            if process is not None:
                process.stop()

    def summary(self) -> dict[str, Any]:
        """What the list of captures displays."""
        return {"id": self.id, "name": self.name, "state": self.state}

    def document(self) -> dict[str, Any]:
        """All that the page displays, but for the check's own document and the pictures."""
        state = self.state
        document = {
            **self.summary(),
            "state": state,
            "source": str(self.source),
            "preset": self.preset,
            "settings": self.settings,
            "scan": self.scan,
            "scans": self.scans,
            "is_own": self.is_own,
            "sentence": self._sentence(state),
        }
        document["checked"] = self.sheet.is_file() and not (self.check is not None and self.check.is_running)
        # beside `sentence`: a capture with a run keeps the state of its run when its check fails
        failed_check = self.check if self.check is not None and self.check.has_failed else None
        document["check_sentence"] = "" if failed_check is None else failed_check.sentence
        if (self.run_directory.path / "run.json").is_file() or state in ("running", "failed"):
            document["run"] = self._run_document(state)
        return document

    def exported_files(self) -> dict[str, Path]:
        """The files of the last finished run by their path below its folder of exports.

        They stay available after a later run that failed or was stopped before it replaced them.
        """
        folder = self.run_directory.exports
        if self.state == "running" or not folder.is_dir() or not self._has_result():
            return {}
        return {path.relative_to(folder).as_posix(): path for path in sorted(regular_files(folder))}

    def preview(self, stage: str) -> Path:
        """The preview picture of a stage; `InputError` where there is none."""
        if stage not in STAGE_NAMES:
            raise InputError(f"there is no stage {stage[:40]!r}")
        run = self.run_directory.path
        return regular_file_within(run, run / "previews" / f"{stage}.png")

    def _refuse_if_busy(self) -> None:
        if self.is_busy:
            raise InputError(f"{self.name} is being computed; stop it first")

    def _sentence(self, state: str) -> str:
        """Why it failed; empty in other states."""
        process = {"failed": self.run, "check_failed": self.check}.get(state)
        return "" if process is None else process.sentence

    def _has_result(self) -> bool:
        directory = self.run_directory
        if not (directory.path / "report.html").is_file():
            return False
        try:
            return LAST_STAGE in directory.read_run().get("stages", {})
        except HirError:
            return False

    def _run_document(self, state: str) -> dict[str, Any]:
        directory = self.run_directory
        run, timings = _document(directory.path / "run.json"), _document(directory.path / "timings.json")
        finished = run.get("stages", {}) if isinstance(run.get("stages"), dict) else {}
        seconds = timings.get("stages", {}) if isinstance(timings.get("stages"), dict) else {}
        progress = _document(directory.path / "progress.json") if state == "running" else {}
        has_result = state != "running" and self._has_result()
        previews = [s for s in STAGE_NAMES if (directory.path / "previews" / f"{s}.png").is_file()]
        return {
            "stages": [
                {
                    "name": stage,
                    "finished": stage in finished,
                    "seconds": seconds.get(stage, {}).get("seconds") if stage in finished else None,
                }
                for stage in STAGE_NAMES
            ],
            "progress": progress or None,
            "previews": [{"stage": stage, "version": _version(directory, stage)} for stage in previews],
            "messages": _last_lines(directory.log),
            "has_result": has_result,
            "decisions": _decisions(run) if has_result else {},
            "files": [{"path": name, "bytes": path.stat().st_size} for name, path in self.exported_files().items()],
        }


def new_entry(folder: Path, name: str, source: Path | None) -> CaptureEntry:
    """Writes capture.json into an existing folder; without `source` the capture is what was uploaded into it."""
    entry = CaptureEntry(folder, name, source or folder / UPLOADED / name)
    entry.write_record()
    return entry


def stored_entries(library: Path) -> dict[str, CaptureEntry]:
    """The entries of an earlier session in the folder of `hir ui`, by id."""
    found = (stored_entry(path) for path in sorted(library.iterdir()) if path.is_dir())
    return {entry.id: entry for entry in found if entry is not None}


def stored_entry(folder: Path) -> CaptureEntry | None:
    """The entry of an earlier session; None where the folder is something else.

    A symbolic link, pipe or device in it is an `InputError`: runs and checks write to files of known names.
    """
    if folder.is_symlink() or not (folder / RECORD).is_file():
        return None
    refuse_links(folder)
    record = _document(folder / RECORD)
    name, source = record.get("name"), record.get("source")
    preset, settings, scan = record.get("preset"), record.get("settings"), record.get("scan", "")
    if not isinstance(name, str) or name != capture_name(name) or not (source is None or isinstance(source, str)):
        return None
    if not isinstance(preset, str) or not isinstance(settings, list) or not isinstance(scan, str):
        return None
    path = folder / UPLOADED / name if source is None else Path(source)
    try:
        scans = scans_in(path)
    except (OSError, ValueError):  # a null character, half a character
        return None
    # plugins execute code: a file does not name them, whoever wants them types them again
    lines = tuple(str(line) for line in settings if not names_plugins(str(line)))
    return CaptureEntry(folder, name, path, preset, lines, scan, scans)


def names_plugins(assignment: str) -> bool:
    """Whether `KEY=VALUE` sets the plugins of a run."""
    return assignment.partition("=")[0].partition(".")[0].strip() == "plugins"


def _document(path: Path) -> dict[str, Any]:
    """A JSON document that a process may be writing for the first time; empty while it is absent or damaged."""
    try:
        return read_json(path)
    except HirError:
        return {}


def _decisions(run: Mapping[str, Any]) -> dict[str, str]:
    try:
        return decisions(run)
    except (AttributeError, KeyError, TypeError):
        return {}


def _version(directory: RunDirectory, stage: str) -> int:
    """Changes with the picture, so that a browser loads it again."""
    try:
        return (directory.path / "previews" / f"{stage}.png").stat().st_mtime_ns // 1_000_000
    except OSError:
        return 0


def _last_lines(path: Path) -> list[str]:
    """The end of a log."""
    try:
        with open(path, "rb") as stream:
            stream.seek(max(0, path.stat().st_size - LOG_BYTES))
            text = stream.read(LOG_BYTES).decode("utf-8", "replace")
    except OSError:
        return []
    return text.splitlines()[-LOG_LINES:]
