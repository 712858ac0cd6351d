"""One capture on its way through the groups: what happens next after each outcome."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from hir_core.files.json_documents import jsonable
from hir_plugins.commands.batch.retries import Patience
from hir_plugins.commands.batch.scheduling.messages import Outcome
from hir_plugins.commands.batch.stage_groups import GROUPS

State = Literal["waiting", "running", "done", "failed"]
Step = Literal["next group", "done", "unchanged", "again", "failed"]


@dataclass(slots=True)
class Chain:
    """A capture of a batch; the driver alone changes it."""

    name: str
    source: str
    state: State = "waiting"
    group: int = 0
    """Index into `GROUPS`: the one that runs or comes next."""
    attempt: int = 0
    """Tasks begun so far."""
    failures: int = 0
    """Times that the infrastructure failed the group that is next."""
    retries: int = 0
    """Times that it failed any group, in earlier calls too."""
    not_before: float = 0.0
    """Clock time before which the next task is not handed out."""
    reason: str = ""
    listing: str = ""
    content: str = ""
    settings: str = ""
    finished: tuple[str, str] = ("", "")
    """Marks of content and settings of the result that an earlier call left, if any."""
    seconds: dict[str, dict[str, float]] = field(default_factory=dict)
    """Of each group: `stage`, `compute`, `store`, and `wall` from handing it out to its outcome."""
    record: dict[str, Any] = field(default_factory=dict)
    """PSNR, warnings and so on of the finished result; its thumbnail stays in the store."""
    lines: list[str] = field(default_factory=list)

    def settle(self, outcome: Outcome, patience: Patience, now: float, chance: float) -> Step:
        """Takes the outcome of the running task; `now` and `chance` in 0…1 decide when a failed one is tried again."""
        self.lines += outcome.lines
        self.content = outcome.content or self.content
        group = GROUPS[self.group].name
        if outcome.state in ("done", "unchanged"):
            if not outcome.reused:
                self.seconds.setdefault(group, {}).update(outcome.seconds)
            self.failures = 0
            if outcome.state == "done" and self.group + 1 < len(GROUPS):
                self.group += 1
                self.state = "waiting"
                return "next group"
            self.state, self.reason = "done", ""
            if outcome.state == "unchanged":
                return "unchanged"
            self.record = jsonable({key: value for key, value in outcome.record.items() if key != "thumbnail"})
            return "done"
        if outcome.state == "trouble" and self.failures + 1 < patience.tries:
            self.failures += 1
            self.retries += 1
            self.state = "waiting"
            self.not_before = now + patience.delay(self.failures, chance)
            return "again"
        tried = f", {patience.tries} times" if outcome.state == "trouble" and patience.tries > 1 else ""
        self.state, self.reason = "failed", f"{group}: {outcome.reason}{tried}"
        return "failed"

    def entry(self) -> dict[str, Any]:
        """What batch.json says of the capture."""
        named = ("source", "state", "reason", "listing", "content", "settings", "seconds", "retries")
        shown = {name: getattr(self, name) for name in named}
        if self.state != "done":
            shown["group"] = GROUPS[self.group].name
        for name in ("psnr", "stage_seconds", "peak_memory_bytes", "photographs", "triangles", "warnings", "bytes"):
            if name in self.record:
                shown[name] = self.record[name]
        return shown

    def take_over(self, entry: Mapping[str, Any]) -> None:
        """Remembers what an earlier call noted of the capture."""
        for name in ("listing", "content", "settings", "reason"):
            noted = entry.get(name)
            setattr(self, name, noted if isinstance(noted, str) else "")
        retries = entry.get("retries")
        self.retries = retries if isinstance(retries, int) else 0
        seconds = entry.get("seconds")
        if isinstance(seconds, dict):
            self.seconds = {str(k): dict(v) for k, v in seconds.items() if isinstance(v, dict)}

    def take_result(self, record: Mapping[str, Any]) -> None:
        """Remembers the finished result that is there, of whatever input and settings."""
        self.record = {key: value for key, value in record.items() if key != "thumbnail"}
        self.finished = (str(record.get("content", "")), str(record.get("settings", "")))
