"""batch.json and the lease: always complete, one writer."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hir_core.errors import InputError
from hir_plugins.commands.batch.retries import RetryPolicy
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.scheduling.manifest import Manifest
from hir_plugins.commands.batch.scheduling.messages import TaskOutcome
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.lease import EXPIRY_SECONDS, Lease, LeaseTiming, is_expired, lease_owner
from hir_plugins.commands.batch.storage.storage_path import StoragePath

WRITE_FOREVER = """
import sys
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.scheduling.manifest import Manifest
from hir_plugins.commands.batch.storage.storage_path import StoragePath
manifest = Manifest(StoragePath(sys.argv[1]), {})
jobs = [CaptureJob(f"capture-{i}", "x" * 200) for i in range(500)]
print("ready", flush=True)
while True:
    manifest.write(jobs)
"""
KEEP_LEASE = """
import sys, time
from hir_plugins.commands.batch.storage.lease import Lease
from hir_plugins.commands.batch.storage.storage_path import StoragePath
with Lease(StoragePath(sys.argv[1]), print):
    print("acquired", flush=True)
    time.sleep(600)
"""


def python(code: str, *arguments: object) -> subprocess.Popen[str]:
    """A process that has printed its first line."""
    process = subprocess.Popen([sys.executable, "-c", code, *map(str, arguments)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline()
    return process


def test_manifest_is_complete_at_every_read_and_after_its_writer_is_killed(tmp_path: Path) -> None:
    path = tmp_path / "batch.json"
    with python(WRITE_FOREVER, path) as process:
        changes, last, until = 0, 0, time.monotonic() + 60
        while changes < 40 and time.monotonic() < until:
            if path.exists():
                document = json.loads(path.read_bytes())
                assert len(document["captures"]) == 500
                seen = path.stat().st_mtime_ns
                changes, last = changes + (seen != last), seen
        process.send_signal(signal.SIGKILL)
    assert changes == 40, "the file was replaced between reads"
    assert len(Manifest(StoragePath(str(path)), {}).read()) == 500


def test_manifest_keeps_the_captures_of_earlier_calls(memory: StoragePath) -> None:
    path = memory / "batch.json"
    cup, jug = CaptureJob("cup", "s3://captures/cup"), CaptureJob("jug", "s3://captures/jug")
    cup.apply(TaskOutcome("failed", "no photographs"), RetryPolicy(1, 0.0), 0.0, 0.0)
    assert Manifest(path, {"started": "then"}).write([cup])
    second = Manifest(path, {"started": "now"})
    assert set(second.read()) == {"cup"}
    assert second.write([jug])
    document = json.loads(object_store.read(path) or b"")
    assert set(document["captures"]) == {"cup", "jug"} and document["started"] == "then"
    assert document["captures"]["cup"]["reason"] == "initialization: no photographs"
    assert not second.write([jug], force=False), "it was written just now"


@pytest.mark.parametrize("content", [b"{", b"[]", b'{"format": "other"}', b'{"format": "hir-batch", "version": 9}'])
def test_other_files_are_no_manifest(memory: StoragePath, content: bytes) -> None:
    object_store.write(memory / "batch.json", content)
    with pytest.raises(InputError, match=r"batch\.json"):
        Manifest(memory / "batch.json", {}).read()


@pytest.mark.skipif(os.name != "posix", reason="processes are looked up by signals")
def test_one_batch_at_a_time_until_it_dies(tmp_path: Path) -> None:
    path = StoragePath(str(tmp_path / "lease.json"))
    messages: list[str] = []
    with python(KEEP_LEASE, path.url) as other:
        with (
            pytest.raises(InputError, match=f"another batch is writing to .* \\(process {other.pid} on"),
            Lease(path, messages.append),
        ):
            pass
        other.send_signal(signal.SIGKILL)
    with Lease(path, messages.append) as mine:
        assert lease_owner(path) == mine.token and "continuing a batch that ended" in messages[-1]
    assert not object_store.exists(path), "released"


def test_lease_of_another_machine_holds_until_it_expires(memory: StoragePath) -> None:
    now = time.time()
    fresh = {"owner": "them", "host": "another", "pid": 1, "renewed": now}
    assert (
        not is_expired(fresh, now)
        and is_expired({**fresh, "renewed": now - EXPIRY_SECONDS - 1}, now)
        and is_expired({}, now)
    )
    path = memory / "lease.json"
    messages: list[str] = []

    def renewed_by_its_owner(seconds: float) -> None:
        object_store.write(path, json.dumps({**fresh, "renewed": time.time() + 1}).encode())

    object_store.write(path, json.dumps(fresh).encode())
    timing = LeaseTiming(sleep=renewed_by_its_owner)
    with pytest.raises(InputError, match="on another"), Lease(path, messages.append, timing):
        pass
    assert len(messages) == 1 and "waiting up to 60 s" in messages[0]


def test_batch_notices_that_its_lease_was_acquired_by_another(memory: StoragePath) -> None:
    path = memory / "lease.json"
    with Lease(path, print, LeaseTiming(renewal_seconds=0.02)) as mine:
        assert not mine.lost
        object_store.write(path, b'{"owner": "them"}')
        until = time.monotonic() + 10
        while not mine.lost and time.monotonic() < until:
            time.sleep(0.01)
        assert mine.lost
    assert lease_owner(path) == "them", "another batch's lease is not released"
