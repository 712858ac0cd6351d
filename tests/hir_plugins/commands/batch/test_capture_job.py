"""The transitions of a capture's job after each outcome, and the time estimate."""

from __future__ import annotations

from hir_plugins.commands.batch.retries import RetryPolicy
from hir_plugins.commands.batch.scheduling.capture_job import CaptureJob
from hir_plugins.commands.batch.scheduling.messages import TaskOutcome
from hir_plugins.commands.batch.scheduling.time_estimate import TimeEstimate
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS

POLICY = RetryPolicy(attempts=3, initial_wait_s=2.0, factor=4.0)


def transitions(job: CaptureJob, *outcomes: TaskOutcome) -> list[str]:
    return [job.apply(outcome, POLICY, now=100.0, jitter=1.0) for outcome in outcomes]


def test_four_groups_make_a_capture() -> None:
    job = CaptureJob("cup", "s3://captures/cup")
    done = TaskOutcome("done", content_hash="c0ffee", seconds={"compute": 2.0})
    last = TaskOutcome("done", record={"psnr": {"object": 30.0}, "thumbnail": "data:"})
    assert transitions(job, done, done, done, last) == ["next group", "next group", "next group", "done"]
    assert job.state == "done" and job.content_hash == "c0ffee" and set(job.seconds) == {g.name for g in STAGE_GROUPS}
    entry = job.manifest_entry()
    assert entry["psnr"] == {"object": 30.0} and "thumbnail" not in entry and "group" not in entry


def test_infrastructure_errors_are_retried_and_counted_for_each_group() -> None:
    job = CaptureJob("cup", "cup")
    error = TaskOutcome("infrastructure_error", "the worker's process died")
    assert transitions(job, error) == ["retry"] and job.not_before == 102.0
    assert transitions(job, error) == ["retry"] and job.not_before == 108.0
    assert transitions(job, TaskOutcome("done"), error, error) == ["next group", "retry", "retry"] and job.retries == 4
    assert transitions(job, error) == ["failed"]
    assert (
        job.reason == "geometry: the worker's process died (3 attempts)" and job.manifest_entry()["group"] == "geometry"
    )


def test_broken_capture_is_never_retried() -> None:
    job = CaptureJob("cup", "cup")
    assert transitions(job, TaskOutcome("failed", "cup/03.png is cut off", log_lines=("a traceback",))) == ["failed"]
    assert job.reason == "initialization: cup/03.png is cut off" and job.log_lines == ["a traceback"]
    assert job.retries == 0 and job.state == "failed"


def test_unchanged_capture_keeps_the_record_of_its_result() -> None:
    job = CaptureJob("cup", "cup")
    job.set_published(
        {"content_hash": "c0ffee", "settings_hash": "5e7", "psnr": {"object": 31.0}, "thumbnail": "data:"}
    )
    assert job.published == ("c0ffee", "5e7")
    assert transitions(job, TaskOutcome("unchanged", content_hash="c0ffee")) == ["unchanged"]
    assert job.state == "done" and job.manifest_entry()["psnr"] == {"object": 31.0}


def test_entry_of_an_earlier_call_is_restored_and_damaged_values_are_ignored() -> None:
    job = CaptureJob("cup", "cup")
    transitions(
        job,
        TaskOutcome("infrastructure_error", "the node left"),
        TaskOutcome("done", content_hash="c0ffee", seconds={"compute": 2.0}),
    )
    again = CaptureJob("cup", "cup")
    again.restore(job.manifest_entry())
    assert (again.content_hash, again.seconds, again.retries) == ("c0ffee", job.seconds, 1)
    again.restore({"seconds": 3, "content_hash": None, "state": []})
    assert again.content_hash == "" and again.state == "waiting" and again.seconds == job.seconds


def test_estimate_needs_one_task_of_each_group() -> None:
    estimate, job = TimeEstimate(), CaptureJob("cup", "cup")
    for group, seconds in enumerate((2.0, 10.0, 30.0)):
        estimate.record(group, seconds)
    assert estimate.job_seconds_left(job) is None and estimate.batch_seconds_left([job], 1, 1) is None
    estimate.record(3, 4.0)
    estimate.record(1, 12.0)
    assert estimate.job_seconds_left(job, running_s=1.0) == 1.0 + 11.0 + 30.0 + 4.0
    job.group = 2
    assert estimate.job_seconds_left(job, running_s=50.0) == 4.0, (
        "a task that exceeds the median is expected to end now"
    )
    assert estimate.job_seconds_left(CaptureJob("jug", "jug", state="done")) == 0.0
    assert estimate.batch_seconds_left([job], waiting=3, parallel=2) == (34.0 + 3 * 47.0) / 2
