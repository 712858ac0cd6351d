"""The batch: hands groups to Ray, hears their outcomes, keeps the manifest; the one process that knows all captures."""

from __future__ import annotations

import random
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, Final

from hir_core import __version__
from hir_core.errors import ConfigError, StageError
from hir_plugins.commands.batch.batch_options import Options
from hir_plugins.commands.batch.retries import Patience, StoreError
from hir_plugins.commands.batch.scheduling.capture_chain import Chain, State
from hir_plugins.commands.batch.scheduling.capture_status import Intake, Look, chains_of
from hir_plugins.commands.batch.scheduling.events import Event, Running
from hir_plugins.commands.batch.scheduling.manifest import Manifest, now_text
from hir_plugins.commands.batch.scheduling.messages import Job, Outcome, Told
from hir_plugins.commands.batch.scheduling.ray_cluster import Cluster, Ended
from hir_plugins.commands.batch.scheduling.time_estimate import Estimate
from hir_plugins.commands.batch.stage_groups import GROUPS, unplaceable, window
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import settings_mark
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.lease import Lease
from hir_plugins.commands.batch.storage.object_store import place
from hir_plugins.commands.batch.summary.summary_page import write_page

NODES_SECONDS: Final = 2.0
"""How often the driver asks which nodes there are."""

PAGE_SECONDS: Final = 60.0


class Batch:
    """Captures and their chains; `run` works until all are done or failed."""

    def __init__(
        self,
        captures: Sequence[str],
        destination: str,
        options: Options,
        on_event: Callable[[Event], None] = lambda event: None,
        on_turn: Callable[[Batch], None] = lambda batch: None,
    ) -> None:
        self.destination = Destination(place(destination))
        self.chains = chains_of(captures, self.destination)
        self.options, self._on_event, self._on_turn = options, on_event, on_turn
        if options.config.device == "cuda" and not any(options.requests.of(group).gpus for group in GROUPS):
            raise ConfigError("device cuda: no group asks for a GPU; give a share of one with --gpus")
        self.settings = settings_mark(options.config)
        self.running: dict[Any, Running] = {}
        self.tally = Counter({"waiting": len(self.chains)})
        """Captures in each state."""
        self._begun: dict[str, Running] = {}
        self.estimate = Estimate()
        self.window = 1
        self.use: dict[str, tuple[float, float]] = {}
        self._ready: list[Chain] = []
        self._patience = Patience(options.tries, first_seconds=2.0, factor=4.0)
        self._nodes_due = self._page_due = 0.0
        self._waits_for = ""
        facts = {"settings": self.settings, "preset": options.config.preset, "hir": __version__, "started": now_text()}
        self._manifest = Manifest(self.destination.manifest, facts)

    def run(self) -> list[Chain]:
        """All chains, each done or failed. Ctrl-C ends the tasks and leaves a batch that the same call goes on with."""
        with Lease(self.destination.lease, self.say) as self._lease, Cluster(self.options.address, self.say) as cluster:
            self._cluster = cluster
            entries = self._manifest.read()
            for chain in self.chains:
                chain.take_over(entries.get(chain.name, {}))
            again = self.options.retry_failed
            self._intake = Intake(self.chains, self.settings, self.destination, entries, again)
            self._ask_for_nodes()
            if self._waits_for and cluster.own:
                raise ConfigError(self._waits_for)
            self.event("batch_started", captures=len(self.chains), destination=str(self.destination.root))
            try:
                while self._ready or self.running or not self._intake.empty:
                    self._turn()
            finally:
                self._intake.close()
                self._stop()
        self.event("batch_finished", done=self.tally["done"], failed=self.tally["failed"])
        return self.chains

    def event(self, name: str, capture: str = "", **facts: Any) -> None:
        """Tells whoever listens."""
        self._on_event(Event(name, capture, facts))

    def say(self, sentence: str) -> None:
        """One sentence for the user."""
        self.event("message", message=sentence)

    def _turn(self) -> None:
        if self._lease.lost:
            raise StageError(f"another batch has taken {self.destination.root} over; this one stops")
        for chain, found in self._intake.looked_at(len(self._ready) + len(self.running) < self.window):
            self._looked(chain, found)
        self._hand_out()
        seconds = 0.02 if self._intake.looking else 0.25
        if self.running:
            for ended in self._cluster.wait(list(self.running), seconds):
                self._settle(ended)
        else:
            time.sleep(seconds)
        for told in self._cluster.mail():
            self._hear(told)
        self._ask_for_nodes()
        self._keep_records(last=False)
        self._on_turn(self)

    def _looked(self, chain: Chain, found: Look) -> None:
        if found.verdict == "unreadable":
            chain.reason = found.reason
            self._enter(chain, "failed")
            self._failed(chain)
            return
        if found.record:
            chain.take_result(found.record)
        chain.listing, chain.content = found.listing, found.content
        if found.verdict == "work":
            chain.group, chain.settings, chain.reason = found.group, self.settings, ""
            self._ready.append(chain)
        elif found.verdict == "finished":
            chain.settings, chain.reason = self.settings, ""
            self._enter(chain, "done")
            self.event("capture_skipped", chain.name, reason="finished by an earlier call")
        else:
            self._enter(chain, "failed")
            self.event("capture_skipped", chain.name, reason=f"failed in an earlier call: {chain.reason}")

    def _hand_out(self) -> None:
        """The captures that are furthest go first: results come early, and little is kept for unfinished ones."""
        now = time.monotonic()
        due = sorted((chain for chain in self._ready if chain.not_before <= now), key=lambda chain: -chain.group)
        for chain in due[: max(self.window - len(self.running), 0)]:
            self._ready.remove(chain)
            chain.attempt += 1
            self._enter(chain, "running")
            ticket = self._cluster.submit(self._job(chain), self.options.requests.of(GROUPS[chain.group]))
            self.running[ticket] = self._begun[chain.name] = Running(chain, now)

    def _job(self, chain: Chain) -> Job:
        options = self.options
        request = options.requests.of(GROUPS[chain.group])
        config = options.config
        if config.device == "cuda" and request.gpus == 0:
            config = replace(config, device="auto")  # finds none: tasks without a share of a GPU see no GPU
        return Job(
            name=chain.name,
            source=chain.source,
            destination=self.destination.root.url,
            group=chain.group,
            config=config,
            settings=self.settings,
            owner=self._lease.token,
            version=__version__,
            threads=request.threads,
            attempt=chain.attempt,
            listing=chain.listing,
            content=chain.content,
            finished=chain.finished,
            cache=str(options.cache or ""),
            keep_stages=options.keep_stages,
            tell_seconds=max(0.5, self.window / 1000),  # thousands of workers would drown one listener
        )

    def _settle(self, ended: Ended) -> None:
        task = self.running.pop(ended.ticket)
        chain, group = task.chain, task.chain.group
        outcome = ended.outcome or Outcome("trouble", ended.reason, lines=(f"[driver] {ended.reason}",))
        now = time.monotonic()
        del self._begun[chain.name]
        if task.told is None and outcome.pid:
            self._started(task, outcome.node, outcome.pid)  # it was over before its worker was heard
        before = chain.state
        step = chain.settle(outcome, self._patience, now, random.random())
        self._count(before, chain.state)
        wall = round(now - task.began, 3)
        facts = {"group": GROUPS[group].name, "seconds": wall}
        if outcome.reused:
            self.event("group_reused", chain.name, **facts)
        elif step in ("next group", "done"):
            chain.seconds[GROUPS[group].name]["wall"] = wall
            self.estimate.learn(group, sum(outcome.seconds.values()))
            self.event("group_finished", chain.name, **facts)
        if step == "done":
            self.event(
                "capture_finished",
                chain.name,
                psnr=chain.record.get("psnr"),
                retries=chain.retries,
                warnings=chain.record.get("warnings"),
            )
        elif step == "unchanged":
            self._note_listing(chain)
            self.event("capture_skipped", chain.name, reason="finished by an earlier call; only dates changed")
        elif step == "failed":
            self._failed(chain)
        else:
            self._ready.append(chain)
        if step == "again":
            seconds = round(chain.not_before - now, 1)
            self.event("group_failed", chain.name, **facts, reason=outcome.reason, again_in_seconds=seconds)

    def _note_listing(self, chain: Chain) -> None:
        """The next call need not read the photographs again."""
        try:
            record = self.destination.record(chain.name) | {"listing": chain.listing}
            self.destination.write_record(chain.name, record)
        except StoreError as error:
            self.say(str(error))

    def _failed(self, chain: Chain) -> None:
        lines = [*chain.lines, f"[driver] {chain.reason}"]
        try:
            object_store.write(self.destination.log(chain.name), ("\n".join(lines) + "\n").encode())
        except StoreError as error:
            self.say(str(error))
        self.event("capture_failed", chain.name, reason=chain.reason, log=str(self.destination.log(chain.name)))

    def _hear(self, told: Told) -> None:
        task = self._begun.get(told.name)
        if task is None or task.chain.attempt != told.attempt:
            return  # of a task that is over
        if task.told is None:
            self._started(task, told.node, told.pid)
        task.told = told
        self.event("progress", told.name, stage=told.stage, step=told.step, steps=told.steps)

    def _started(self, task: Running, node: str, pid: int) -> None:
        self.event("group_started", task.chain.name, group=GROUPS[task.chain.group].name, node=node, pid=pid)

    def _enter(self, chain: Chain, state: State) -> None:
        self._count(chain.state, state)
        chain.state = state

    def _count(self, before: str, after: str) -> None:
        self.tally[before] -= 1
        self.tally[after] += 1

    def _ask_for_nodes(self) -> None:
        now = time.monotonic()
        if now < self._nodes_due:
            return
        self._nodes_due = now + NODES_SECONDS
        nodes = self._cluster.nodes()
        self.window = self.options.at_once or window(nodes, self.options.requests)
        self.use = self._cluster.use()
        lacking = unplaceable(nodes, self.options.requests)
        if lacking and not self._waits_for:
            self.say(f"waiting: {lacking}")
        self._waits_for = lacking

    def _stop(self) -> None:
        """Ends what still runs, which only an interrupt or an error leaves, and writes the last manifest and page."""
        for ticket, task in self.running.items():
            self._cluster.cancel(ticket)
            self._enter(task.chain, "waiting")
        self.running.clear()
        self._keep_records(last=True)

    def _keep_records(self, last: bool) -> None:
        try:
            self._manifest.write(self.chains, force=last)
            if last or time.monotonic() > self._page_due:
                write_page(self.destination, self._manifest.captures(self.chains), now_text())
                self._page_due = time.monotonic() + PAGE_SECONDS
        except StoreError as error:
            if last:
                raise
            self.say(f"{error}; trying again")
