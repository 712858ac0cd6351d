"""The files of a batch's destination, and how a result is published there.

`NAME/` is the run directory of a capture; `batch.json` and `batch.html` are the summary. Below `.batch/`: `lease.json`
of the batch that is running, `records/NAME.json` of each finished capture, `unfinished/` with the stages of
unfinished captures, `logs/`.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hir_exporters.files.atomic import atomic_directory

from hir_core.errors import InputError
from hir_core.files.json_documents import jsonable
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS, StageGroup
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.archive import pack, result_files, unpack
from hir_plugins.commands.batch.storage.storage_path import StoragePath

RESERVED_NAMES: Final = ("batch.json", "batch.html")


@dataclass(frozen=True)
class Destination:
    """The destination folder of a batch, on any store."""

    root: StoragePath

    @property
    def manifest(self) -> StoragePath:
        return self.root / "batch.json"

    @property
    def page(self) -> StoragePath:
        return self.root / "batch.html"

    @property
    def lease(self) -> StoragePath:
        return self.root / ".batch" / "lease.json"

    def result(self, name: str) -> StoragePath:
        """The run directory of a capture."""
        return self.root / name

    def log(self, name: str) -> StoragePath:
        return self.root / ".batch" / "logs" / f"{name}.log"

    def unfinished(self, name: str) -> StoragePath:
        """The stages of a capture whose last task has not finished."""
        return self.root / ".batch" / "unfinished" / name

    def record(self, name: str) -> dict[str, Any]:
        """The record of a finished capture; empty if there is none or if it is not a JSON object."""
        content = object_store.read(self._record(name))
        try:
            record = json.loads(content or b"{}")
        except (ValueError, RecursionError):
            return {}
        return record if isinstance(record, dict) else {}

    def write_record(self, name: str, record: Mapping[str, object]) -> None:
        """Marks a capture as finished; its result must have been published before."""
        object_store.write(self._record(name), json_bytes(record))

    def stored_groups(self, name: str, key: str) -> list[StageGroup]:
        """The groups of an unfinished capture whose stages are stored for this `result_key`."""
        stored = object_store.list_files(self.unfinished(name) / key)
        return [group for group in STAGE_GROUPS if f"{group.name}.tar" in stored]

    def store_group(self, name: str, key: str, group: StageGroup, run: Path) -> int:
        """Stores the stages of a group for the node that runs the next task; returns the number of bytes."""
        content = pack(run, group)
        object_store.write(self.unfinished(name) / key / f"{group.name}.tar", content)
        return len(content)

    def fetch_group(self, name: str, key: str, group: StageGroup, run: Path) -> None:
        """Adds the stored stages of a group to a local run directory."""
        content = object_store.read(self.unfinished(name) / key / f"{group.name}.tar")
        if content is None:
            raise InputError(f"the stored stages of {group.name} no longer exist; they are computed again")
        unpack(content, run)

    def publish(self, name: str, run: Path, keep_stages: bool = True) -> int:
        """Replaces the result of a capture by a finished run; returns the number of bytes.

        On a local file system the folder is renamed into position. An object store cannot rename: there `run.json` is
        removed first and written last, because neither `hir` nor the batch treats a folder without it as a run.
        """
        files = {file.relative_to(run).as_posix(): file for file in result_files(run)}
        if not keep_stages:
            files = {relative: file for relative, file in files.items() if not relative.startswith("stages/")}
        result = self.result(name)
        self.check_replaceable(name)
        if result.local is not None:
            with atomic_directory(result.local) as folder:
                for relative, file in files.items():
                    (folder / relative).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(file, folder / relative)
        else:
            object_store.remove(result / "run.json")
            object_store.upload({relative: file for relative, file in files.items() if relative != "run.json"}, result)
            for old in object_store.list_files(result):
                if old not in files:
                    object_store.remove(result / old)
            object_store.write(result / "run.json", files["run.json"].read_bytes())
        return sum(file.stat().st_size for file in files.values())

    def check_replaceable(self, name: str) -> None:
        """Raises `InputError` if the result's path contains something other than a run or an interrupted upload."""
        result = self.result(name)
        if (
            object_store.exists(result / "run.json")
            or object_store.exists(self._record(name))
            or not object_store.exists(result)
        ):
            return
        if result.local is None or (result.local.is_dir() and not any(result.local.iterdir())):
            return  # an interrupted upload; an empty folder
        raise InputError(f"{result} exists and is not a run; choose another destination")

    def _record(self, name: str) -> StoragePath:
        return self.root / ".batch" / "records" / f"{name}.json"


def json_bytes(document: Mapping[str, object]) -> bytes:
    """The document as JSON; the same bytes for the same document."""
    text = json.dumps(jsonable(document), indent=1, sort_keys=True, allow_nan=False, ensure_ascii=False)
    return text.encode() + b"\n"
