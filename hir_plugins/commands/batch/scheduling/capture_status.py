"""Before a capture is worked on: is it there, is it finished, what was begun?"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from hir_core.errors import HirError, InputError
from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.stage_groups import GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import listing_mark, work_mark
from hir_plugins.commands.batch.storage.layout import RESERVED, Destination
from hir_plugins.commands.batch.storage.object_store import Place, place

AT_ONCE: Final = 32
"""Captures that are looked at together."""


@dataclass(frozen=True)
class Look:
    """What was found."""

    verdict: Literal["work", "finished", "failed before", "unreadable"]
    listing: str = ""
    content: str = ""
    """Mark of the capture's bytes, where an unchanged listing says that it still holds."""
    group: int = 0
    """The first group whose stages no earlier call left."""
    record: Mapping[str, Any] = field(default_factory=dict)
    """Of the result that is there, of whatever input and settings."""
    reason: str = ""
    """Why it is unreadable."""


def look(chain: Chain, settings: str, destination: Destination, entry: Mapping[str, Any], again: bool) -> Look:
    """Compares the capture's listing with what was noted when it was finished, begun or given up.

    No photograph is read: an unchanged listing (names, sizes, the store's checksums or times) stands for the content;
    where it changed, the first task compares the bytes. `again`: failed ones are worked on once more.
    """
    listed = object_store.files(Place(chain.source))
    if not listed:
        return Look("unreadable", reason=f"{chain.source} does not exist or is empty; give the folder of a capture")
    listing = listing_mark(listed)
    record = destination.record(chain.name)
    if record and not object_store.exists(destination.result(chain.name) / "run.json"):
        record = {}
    if record and (record.get("settings"), record.get("listing")) == (settings, listing):
        return Look("finished", listing, str(record.get("content", "")), record=record)
    same = entry.get("listing") == listing
    if entry.get("state") == "failed" and same and entry.get("settings") == settings and not again:
        return Look("failed before", listing, str(entry.get("content", "")), record=record)
    known = entry if same else record if record.get("listing") == listing else {}
    content = str(known.get("content", ""))
    group = 0
    if content:
        stored = {found.name for found in destination.stored_groups(chain.name, work_mark(content, settings))}
        group = next(i for i, wanted in enumerate(GROUPS) if wanted.name not in stored)
    return Look("work", listing, content, group, record)


class Intake:
    """Captures that nobody has looked at yet; looks are taken in threads, since stores answer slowly."""

    def __init__(
        self,
        chains: Iterable[Chain],
        settings: str,
        destination: Destination,
        entries: Mapping[str, Mapping[str, Any]],
        again: bool,
    ) -> None:
        self._pending = deque(chains)
        self._settings, self._destination, self._entries, self._again = settings, destination, entries, again
        self._pool = ThreadPoolExecutor(AT_ONCE, thread_name_prefix="hir-batch-look")
        self._looking: dict[Future[Look], Chain] = {}

    @property
    def looking(self) -> bool:
        return bool(self._looking)

    @property
    def empty(self) -> bool:
        """Whether all captures were looked at."""
        return not self._pending and not self._looking

    def looked_at(self, room: bool) -> Iterator[tuple[Chain, Look]]:
        """Captures whose look is over; more are looked at while there is room for work."""
        while room and self._pending and len(self._looking) < AT_ONCE:
            chain = self._pending.popleft()
            future = self._pool.submit(self._look, chain)
            self._looking[future] = chain
        for future in [future for future in self._looking if future.done()]:
            yield self._looking.pop(future), future.result()

    def close(self) -> None:
        """Takes no further look."""
        self._pool.shutdown(wait=False, cancel_futures=True)

    def _look(self, chain: Chain) -> Look:
        try:
            return look(chain, self._settings, self._destination, self._entries.get(chain.name, {}), self._again)
        except HirError as error:
            return Look("unreadable", reason=str(error))


def chains_of(captures: Iterable[str], destination: Destination) -> list[Chain]:
    """One chain for each capture, named by the last part of its address; names must differ."""
    found: dict[str, Chain] = {}
    for text in captures:
        source = place(text)
        name = source.name
        if not name or name.startswith(".") or name in RESERVED:
            raise InputError(f"{source} cannot be a capture's address: results go by its last part, which is {name!r}")
        other = found.get(name)
        if other is not None and other.source != source.url:
            raise InputError(
                f"two captures are called {name!r}: {other.source} and {source}; "
                "rename one, or give them to two batches with two destinations"
            )
        if source.url == destination.result(name).url:
            raise InputError(f"the result of {source} would replace the capture itself; choose another destination")
        found[name] = Chain(name, source.url)
    if not found:
        raise InputError("there is no capture to work on")
    return list(found.values())


def expand(words: Iterable[str]) -> list[str]:
    """Captures as they were typed; a pattern such as `s3://shelf/*` becomes what it matches."""
    found: list[str] = []
    for word in words:
        if not any(sign in word for sign in "*?["):
            found.append(word)
            continue
        matched = _matches(word)
        if not matched:
            raise InputError(f"{word} matches nothing")
        found += matched
    return found


def _matches(pattern: str) -> list[str]:
    if Place(pattern).local is not None and Place(pattern).local.exists():  # type: ignore[union-attr]
        return [pattern]
    at = place(pattern)
    filesystem, path = at.opened()
    from hir_plugins.commands.batch.retries import ask

    matched = ask(lambda: filesystem.glob(path), f"{pattern} cannot be listed")
    before = "" if at.local is not None else at.url.removesuffix(path.lstrip("/"))
    return [f"{before}{match.lstrip('/') if before else match}" for match in sorted(matched)]


def read_list(text: str) -> list[str]:
    """The captures that a file names, one a line; empty lines and those that begin with # are passed over."""
    at = place(text)
    content = object_store.read(at)
    if content is None:
        raise InputError(f"{at} does not exist; give a file with one capture a line")
    lines = [line.strip() for line in content.decode("utf-8", errors="replace").splitlines()]
    return [line for line in lines if line and not line.startswith("#")]
