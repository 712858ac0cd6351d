"""Where things lie in a batch's destination, and how a result becomes one.

`NAME/` is the run of a capture, `batch.json` and `batch.html` the summary. Below `.batch/`: `lease.json` of the batch
that works here, `records/NAME.json` of each finished capture, `unfinished/` with the stages of others, `logs/`.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hir_exporters.files.atomic import atomic_directory

from hir_core.errors import InputError
from hir_core.files.json_documents import jsonable
from hir_plugins.commands.batch.stage_groups import GROUPS, Group
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.archive import kept_files, pack, unpack
from hir_plugins.commands.batch.storage.object_store import Place

RESERVED = ("batch.json", "batch.html")


@dataclass(frozen=True)
class Destination:
    """The folder of a batch, on any store."""

    root: Place

    @property
    def manifest(self) -> Place:
        return self.root / "batch.json"

    @property
    def page(self) -> Place:
        return self.root / "batch.html"

    @property
    def lease(self) -> Place:
        return self.root / ".batch" / "lease.json"

    def result(self, name: str) -> Place:
        """The run of a capture."""
        return self.root / name

    def log(self, name: str) -> Place:
        return self.root / ".batch" / "logs" / f"{name}.log"

    def unfinished(self, name: str) -> Place:
        """What unfinished chains of a capture left."""
        return self.root / ".batch" / "unfinished" / name

    def record(self, name: str) -> dict[str, Any]:
        """What is known of a finished capture; empty where it is not finished or the record is no JSON object."""
        content = object_store.read(self._record(name))
        try:
            found = json.loads(content or b"{}")
        except (ValueError, RecursionError):
            return {}
        return found if isinstance(found, dict) else {}

    def write_record(self, name: str, record: Mapping[str, Any]) -> None:
        """From here on the capture counts as finished: its result must be in place."""
        object_store.write(self._record(name), json_bytes(record))

    def stored_groups(self, name: str, mark: str) -> list[Group]:
        """Groups of unfinished work, input and settings as in `mark`, whose stages can be fetched."""
        there = object_store.files(self.unfinished(name) / mark)
        return [group for group in GROUPS if f"{group.name}.tar" in there]

    def store_group(self, name: str, mark: str, group: Group, run: Path) -> int:
        """Keeps what a group made, for whichever node goes on; returns its bytes."""
        content = pack(run, group)
        object_store.write(self.unfinished(name) / mark / f"{group.name}.tar", content)
        return len(content)

    def fetch_group(self, name: str, mark: str, group: Group, run: Path) -> None:
        """Adds what a group made to a local run folder."""
        content = object_store.read(self.unfinished(name) / mark / f"{group.name}.tar")
        if content is None:
            raise InputError(f"the stored stages of {group.name} are gone; they are made again")
        unpack(content, run)

    def publish(self, name: str, run: Path, keep_stages: bool = True) -> int:
        """Puts a finished run in place of an older one and returns its bytes.

        On a local filesystem by renaming the whole folder. On a store, which renames nothing, run.json goes first and
        comes last: without it a folder is not a run, for `hir` and for the batch.
        """
        files = {file.relative_to(run).as_posix(): file for file in kept_files(run)}
        if not keep_stages:
            files = {relative: file for relative, file in files.items() if not relative.startswith("stages/")}
        result = self.result(name)
        self.check_free(name)
        if result.local is not None:
            with atomic_directory(result.local) as place:
                for relative, file in files.items():
                    (place / relative).parent.mkdir(parents=True, exist_ok=True)
                    shutil.copyfile(file, place / relative)
        else:
            object_store.remove(result / "run.json")
            object_store.upload({relative: file for relative, file in files.items() if relative != "run.json"}, result)
            for old in object_store.files(result):
                if old not in files:
                    object_store.remove(result / old)
            object_store.write(result / "run.json", files["run.json"].read_bytes())
        return sum(file.stat().st_size for file in files.values())

    def check_free(self, name: str) -> None:
        """Refuses a place that holds something else than a run or what a batch left of one."""
        result = self.result(name)
        if (
            object_store.exists(result / "run.json")
            or object_store.exists(self._record(name))
            or not object_store.exists(result)
        ):
            return
        if result.local is None or (result.local.is_dir() and not any(result.local.iterdir())):
            return  # an upload that was interrupted; an empty folder
        raise InputError(f"{result} is there and is not a run; choose another destination")

    def _record(self, name: str) -> Place:
        return self.root / ".batch" / "records" / f"{name}.json"


def json_bytes(document: Mapping[str, Any]) -> bytes:
    """The same bytes for the same document."""
    text = json.dumps(jsonable(document), indent=1, sort_keys=True, allow_nan=False, ensure_ascii=False)
    return text.encode() + b"\n"
