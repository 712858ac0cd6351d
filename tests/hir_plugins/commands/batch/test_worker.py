"""The four tasks of a capture, run here one after the other, without Ray."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from hir_core import __version__
from hir_core.config import RunConfig, load_config
from hir_core.pipeline import reconstruct
from hir_core.plugins.manager import PluginManager
from hir_plugins.commands.batch.scheduling.messages import Job, Outcome, Told
from hir_plugins.commands.batch.scheduling.worker import run_group
from hir_plugins.commands.batch.stage_groups import GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import content_mark, settings_mark
from hir_plugins.commands.batch.storage.layout import Destination, json_bytes
from hir_plugins.commands.batch.storage.object_store import Place
from tests.hir_core.test_pipeline import files
from tests.hir_plugins.commands.batch.conftest import QUICKER


@pytest.fixture(scope="module")
def config() -> RunConfig:
    return load_config(PluginManager.discover(), assignments=QUICKER, device="cpu", deterministic=True)


def job_for(source: Place | Path, out: Place, config: RunConfig, cache: Path, group: int = 0) -> Job:
    object_store.write(Destination(out).lease, json_bytes({"owner": "me"}))
    source = source if isinstance(source, Place) else Place(str(source))
    return Job(
        source.name, source.url, out.url, group, config, settings_mark(config), "me", __version__, cache=str(cache)
    )


def run(job: Job, told: list[Told] | None = None) -> Outcome:
    return run_group(job, (told if told is not None else []).append)


def test_chain_on_a_store_makes_what_a_single_run_makes(
    tiny: Path, config: RunConfig, memory: Place, tmp_path: Path
) -> None:
    """Photographs and result in a store, each group on another node's disk: the same bytes, everything kept."""
    source, out = memory / "shelf" / "cow", memory / "out"
    object_store.upload({file.relative_to(tiny).as_posix(): file for file in tiny.rglob("*") if file.is_file()}, source)
    told: list[Told] = []
    content = ""
    for i, group in enumerate(GROUPS):
        job = replace(job_for(source, out, config, tmp_path / f"node{i}", i), content=content, listing="as listed")
        outcome = run(job, told)
        assert outcome.state == "done" and not outcome.reused, outcome
        if i == 0:
            assert run(job).reused, "what is kept is not computed again"
        content = outcome.content
        kept = set(object_store.files(Destination(out).unfinished("cow")))
        assert {Path(name).stem for name in kept} == ({g.name for g in GROUPS[: i + 1]} if i < 3 else set()), group
    assert content == content_mark(tiny) and {t.stage for t in told} >= {"initializer", "geometry", "reflectance"}

    single = reconstruct(tiny, tmp_path / "single", config=config)
    result = out / "cow"
    object_store.download(result, object_store.files(result), tmp_path / "result")
    assert files(tmp_path / "result" / "scene") == files(single.directory.scene)
    assert files(tmp_path / "result" / "exports") == files(single.directory.exports)
    document = json.loads((tmp_path / "result" / "run.json").read_text())
    assert document["capture"].pop("path") == source.url, "the staged copy is gone, this one is not"
    expected = single.directory.read_run()
    del expected["capture"]["path"]
    assert document == expected

    record = Destination(out).record("cow")
    assert (record["content"], record["listing"]) == (content, "as listed") and record["psnr"]["object"] > 10
    assert record["thumbnail"].startswith("data:image/jpeg;base64,") and set(record["stage_seconds"]) >= {"geometry"}
    again = replace(job_for(source, out, config, tmp_path / "node4"), finished=(content, record["settings"]))
    assert run(again).state == "unchanged"


def test_broken_capture_is_one_sentence_and_a_log(tiny: Path, config: RunConfig, memory: Place, tmp_path: Path) -> None:
    source = memory / "shelf" / "broken"
    object_store.upload({file.relative_to(tiny).as_posix(): file for file in tiny.rglob("*") if file.is_file()}, source)
    photograph = min((tiny / "train").iterdir())
    object_store.write(source / "train" / photograph.name, photograph.read_bytes()[:300])
    outcome = run(job_for(source, memory / "out", config, tmp_path / "node"))
    assert outcome.state == "failed" and "\n" not in outcome.reason
    assert outcome.reason.startswith(f"{source}/train/{photograph.name} "), "not the staged copy's path"
    assert any("Traceback" in line for line in outcome.lines)
    assert object_store.files(memory / "out" / "broken") == {} and Destination(memory / "out").record("broken") == {}


def test_refusals_are_sorted(
    tiny: Path, config: RunConfig, memory: Place, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = job_for(tiny, memory / "out", config, tmp_path / "node")
    other = run(replace(job, version="0.0.1"))
    assert other.state == "failed" and "install the same" in other.reason
    gone = run(replace(job, source=str(tmp_path / "gone")))
    assert gone.state == "failed" and "does not exist on this node" in gone.reason

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("hir_core.pipeline.reconstruct", full)
    assert run(job).state == "trouble", "another node may have a disk"

    def wrong(*_: object, **__: object) -> None:
        raise ZeroDivisionError("division by zero")

    monkeypatch.setattr("hir_core.pipeline.reconstruct", wrong)
    assert run(job).reason == "this is a bug: ZeroDivisionError: division by zero"
    monkeypatch.setattr("hir_core.pipeline.reconstruct", lambda *_, **__: SimpleNamespace(reused=()))
    object_store.write(Destination(memory / "out").lease, json_bytes({"owner": "another batch"}))
    superseded = run(job)
    assert superseded.state == "trouble" and "another batch" in superseded.reason
    assert object_store.files(Destination(memory / "out").unfinished("cow")) == {}
