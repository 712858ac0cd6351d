"""Ray: found or started here; tasks go in, outcomes and progress come out. All that knows Ray is in this file."""

from __future__ import annotations

import os
import socket
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Self

from hir_core.errors import InputError, MissingExtraError, StageError
from hir_core.run.machine import usable_cores
from hir_plugins.commands.batch.retries import one_line
from hir_plugins.commands.batch.scheduling.messages import Job, Outcome, Told
from hir_plugins.commands.batch.stage_groups import GROUPS, Request

TASKS_OF_A_WORKER: Final = 64
"""After so many tasks a worker's process ends and another begins: what native libraries hold on to is given back."""

OBJECT_STORE_BYTES: Final = 100 << 20
"""Nothing large travels through Ray: photographs and results go through the store."""


def run_on_ray(job: Job, mailbox: Any) -> Outcome:
    """The task."""
    import ray

    if not ray.get_gpu_ids():
        # before torch is loaded: a task that asked for no GPU must not take the memory of one
        os.environ["CUDA_VISIBLE_DEVICES"] = ""
    from hir_plugins.commands.batch.scheduling.worker import run_group

    return run_group(job, lambda told: mailbox.post.remote(told))


class Mailbox:
    """What workers say, until the driver asks; an actor that needs no core."""

    def __init__(self) -> None:
        self._waiting: list[Told] = []

    def post(self, told: Told) -> None:
        self._waiting.append(told)

    def take(self) -> list[Told]:
        waiting, self._waiting = self._waiting, []
        return waiting


@dataclass(frozen=True)
class Ended:
    """A task that is over: its outcome, or one sentence on why there is none."""

    ticket: Any
    outcome: Outcome | None
    reason: str = ""


class Cluster:
    """A context manager: connects to a cluster or starts one on this machine, and leaves it as it was."""

    def __init__(self, address: str, say: Callable[[str], None]) -> None:
        self._address, self._say = address, say
        self._mail: Any = None
        self._ray: Any = None
        self.own = False
        """Whether it was started here."""

    def __enter__(self) -> Self:
        if find_spec("ray") is None:
            raise MissingExtraError("hir batch needs ray; install it with: pip install 'hir[batch]'")
        # asks no host of the net for anything; both are read when ray is imported
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        found = self._address != "local" and (self._address != "auto" or running_cluster())
        if not found:
            # the name is Ray's: on Linux, too, all its processes then listen on the loopback interface alone
            os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        import ray

        self._ray = ray
        self._connect() if found else self._start()
        self._tasks = {
            gpu: ray.remote(max_calls=1 if gpu else TASKS_OF_A_WORKER, max_retries=0)(run_on_ray)
            for gpu in (False, True)  # CUDA keeps the device that a process saw first
        }
        mailbox: Any = ray.remote(num_cpus=0, max_restarts=-1)(Mailbox)
        self._mailbox = mailbox.remote()
        return self

    def __exit__(self, *_: object) -> None:
        self._ray.shutdown()

    def _connect(self) -> None:
        try:
            self._ray.init(address=self._address, log_to_driver=False, logging_level="error")
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            first = str(error).strip().partition("\n")[0]
            raise InputError(f"no Ray cluster answers at {self._address!r} ({first}); see docs/scaling.md") from error
        self._say(f"Ray: {describe(self.nodes())} at {self._address}")

    def _start(self) -> None:
        self.own = True
        options = {
            "num_cpus": usable_cores(),
            "include_dashboard": False,
            "log_to_driver": False,
            "logging_level": "error",
            "object_store_memory": OBJECT_STORE_BYTES,
        }
        try:
            self._ray.init(address="local", **options)
        except Exception as error:  # a plain one, when a busy machine needs more than Ray's 30 s to begin
            self._ray.shutdown()
            self._say(f"Ray did not start ({one_line(error)}); trying once more")
            try:
                self._ray.init(address="local", **options)
            except Exception as final:
                raise StageError(f"Ray cannot be started on this machine: {one_line(final)}") from final
        reached = "no Ray cluster was found, so " if self._address == "auto" else ""
        self._say(f"Ray: {reached}one was started on this machine: {describe(self.nodes())}")

    def nodes(self) -> list[Mapping[str, float]]:
        """What each node that is alive has in all."""
        return [node["Resources"] for node in self._ray.nodes() if node["Alive"]]

    def use(self) -> dict[str, tuple[float, float]]:
        """Of CPU and GPU: how much is in use and how much there is."""
        total, free = self._ray.cluster_resources(), self._ray.available_resources()
        return {name: (total[name] - free.get(name, 0.0), total[name]) for name in ("CPU", "GPU") if total.get(name)}

    def submit(self, job: Job, request: Request) -> Any:
        """Hands a task to Ray; the ticket is for `wait` and `cancel`."""
        task = self._tasks[request.gpus > 0].options(
            name=f"{GROUPS[job.group].name} of {job.name}",
            num_cpus=request.cpus,
            num_gpus=request.gpus,
            memory=int(request.memory_gib * 2**30),
        )
        return task.remote(job, self._mailbox)

    def wait(self, tickets: Sequence[Any], seconds: float) -> list[Ended]:
        """The tasks that are over, after at most that long."""
        done, _ = self._ray.wait(list(tickets), num_returns=len(tickets), timeout=0)
        if not done:
            done, _ = self._ray.wait(list(tickets), num_returns=1, timeout=seconds)
        return [self._ended(ticket) for ticket in done]

    def cancel(self, ticket: Any) -> None:
        """Ends a task, whatever it does."""
        self._ray.cancel(ticket, force=True)

    def mail(self) -> list[Told]:
        """What workers said since the last call that got through; never waits."""
        from ray.exceptions import RayError

        told: list[Told] = []
        if self._mail is not None and self._ray.wait([self._mail], timeout=0)[0]:
            try:
                told = self._ray.get(self._mail)
            except RayError:
                told = []  # the node of the mailbox left: Ray starts another one
            self._mail = None
        if self._mail is None:
            self._mail = self._mailbox.take.remote()
        return told

    def _ended(self, ticket: Any) -> Ended:
        from ray import exceptions

        try:
            return Ended(ticket, self._ray.get(ticket))
        except exceptions.RayTaskError as error:
            cause = getattr(error, "cause", None) or error
            text = str(cause).strip().rpartition("\n")[2]
            return Ended(ticket, Outcome("failed", f"the task could not begin: {type(cause).__name__}: {text}"))
        except exceptions.RayError as error:
            return Ended(ticket, None, death(error))


def death(error: Exception) -> str:
    """One sentence on why Ray has no outcome."""
    sentences = {
        "OutOfMemoryError": "the node ran out of memory and Ray ended the worker",
        "NodeDiedError": "the node left the cluster",
        "LocalRayletDiedError": "the node left the cluster",
        "WorkerCrashedError": "the worker's process died",
    }
    for kind in type(error).__mro__:
        if kind.__name__ in sentences:
            return sentences[kind.__name__]
    text = str(error).strip().partition("\n")[0]
    return f"Ray lost the task ({type(error).__name__}: {text})"


def running_cluster() -> bool:
    """Whether `auto` leads somewhere: RAY_ADDRESS is set, or the address that Ray notes on a node answers."""
    if os.environ.get("RAY_ADDRESS"):
        return True
    noted = Path(os.environ.get("RAY_TMPDIR", tempfile.gettempdir())) / "ray" / "ray_current_cluster"
    try:
        host, _, port = noted.read_text(encoding="utf-8").strip().rpartition(":")
        with socket.create_connection((host.strip("[]"), int(port)), timeout=2):
            return True
    except (OSError, ValueError):
        return False


def describe(nodes: Sequence[Mapping[str, float]]) -> str:
    """Such as `3 nodes, 24 CPUs, 4 GPUs`."""
    parts = [f"{len(nodes)} node{'s' if len(nodes) != 1 else ''}"]
    for name in ("CPU", "GPU"):
        amount = sum(node.get(name, 0.0) for node in nodes)
        if amount:
            parts.append(f"{amount:g} {name}s")
    return ", ".join(parts)
