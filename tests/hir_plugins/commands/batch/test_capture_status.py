"""Which captures have to be processed, decided without reading a photograph."""

from __future__ import annotations

from pathlib import Path

import pytest

from hir_core.errors import InputError
from hir_plugins.commands.batch.scheduling.capture_arguments import capture_jobs, expand_patterns, read_capture_list
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.scheduling.capture_status import StatusChecker, capture_status
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import listing_hash, result_key
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.storage_path import StoragePath


@pytest.fixture
def cup(memory: StoragePath) -> CaptureJob:
    object_store.write(memory / "captures" / "cup" / "a.png", b"red")
    return CaptureJob("cup", (memory / "captures" / "cup").url)


def finish(job: CaptureJob, destination: Destination, settings: str = "set") -> None:
    """The files that a worker leaves for a finished capture."""
    object_store.write(destination.result(job.name) / "run.json", b"{}")
    listing = listing_hash(object_store.list_files(StoragePath(job.source)))
    destination.write_record(job.name, {"listing_hash": listing, "content_hash": "c0ffee", "settings_hash": settings})


def test_finished_capture_is_skipped_until_input_or_settings_change(cup: CaptureJob, memory: StoragePath) -> None:
    destination = Destination(memory / "out")
    assert capture_status(cup, "set", destination, {}, False).state == "unfinished"
    finish(cup, destination)
    assert capture_status(cup, "set", destination, {}, False).state == "finished"
    other = capture_status(cup, "other", destination, {}, False)
    assert (other.state, other.content_hash, other.group) == ("unfinished", "c0ffee", 0), "the content hash is known"
    object_store.write(StoragePath(cup.source) / "a.png", b"sea")
    changed = capture_status(cup, "set", destination, {}, False)
    assert (changed.state, changed.content_hash) == ("unfinished", "") and changed.record["content_hash"] == "c0ffee"


def test_record_without_its_result_is_ignored(cup: CaptureJob, memory: StoragePath) -> None:
    destination = Destination(memory / "out")
    finish(cup, destination)
    object_store.remove(destination.result("cup") / "run.json")
    status = capture_status(cup, "set", destination, {}, False)
    assert status.state == "unfinished" and not status.record


def test_failed_capture_is_skipped_until_a_change_or_retry_failed(cup: CaptureJob, memory: StoragePath) -> None:
    destination = Destination(memory / "out")
    listing = listing_hash(object_store.list_files(StoragePath(cup.source)))
    entry = {"state": "failed", "listing_hash": listing, "settings_hash": "set", "content_hash": "c0ffee"}
    assert capture_status(cup, "set", destination, entry, False).state == "failed before"
    assert capture_status(cup, "set", destination, entry, True).state == "unfinished"
    assert capture_status(cup, "other", destination, entry, False).state == "unfinished"
    object_store.write(StoragePath(cup.source) / "b.png", b"another photograph")
    assert capture_status(cup, "set", destination, entry, False).state == "unfinished"


def test_unfinished_capture_continues_with_the_first_group_that_is_not_stored(
    cup: CaptureJob, memory: StoragePath
) -> None:
    destination = Destination(memory / "out")
    entry = {
        "state": "running",
        "listing_hash": listing_hash(object_store.list_files(StoragePath(cup.source))),
        "content_hash": "c0ffee",
    }
    for i, group in enumerate(STAGE_GROUPS[:3]):
        assert capture_status(cup, "set", destination, entry, False).group == i
        object_store.write(destination.unfinished("cup") / result_key("c0ffee", "set") / f"{group.name}.tar", b"")
    assert capture_status(cup, "set", destination, entry, False).group == 3
    assert capture_status(cup, "other", destination, entry, False).group == 0


def test_status_checker_starts_checks_only_on_request(cup: CaptureJob, memory: StoragePath) -> None:
    checker = StatusChecker(
        [cup, CaptureJob("jug", (memory / "jug").url)], "set", Destination(memory / "out"), {}, False
    )
    assert list(checker.completed(start_more=False)) == [] and not checker.running and not checker.finished
    statuses = {}
    while not checker.finished:
        statuses |= {job.name: status for job, status in checker.completed(start_more=True)}
    checker.close()
    assert statuses["cup"].state == "unfinished" and statuses["jug"].state == "unreadable"
    assert statuses["jug"].reason.endswith("jug does not exist or is empty; give the folder of a capture")


def test_results_are_named_after_their_captures(tmp_path: Path) -> None:
    destination = Destination(StoragePath(str(tmp_path / "out")))
    jobs = capture_jobs(["s3://a/cup/", "s3://a/jug", "s3://a/cup"], destination)
    assert [(job.name, job.source) for job in jobs] == [("cup", "s3://a/cup"), ("jug", "s3://a/jug")]
    with pytest.raises(InputError, match="two captures have the name 'cup': s3://a/cup and s3://b/cup"):
        capture_jobs(["s3://a/cup", "s3://b/cup"], destination)
    with pytest.raises(InputError, match="would replace the capture itself"):
        capture_jobs([str(tmp_path / "out" / "cup")], destination)
    for invalid in ("s3://a/.batch", "s3://a/batch.json"):
        with pytest.raises(InputError, match="cannot be a capture"):
            capture_jobs([invalid], destination)
    with pytest.raises(InputError, match="no capture"):
        capture_jobs([], destination)


def test_patterns_and_lists_name_many_captures(memory: StoragePath, tmp_path: Path) -> None:
    for name in ("cup", "jug", "pot"):
        object_store.write(memory / name / "a.png", b"red")
        (tmp_path / name).mkdir()
    assert expand_patterns([f"{memory.url}/[cj]u?"]) == [f"{memory.url}/cup", f"{memory.url}/jug"]
    assert expand_patterns([f"{tmp_path}/*"]) == [str(tmp_path / name) for name in ("cup", "jug", "pot")]
    assert expand_patterns(["no/pattern"]) == ["no/pattern"]
    with pytest.raises(InputError, match="matches nothing"):
        expand_patterns([f"{memory.url}/x*"])
    object_store.write(memory / "list.txt", b"# captures\ns3://a/cup\n\n s3://a/jug\n")
    assert read_capture_list(f"{memory.url}/list.txt") == ["s3://a/cup", "s3://a/jug"]
    with pytest.raises(InputError, match="one capture per line"):
        read_capture_list(f"{memory.url}/none.txt")
