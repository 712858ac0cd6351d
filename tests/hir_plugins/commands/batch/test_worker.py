"""The four tasks of a capture, run in this process without Ray."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import pytest

from hir_core import __version__
from hir_core.config import RunConfig, load_config
from hir_core.pipeline import reconstruct
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.batch.scheduling.messages import ProgressMessage, TaskOutcome, TaskSpec
from hir_plugins.commands.batch.scheduling.worker import RunFunction, run_stages, run_task
from hir_plugins.commands.batch.stage_groups import STAGE_GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import content_hash, settings_hash
from hir_plugins.commands.batch.storage.layout import Destination, json_bytes
from hir_plugins.commands.batch.storage.storage_path import StoragePath
from tests.hir_core.test_pipeline import files
from tests.hir_plugins.commands.batch.conftest import QUICKER


@pytest.fixture(scope="module")
def config() -> RunConfig:
    return load_config(PluginManager.discover(), assignments=QUICKER, device="cpu", deterministic=True)


def task_for(source: StoragePath | Path, out: StoragePath, config: RunConfig, cache: Path, group: int = 0) -> TaskSpec:
    object_store.write(Destination(out).lease, json_bytes({"owner": "me"}))
    source = source if isinstance(source, StoragePath) else StoragePath(str(source))
    return TaskSpec(
        source.name, source.url, out.url, group, config, settings_hash(config), "me", __version__, cache=str(cache)
    )


def run(
    spec: TaskSpec, messages: list[ProgressMessage] | None = None, run_function: RunFunction = run_stages
) -> TaskOutcome:
    return run_task(spec, (messages if messages is not None else []).append, run_function)


@pytest.mark.slow
def test_four_tasks_on_a_store_give_the_bytes_of_a_single_run(
    tiny: Path, config: RunConfig, memory: StoragePath, tmp_path: Path
) -> None:
    """Capture and result are in a store, each task uses another scratch folder: the bytes are those of one run."""
    source, out = memory / "captures" / "cow", memory / "out"
    object_store.upload({file.relative_to(tiny).as_posix(): file for file in tiny.rglob("*") if file.is_file()}, source)
    messages: list[ProgressMessage] = []
    content = ""
    for i, group in enumerate(STAGE_GROUPS):
        spec = replace(
            task_for(source, out, config, tmp_path / f"node{i}", i), content_hash=content, listing_hash="as listed"
        )
        outcome = run(spec, messages)
        assert outcome.state == "done" and not outcome.reused, outcome
        if i == 0:
            assert run(spec).reused, "stored stages are not computed again"
        content = outcome.content_hash
        stored = set(object_store.list_files(Destination(out).unfinished("cow")))
        assert {Path(name).stem for name in stored} == ({g.name for g in STAGE_GROUPS[: i + 1]} if i < 3 else set()), (
            group
        )
    assert content == content_hash(tiny) and {message.stage for message in messages} >= {
        "initializer",
        "geometry",
        "reflectance",
    }

    single = reconstruct(tiny, tmp_path / "single", config=config)
    result = out / "cow"
    object_store.download(result, object_store.list_files(result), tmp_path / "result")
    assert files(tmp_path / "result" / "scene") == files(single.directory.scene)
    assert files(tmp_path / "result" / "exports") == files(single.directory.exports)
    document = json.loads((tmp_path / "result" / "run.json").read_text())
    assert document["capture"].pop("path") == source.url, "not the path of the staged copy"
    expected = single.directory.read_run()
    del expected["capture"]["path"]
    for stage in expected["stages"]:
        assert document["stages"][stage] == expected["stages"][stage], stage
    assert document == expected

    record = Destination(out).record("cow")
    assert (record["content_hash"], record["listing_hash"]) == (content, "as listed") and record["psnr"]["object"] > 10
    assert record["thumbnail"].startswith("data:image/jpeg;base64,") and set(record["stage_seconds"]) >= {"geometry"}
    again = replace(task_for(source, out, config, tmp_path / "node4"), published=(content, record["settings_hash"]))
    assert run(again).state == "unchanged"


def test_broken_capture_fails_with_one_sentence_and_a_log(
    tiny: Path, config: RunConfig, memory: StoragePath, tmp_path: Path
) -> None:
    source = memory / "captures" / "broken"
    object_store.upload({file.relative_to(tiny).as_posix(): file for file in tiny.rglob("*") if file.is_file()}, source)
    photograph = min((tiny / "train").iterdir())
    object_store.write(source / "train" / photograph.name, photograph.read_bytes()[:300])
    outcome = run(task_for(source, memory / "out", config, tmp_path / "node"))
    assert outcome.state == "failed" and "\n" not in outcome.reason
    assert outcome.reason.startswith(f"{source}/train/{photograph.name} "), "not the staged copy's path"
    assert any("Traceback" in line for line in outcome.log_lines)
    assert (
        object_store.list_files(memory / "out" / "broken") == {} and Destination(memory / "out").record("broken") == {}
    )


def test_errors_are_classified(tiny: Path, config: RunConfig, memory: StoragePath, tmp_path: Path) -> None:
    spec = task_for(tiny, memory / "out", config, tmp_path / "node")
    other = run(replace(spec, version="0.0.1"))
    assert other.state == "failed" and "install the same version" in other.reason
    gone = run(replace(spec, source=str(tmp_path / "gone")))
    assert gone.state == "failed" and "does not exist on this node" in gone.reason

    def disk_full(*_: object) -> NoReturn:
        raise OSError(28, "No space left on device")

    assert run(spec, run_function=disk_full).state == "infrastructure_error", "another node may have free space"

    def defective(*_: object) -> NoReturn:
        raise ZeroDivisionError("division by zero")

    assert run(spec, run_function=defective).reason == "this is a bug: ZeroDivisionError: division by zero"
    object_store.write(Destination(memory / "out").lease, json_bytes({"owner": "another batch"}))
    superseded = run(spec, run_function=lambda *_: ())
    assert superseded.state == "infrastructure_error" and "another batch" in superseded.reason
    assert object_store.list_files(Destination(memory / "out").unfinished("cow")) == {}
