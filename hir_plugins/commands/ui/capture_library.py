"""The folder of `hir ui`: its captures, and the uploads that become captures."""

from __future__ import annotations

import os
import secrets
import shutil
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from filelock import FileLock, Timeout

from hir_core.errors import InputError
from hir_core.files.file_names import check_text_path
from hir_plugins.commands.ui.capture_entry import UPLOADED, CaptureEntry, new_entry, stored_entries
from hir_plugins.commands.ui.upload import Upload, capture_name, parse_manifest

MAX_UPLOADS: Final = 4
MAX_CHECKS: Final = 2
ABANDONED_SECONDS: Final = 60.0
"""An upload that received nothing for so long makes room for another."""
UPLOAD_PREFIX: Final = ".upload-"
REMOVED_PREFIX: Final = ".removed-"
END_SECONDS: Final = 5.0


class CaptureLibrary:
    """Nothing is written outside of `folder`; one process at a time uses it."""

    def __init__(self, folder: Path) -> None:
        check_text_path(folder)
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder} is a file; give a folder for captures and runs")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = FileLock(folder / ".lock")
            self._lock.acquire(blocking=False)
        except Timeout:
            raise InputError(f"another hir ui uses {folder}; close it, or choose another folder") from None
        except OSError as error:
            raise InputError(f"{folder} cannot be written: {error.strerror}; choose another folder") from error
        self.folder = folder.resolve()
        self._changes = threading.Lock()
        self._starting = threading.Lock()
        self._uploads: dict[str, Upload] = {}
        for prefix in (UPLOAD_PREFIX, REMOVED_PREFIX):
            for left in self.folder.glob(f"{prefix}*"):
                if not left.is_symlink():
                    shutil.rmtree(left, ignore_errors=True)
        try:
            self._entries = stored_entries(self.folder)
        except BaseException:
            self._lock.release()
            raise

    def close(self) -> None:
        """Stops what runs, removes unfinished uploads, and lets others use the folder."""
        for entry in self.entries:
            entry.stop()
        for entry in self.entries:
            for process in (entry.check, entry.run):
                if process is not None:
                    process.end(END_SECONDS)
        for upload in self._uploads.values():
            upload.discard()
        self._lock.release()

    @property
    def entries(self) -> list[CaptureEntry]:
        with self._changes:
            return list(self._entries.values())

    def entry(self, name: str) -> CaptureEntry | None:
        with self._changes:
            return self._entries.get(name)

    def upload(self, name: str) -> Upload | None:
        with self._changes:
            return self._uploads.get(name)

    def add_path(self, text: str) -> CaptureEntry:
        """The entry of a folder or video on this machine, which is read where it is; its check is started if it can."""
        check_text_path(text)
        try:
            path = Path(text.strip()).expanduser()
            exists = path.exists()
        except (OSError, RuntimeError, ValueError):
            path, exists = Path(), False
        if not text.strip() or not path.is_absolute():
            raise InputError("give the whole path of a folder, such as /home/me/photographs")
        if not exists:
            raise InputError(f"{path} does not exist on this machine")
        path = path.resolve()
        if path == self.folder or path in self.folder.parents:
            raise InputError(f"{path} holds the captures of this page; give the folder of one capture")
        with self._changes:
            same = [e for e in self._entries.values() if e.source == path]
            entry = same[0] if same else self._added(path.stem if path.is_file() else path.name, path)
        if not entry.is_busy:
            self._check_if_possible(entry)
        return entry

    def begin_upload(self, document: Mapping[str, Any]) -> str:
        """The name of a new upload of these files; `InputError` where they may not be uploaded."""
        manifest = parse_manifest(document)
        with self._changes:
            for name, upload in list(self._uploads.items()):
                if upload.idle_seconds > ABANDONED_SECONDS:
                    self._uploads.pop(name).discard()
            if len(self._uploads) >= MAX_UPLOADS:
                raise InputError(f"{MAX_UPLOADS} folders are being copied; wait until one of them is complete")
            name = secrets.token_hex(8)
            self._uploads[name] = Upload(manifest, self.folder / f"{UPLOAD_PREFIX}{name}")
        return name

    def finish_upload(self, name: str) -> CaptureEntry:
        """The capture that the upload has become; its check is started if it can."""
        with self._changes:
            upload = self._uploads.get(name)
            if upload is None:
                raise InputError("this upload has ended; choose the folder again")
            folder = self._new_folder(upload.manifest.name)
            try:
                (folder / UPLOADED).mkdir()
                upload.finish(folder / UPLOADED / upload.manifest.name)
            except BaseException:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            del self._uploads[name]
            entry = self._entries[folder.name] = new_entry(folder, upload.manifest.name, None)
        self._check_if_possible(entry)
        return entry

    def cancel_upload(self, name: str) -> None:
        """Removes what arrived."""
        with self._changes:
            upload = self._uploads.pop(name, None)
        if upload is not None:
            upload.discard()

    def start_check(self, entry: CaptureEntry) -> None:
        """Starts the check; `InputError` where too many run."""
        with self._starting:
            running = self._others(entry, "checking")
            if len(running) >= MAX_CHECKS:
                raise InputError(f"{running[0].name} is being checked; check {entry.name} when it is done")
            entry.start_check()

    def _check_if_possible(self, entry: CaptureEntry) -> None:
        """Starts the check of a capture that was added; where too many run, the page has a button for it."""
        with self._starting:
            if len(self._others(entry, "checking")) < MAX_CHECKS:
                entry.start_check()

    def remove(self, entry: CaptureEntry) -> None:
        """Deletes the folder of a capture: dropped photographs, check and run. A folder elsewhere is not touched."""
        with self._changes, entry.changes:
            if entry.is_busy:
                raise InputError(f"{entry.name} is being computed; stop it first")
            # in one step: what cannot be deleted is no capture any more, and is deleted at the next start
            removed = self.folder / f"{REMOVED_PREFIX}{secrets.token_hex(8)}"
            os.replace(entry.folder, removed)
            self._entries.pop(entry.id, None)
        shutil.rmtree(removed, ignore_errors=True)

    def start_run(self, entry: CaptureEntry, preset: str, assignments: list[str], scan: str | None = None) -> None:
        """Starts or resumes the reconstruction; one at a time, because each uses all cores."""
        with self._starting:
            running = self._others(entry, "running")
            if running:
                raise InputError(f"{running[0].name} is being reconstructed; stop it, or wait until it is finished")
            entry.start_run(preset, assignments, scan)

    def _others(self, entry: CaptureEntry, state: str) -> list[CaptureEntry]:
        return [e for e in self.entries if e is not entry and e.state == state]

    def _added(self, name: str, source: Path) -> CaptureEntry:
        folder = self._new_folder(capture_name(name))
        entry = self._entries[folder.name] = new_entry(folder, capture_name(name), source)
        return entry

    def _new_folder(self, name: str) -> Path:
        """A folder that did not exist: NAME, NAME-2, …"""
        number = 1
        while True:
            folder = self.folder / (name if number == 1 else f"{name}-{number}")
            try:
                folder.mkdir()
                return folder
            except FileExistsError:
                number += 1
