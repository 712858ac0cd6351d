"""Results are published as a whole; stages of unfinished captures can be fetched by any node."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tarfile
import time
from pathlib import Path

import pytest

from hir_core.errors import CaptureError, InputError
from hir_core.run.run_directory import RunDirectory, StageRecord
from hir_plugins.commands.batch.retries import StoreError
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.archive import pack, result_files, unpack
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.storage_path import StoragePath
from hir_plugins.commands.batch.storage.worker_scratch import remove_stale_scratch, worker_scratch
from tests.hir_plugins.commands.batch.conftest import UnreliableStore


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run directory with two finished stages, a workspace, a lock and a result."""
    folder = tmp_path / "run"
    directory = RunDirectory(folder)
    for stage in ("initializer", "geometry"):
        (directory.begin(stage, "key") / "database.db").write_bytes(b"large")
        (directory.stage(stage) / "scene").write_bytes(stage.encode())
        directory.finish(StageRecord(stage, "key", True))
    (folder / ".lock").write_bytes(b"")
    directory.write_run({"capture": {"path": "/cache/cup"}})
    (folder / "exports").mkdir()
    (folder / "exports" / "cup.glb").write_bytes(b"glTF")
    return folder


def relative(folder: Path) -> set[str]:
    return {file.relative_to(folder).as_posix() for file in folder.rglob("*") if file.is_file()}


def test_archive_of_a_group_contains_its_stages_and_the_records(run: Path, tmp_path: Path) -> None:
    unpack(pack(run, STAGE_GROUPS[1]), tmp_path / "there")
    assert relative(tmp_path / "there") == {"run.json", "stages/2-geometry/scene", "stages/2-geometry/stage.json"}
    unpack(pack(run, STAGE_GROUPS[0]), tmp_path / "there")
    assert (tmp_path / "there" / "stages/1-initializer/scene").read_bytes() == b"initializer"
    record = RunDirectory(tmp_path / "there").record("geometry")
    assert record is not None and record.finished
    assert not any("work" in file.parts or file.name == ".lock" for file in result_files(run))


@pytest.mark.parametrize("name", ["../evil", "/tmp/evil", "link"])
def test_archive_that_leads_out_of_the_run_is_refused(name: str, tmp_path: Path) -> None:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        member = tarfile.TarInfo(name)
        if name == "link":
            member.type, member.linkname = tarfile.SYMTYPE, "/etc/passwd"
        archive.addfile(member, io.BytesIO(b""))
    with pytest.raises(InputError, match="damaged"):
        unpack(stream.getvalue(), tmp_path / "run")
    with pytest.raises(InputError, match="damaged"):
        unpack(stream.getvalue()[:100], tmp_path / "run")
    assert not (tmp_path / "evil").exists() and not Path("/tmp/evil").exists()


@pytest.mark.parametrize("kind", ["memory", "local"])
def test_result_replaces_an_older_one_as_a_whole(kind: str, run: Path, memory: StoragePath, tmp_path: Path) -> None:
    destination = Destination(memory if kind == "memory" else StoragePath(str(tmp_path / "out")))
    destination.publish("cup", run)
    (run / "exports" / "cup.glb").unlink()
    (run / "exports" / "cup.usdz").write_bytes(b"usd")
    size = destination.publish("cup", run)
    published = {
        name: object_store.read(destination.result("cup") / name)
        for name in object_store.list_files(destination.result("cup"))
    }
    expected = {file.relative_to(run).as_posix(): file.read_bytes() for file in result_files(run)}
    assert published == expected and size == sum(map(len, expected.values())) and "exports/cup.glb" not in published
    destination.publish("cup", run, keep_stages=False)
    assert set(object_store.list_files(destination.result("cup"))) == {
        name for name in expected if not name.startswith("stages/")
    }


def test_interrupted_upload_leaves_no_run(run: Path, memory: StoragePath, monkeypatch: pytest.MonkeyPatch) -> None:
    destination = Destination(StoragePath(memory.url.replace("memory", "unreliable")))
    destination.publish("cup", run)
    with monkeypatch.context() as patch:
        patch.setattr(UnreliableStore, "read_only_name", "cup.glb")
        with pytest.raises(InputError, match=r"cup\.glb cannot be written: .*; check the address and your permissions"):
            destination.publish("cup", run)
    assert not object_store.exists(destination.result("cup") / "run.json"), "without run.json a folder is not a run"
    destination.publish("cup", run)
    assert object_store.read(destination.result("cup") / "run.json") == (run / "run.json").read_bytes()


def test_folder_that_is_no_run_is_not_replaced(run: Path, tmp_path: Path) -> None:
    (tmp_path / "out" / "cup").mkdir(parents=True)
    (tmp_path / "out" / "cup" / "letters.txt").write_text("dear")
    with pytest.raises(InputError, match="exists and is not a run"):
        Destination(StoragePath(str(tmp_path / "out"))).publish("cup", run)
    assert (tmp_path / "out" / "cup" / "letters.txt").read_text() == "dear"


def test_groups_are_stored_by_content_and_settings(run: Path, memory: StoragePath, tmp_path: Path) -> None:
    destination = Destination(memory)
    destination.store_group("cup", "key", STAGE_GROUPS[0], run)
    assert (
        destination.stored_groups("cup", "key") == [STAGE_GROUPS[0]] and destination.stored_groups("cup", "other") == []
    )
    destination.fetch_group("cup", "key", STAGE_GROUPS[0], tmp_path / "node")
    assert relative(tmp_path / "node") == {"run.json", "stages/1-initializer/scene", "stages/1-initializer/stage.json"}
    with pytest.raises(InputError, match="no longer exist"):
        destination.fetch_group("cup", "key", STAGE_GROUPS[1], tmp_path / "node")


def test_damaged_record_is_empty(memory: StoragePath) -> None:
    destination = Destination(memory)
    destination.write_record("cup", {"psnr": {"object": 30.0}})
    assert destination.record("cup") == {"psnr": {"object": 30.0}}
    object_store.write(memory / ".batch" / "records" / "cup.json", b"[1")
    assert destination.record("cup") == {} and destination.record("jug") == {}


def test_capture_is_staged_once_under_its_own_name(memory: StoragePath, tmp_path: Path) -> None:
    object_store.write(memory / "cup" / "train" / "a.png", b"red")
    with worker_scratch(tmp_path / "cache", "s3://out", "cup") as scratch:
        staged, content = scratch.stage_capture(memory / "cup", "")
        assert staged.name == "cup" and (staged / "train" / "a.png").read_bytes() == b"red"
    object_store.remove(memory / "cup")
    with worker_scratch(tmp_path / "cache", "s3://out", "cup") as scratch:
        assert scratch.stage_capture(memory / "cup", content) == (staged, content), "nothing is downloaded again"
        scratch.clear()
        with pytest.raises(CaptureError, match="does not exist or is empty"):
            scratch.stage_capture(memory / "cup", content)
        with pytest.raises(CaptureError, match="does not exist on this node"):
            scratch.stage_capture(StoragePath(str(tmp_path / "gone")), "")


def test_run_of_other_input_is_removed_from_the_scratch_folder(tmp_path: Path) -> None:
    with worker_scratch(tmp_path, "out", "cup") as scratch:
        scratch.prepare_run("one")
        scratch.run.mkdir()
        (scratch.run / "run.json").write_text("{}")
        scratch.prepare_run("one")
        assert scratch.run.exists()
        scratch.prepare_run("two")
        assert not scratch.run.exists()


LOCK_SCRATCH = """
import sys, time
from pathlib import Path
from hir_plugins.commands.batch.storage.worker_scratch import worker_scratch
with worker_scratch(Path(sys.argv[1]), "out", "cup"):
    print("locked", flush=True)
    time.sleep(600)
"""


def test_scratch_folder_is_locked_until_its_worker_dies(tmp_path: Path) -> None:
    with subprocess.Popen(
        [sys.executable, "-c", LOCK_SCRATCH, str(tmp_path)], stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None and other.stdout.readline()
        with pytest.raises(StoreError, match="still processing cup"), worker_scratch(tmp_path, "out", "cup", 0.3):
            pass
        (folder,) = tmp_path.iterdir()
        os.utime(folder, (1, 1))
        remove_stale_scratch(tmp_path, time.time())
        assert folder.exists(), "it is in use"
        other.kill()
    remove_stale_scratch(tmp_path, time.time())
    assert not folder.exists()
    with worker_scratch(tmp_path, "out", "cup"):
        pass
