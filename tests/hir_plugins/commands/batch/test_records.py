"""batch.json, the lease and the log of results: never half-written, one writer."""

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
from hir_plugins.commands.batch.retries import Patience
from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.scheduling.manifest import Manifest
from hir_plugins.commands.batch.scheduling.messages import Outcome
from hir_plugins.commands.batch.storage import lease as lease_module
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.lease import STALE_SECONDS, Lease, died, owner_of
from hir_plugins.commands.batch.storage.object_store import Place

WRITE_FOREVER = """
import sys
from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.scheduling.manifest import Manifest
from hir_plugins.commands.batch.storage.object_store import Place
manifest = Manifest(Place(sys.argv[1]), {})
chains = [Chain(f"capture-{i}", "x" * 200) for i in range(500)]
print("ready", flush=True)
while True:
    manifest.write(chains)
"""
HOLD = """
import sys, time
from hir_plugins.commands.batch.storage.lease import Lease
from hir_plugins.commands.batch.storage.object_store import Place
with Lease(Place(sys.argv[1]), print):
    print("held", flush=True)
    time.sleep(600)
"""


def python(code: str, *words: object) -> subprocess.Popen[str]:
    """A process that said its first word."""
    process = subprocess.Popen([sys.executable, "-c", code, *map(str, words)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline()
    return process


def test_manifest_is_whole_whenever_it_is_read_and_whenever_its_writer_dies(tmp_path: Path) -> None:
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
    assert changes == 40, "the file was replaced between readings"
    assert len(Manifest(Place(str(path)), {}).read()) == 500


def test_manifest_keeps_the_captures_of_earlier_calls(memory: Place) -> None:
    at = memory / "batch.json"
    cup, jug = Chain("cup", "s3://shelf/cup"), Chain("jug", "s3://shelf/jug")
    cup.settle(Outcome("failed", "no photographs"), Patience(1, 0.0), 0.0, 0.0)
    assert Manifest(at, {"started": "then"}).write([cup])
    second = Manifest(at, {"started": "now"})
    assert set(second.read()) == {"cup"}
    assert second.write([jug])
    document = json.loads(object_store.read(at) or b"")
    assert set(document["captures"]) == {"cup", "jug"} and document["started"] == "then"
    assert document["captures"]["cup"]["reason"] == "initialization: no photographs"
    assert not second.write([jug], force=False), "it was just written"


@pytest.mark.parametrize("content", [b"{", b"[]", b'{"format": "other"}', b'{"format": "hir-batch", "version": 9}'])
def test_manifest_that_is_none_is_refused(memory: Place, content: bytes) -> None:
    object_store.write(memory / "batch.json", content)
    with pytest.raises(InputError, match=r"batch\.json"):
        Manifest(memory / "batch.json", {}).read()


@pytest.mark.skipif(os.name != "posix", reason="processes are looked up by signals")
def test_one_batch_at_a_time_and_the_next_one_when_it_died(tmp_path: Path) -> None:
    at, said = Place(str(tmp_path / "lease.json")), []
    with python(HOLD, at.url) as other:
        with (
            pytest.raises(InputError, match=f"another batch works on .* \\(process {other.pid} on"),
            Lease(at, said.append),
        ):
            pass
        other.send_signal(signal.SIGKILL)
    with Lease(at, said.append) as mine:
        assert owner_of(at) == mine.token and "going on with a batch that ended" in said[-1]
    assert not object_store.exists(at), "given back"


def test_lease_of_another_machine_counts_until_it_is_silent(memory: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    now = time.time()
    fresh = {"owner": "them", "host": "another", "pid": 1, "renewed": now}
    assert not died(fresh, now) and died({**fresh, "renewed": now - STALE_SECONDS - 1}, now) and died({}, now)
    at, said = memory / "lease.json", []

    def renewed_by_its_owner(seconds: float) -> None:
        object_store.write(at, json.dumps({**fresh, "renewed": time.time() + 1}).encode())

    object_store.write(at, json.dumps(fresh).encode())
    monkeypatch.setattr(lease_module.time, "sleep", renewed_by_its_owner)
    with pytest.raises(InputError, match="on another"), Lease(at, said.append):
        pass
    assert len(said) == 1 and "waiting up to 60 s" in said[0]


def test_batch_notices_that_its_destination_was_taken(memory: Place, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lease_module, "RENEW_SECONDS", 0.02)
    at = memory / "lease.json"
    with Lease(at, print) as mine:
        assert not mine.lost
        object_store.write(at, b'{"owner": "them"}')
        until = time.monotonic() + 10
        while not mine.lost and time.monotonic() < until:
            time.sleep(0.01)
        assert mine.lost
    assert owner_of(at) == "them", "what belongs to another is not given back"
