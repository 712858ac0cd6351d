"""The Ray cluster: connects to one or starts one, submits tasks, returns outcomes and progress. Only this module
imports Ray."""

from __future__ import annotations

import os
import signal
import socket
import tempfile
import threading
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Final, Self

from hir_core.errors import InputError, MissingExtraError, StageError
from hir_core.run.machine import usable_cores
from hir_plugins.commands.batch.resource_requests import ResourceRequest
from hir_plugins.commands.batch.retries import one_line
from hir_plugins.commands.batch.scheduling.messages import ProgressMessage, TaskOutcome, TaskSpec
from hir_plugins.commands.batch.scheduling.process_cleanup import processes_end_with_this_one
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

TASKS_PER_WORKER: Final = 64
"""After so many tasks a worker process is replaced, which returns memory that native libraries do not release."""

OBJECT_STORE_BYTES: Final = 100 << 20
"""Ray's object store can be small: photographs and results are transferred through the batch's store."""

TaskRef = Hashable
"""Ray's reference to a submitted task."""


def run_on_ray(spec: TaskSpec, progress_queue: Any) -> TaskOutcome:
    """The Ray task; `progress_queue` is the handle of the `ProgressQueue` actor."""
    import ray

    if not ray.get_gpu_ids():
        # before torch is imported: a task without a GPU must not allocate memory on one
        os.environ["CUDA_VISIBLE_DEVICES"] = ""
    from hir_plugins.commands.batch.scheduling.worker import run_task

    return run_task(spec, lambda message: progress_queue.put.remote(message))


class ProgressQueue:
    """A Ray actor that collects progress messages until the driver fetches them."""

    def __init__(self) -> None:
        self._messages: list[ProgressMessage] = []

    def put(self, message: ProgressMessage) -> None:
        self._messages.append(message)

    def take_all(self) -> list[ProgressMessage]:
        messages, self._messages = self._messages, []
        return messages


@dataclass(frozen=True)
class EndedTask:
    """A task that has ended: its outcome, or one sentence on why there is none."""

    ref: TaskRef
    outcome: TaskOutcome | None
    reason: str = ""


class RayCluster:
    """A context manager that connects to a cluster or starts one on this machine, and disconnects or stops it."""

    def __init__(self, address: str, on_message: Callable[[str], None]) -> None:
        self._address, self._on_message = address, on_message
        self._pending_messages: Any = None
        self._ray: Any = None
        self._cleanup = ExitStack()
        self.started_here = False

    def __enter__(self) -> Self:
        if find_spec("ray") is None:
            raise MissingExtraError("hir batch needs ray; install it with: pip install 'hir[batch]'")
        # no usage statistics are sent; both variables are read when ray is imported
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
        connect = self._address != "local" and (self._address != "auto" or running_cluster())
        if not connect:
            # despite its name it applies to Linux too: all processes of Ray listen on the loopback interface only
            os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
        import ray

        self._ray = ray
        with kept_sigterm_handler():
            if connect:
                self._connect()
            else:
                self._cleanup.enter_context(processes_end_with_this_one())
                try:
                    self._start()
                except BaseException:
                    self._cleanup.close()
                    raise
        self._tasks = {
            gpu: ray.remote(max_calls=1 if gpu else TASKS_PER_WORKER, max_retries=0)(run_on_ray)
            for gpu in (False, True)  # CUDA keeps the device that a process used first: a process for each GPU task
        }
        actor: Any = ray.remote(num_cpus=0, max_restarts=-1)(ProgressQueue)
        self._progress_queue = actor.remote()
        return self

    def __exit__(self, *_: object) -> None:
        with self._cleanup:
            self._ray.shutdown()

    def _connect(self) -> None:
        try:
            self._ray.init(address=self._address, log_to_driver=False, logging_level="error")
        except (ConnectionError, RuntimeError, ValueError, OSError) as error:
            first = str(error).strip().partition("\n")[0]
            raise InputError(f"there is no Ray cluster at {self._address!r} ({first}); see docs/scaling.md") from error
        self._on_message(f"Ray: {describe(self.nodes())} at {self._address}")

    def _start(self) -> None:
        self.started_here = True
        options = {
            "num_cpus": usable_cores(),
            "include_dashboard": False,
            "log_to_driver": False,
            "logging_level": "error",
            "object_store_memory": OBJECT_STORE_BYTES,
        }
        try:
            self._ray.init(address="local", **options)
        except Exception as error:  # Ray raises a plain Exception if a busy machine exceeds its 30 s limit
            self._ray.shutdown()
            self._on_message(f"Ray did not start ({one_line(error)}); trying once more")
            try:
                self._ray.init(address="local", **options)
            except Exception as final:
                raise StageError(f"Ray cannot be started on this machine: {one_line(final)}") from final
        reason = "no Ray cluster was found, so " if self._address == "auto" else ""
        self._on_message(f"Ray: {reason}one was started on this machine: {describe(self.nodes())}")

    def nodes(self) -> list[Mapping[str, float]]:
        """The total resources of each node that is alive."""
        return [node["Resources"] for node in self._ray.nodes() if node["Alive"]]

    def usage(self) -> dict[str, tuple[float, float]]:
        """For CPU and GPU: the amount in use and the total."""
        total, free = self._ray.cluster_resources(), self._ray.available_resources()
        return {name: (total[name] - free.get(name, 0.0), total[name]) for name in ("CPU", "GPU") if total.get(name)}

    def submit(self, spec: TaskSpec, request: ResourceRequest) -> TaskRef:
        """Submits a task; the reference is for `wait` and `cancel`."""
        task = self._tasks[request.gpus > 0].options(
            name=f"{STAGE_GROUPS[spec.group].name} of {spec.name}",
            num_cpus=request.cpus,
            num_gpus=request.gpus,
            memory=int(request.memory_gib * 2**30),
        )
        ref: TaskRef = task.remote(spec, self._progress_queue)
        return ref

    def wait(self, refs: Sequence[TaskRef], seconds: float) -> list[EndedTask]:
        """The tasks that have ended; waits at most `seconds` for the first one."""
        ended, _ = self._ray.wait(list(refs), num_returns=len(refs), timeout=0)
        if not ended:
            ended, _ = self._ray.wait(list(refs), num_returns=1, timeout=seconds)
        return [self._ended_task(ref) for ref in ended]

    def cancel(self, ref: TaskRef) -> None:
        """Ends a task by ending its process."""
        self._ray.cancel(ref, force=True)

    def progress_messages(self) -> list[ProgressMessage]:
        """The progress messages that have arrived since the last call; never waits."""
        from ray.exceptions import RayError

        messages: list[ProgressMessage] = []
        if self._pending_messages is not None and self._ray.wait([self._pending_messages], timeout=0)[0]:
            try:
                messages = self._ray.get(self._pending_messages)
            except RayError:
                messages = []  # the actor's node left the cluster: Ray restarts the actor
            self._pending_messages = None
        if self._pending_messages is None:
            self._pending_messages = self._progress_queue.take_all.remote()
        return messages

    def _ended_task(self, ref: TaskRef) -> EndedTask:
        from ray import exceptions

        try:
            return EndedTask(ref, self._ray.get(ref))
        except exceptions.RayTaskError as error:
            cause = getattr(error, "cause", None) or error
            text = str(cause).strip().rpartition("\n")[2]
            reason = f"the task could not start: {type(cause).__name__}: {text}"
            return EndedTask(ref, TaskOutcome("failed", reason))
        except exceptions.RayError as error:
            return EndedTask(ref, None, ray_failure(error))


def ray_failure(error: Exception) -> str:
    """One sentence on why Ray has no outcome of a task."""
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


@contextmanager
def kept_sigterm_handler() -> Iterator[None]:
    """The handler of SIGTERM is the same after the block: Ray sets two of its own, which print a stack of addresses and
    end the process with exit code 1.
    """
    handler = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if handler is not None and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, handler)


def running_cluster() -> bool:
    """Whether `auto` finds a cluster: RAY_ADDRESS is set, or the address that Ray stores on a node answers."""
    if os.environ.get("RAY_ADDRESS"):
        return True
    address_file = Path(os.environ.get("RAY_TMPDIR", tempfile.gettempdir())) / "ray" / "ray_current_cluster"
    try:
        host, _, port = address_file.read_text(encoding="utf-8").strip().rpartition(":")
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
