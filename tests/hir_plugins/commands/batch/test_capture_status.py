"""Which captures need work, found without reading a photograph."""

from __future__ import annotations

from pathlib import Path

import pytest

from hir_core.errors import InputError
from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.scheduling.capture_status import Intake, chains_of, expand, look, read_list
from hir_plugins.commands.batch.stage_groups import GROUPS
from hir_plugins.commands.batch.storage import object_store
from hir_plugins.commands.batch.storage.content_hash import listing_mark, work_mark
from hir_plugins.commands.batch.storage.layout import Destination
from hir_plugins.commands.batch.storage.object_store import Place


@pytest.fixture
def cup(memory: Place) -> Chain:
    object_store.write(memory / "shelf" / "cup" / "a.png", b"red")
    return Chain("cup", (memory / "shelf" / "cup").url)


def finish(chain: Chain, destination: Destination, settings: str = "set") -> None:
    """As a worker leaves a finished capture."""
    object_store.write(destination.result(chain.name) / "run.json", b"{}")
    listing = listing_mark(object_store.files(Place(chain.source)))
    destination.write_record(chain.name, {"listing": listing, "content": "c0ffee", "settings": settings})


def test_finished_capture_is_skipped_until_input_or_settings_change(cup: Chain, memory: Place) -> None:
    destination = Destination(memory / "out")
    assert look(cup, "set", destination, {}, False).verdict == "work"
    finish(cup, destination)
    assert look(cup, "set", destination, {}, False).verdict == "finished"
    other = look(cup, "other", destination, {}, False)
    assert (other.verdict, other.content, other.group) == ("work", "c0ffee", 0), "the bytes are known"
    object_store.write(Place(cup.source) / "a.png", b"sea")
    changed = look(cup, "set", destination, {}, False)
    assert (changed.verdict, changed.content) == ("work", "") and changed.record["content"] == "c0ffee"


def test_record_without_its_result_counts_for_nothing(cup: Chain, memory: Place) -> None:
    destination = Destination(memory / "out")
    finish(cup, destination)
    object_store.remove(destination.result("cup") / "run.json")
    found = look(cup, "set", destination, {}, False)
    assert found.verdict == "work" and not found.record


def test_failed_capture_waits_for_a_change_or_for_the_word(cup: Chain, memory: Place) -> None:
    destination = Destination(memory / "out")
    listing = listing_mark(object_store.files(Place(cup.source)))
    entry = {"state": "failed", "listing": listing, "settings": "set", "content": "c0ffee"}
    assert look(cup, "set", destination, entry, False).verdict == "failed before"
    assert look(cup, "set", destination, entry, True).verdict == "work"
    assert look(cup, "other", destination, entry, False).verdict == "work"
    object_store.write(Place(cup.source) / "b.png", b"another photograph")
    assert look(cup, "set", destination, entry, False).verdict == "work"


def test_begun_capture_goes_on_with_the_first_group_that_is_not_kept(cup: Chain, memory: Place) -> None:
    destination = Destination(memory / "out")
    entry = {"state": "running", "listing": listing_mark(object_store.files(Place(cup.source))), "content": "c0ffee"}
    for i, group in enumerate(GROUPS[:3]):
        assert look(cup, "set", destination, entry, False).group == i
        object_store.write(destination.unfinished("cup") / work_mark("c0ffee", "set") / f"{group.name}.tar", b"")
    assert look(cup, "set", destination, entry, False).group == 3
    assert look(cup, "other", destination, entry, False).group == 0


def test_intake_names_what_is_missing_and_looks_only_while_there_is_room(cup: Chain, memory: Place) -> None:
    intake = Intake([cup, Chain("jug", (memory / "jug").url)], "set", Destination(memory / "out"), {}, False)
    assert list(intake.looked_at(room=False)) == [] and not intake.looking and not intake.empty
    found = {}
    while not intake.empty:
        found |= {chain.name: seen for chain, seen in intake.looked_at(room=True)}
    intake.close()
    assert found["cup"].verdict == "work" and found["jug"].verdict == "unreadable"
    assert found["jug"].reason.endswith("jug does not exist or is empty; give the folder of a capture")


def test_results_are_named_by_their_captures(tmp_path: Path) -> None:
    destination = Destination(Place(str(tmp_path / "out")))
    chains = chains_of(["s3://a/cup/", "s3://a/jug", "s3://a/cup"], destination)
    assert [(chain.name, chain.source) for chain in chains] == [("cup", "s3://a/cup"), ("jug", "s3://a/jug")]
    with pytest.raises(InputError, match="two captures are called 'cup': s3://a/cup and s3://b/cup"):
        chains_of(["s3://a/cup", "s3://b/cup"], destination)
    with pytest.raises(InputError, match="would replace the capture itself"):
        chains_of([str(tmp_path / "out" / "cup")], destination)
    for wrong in ("s3://a/.batch", "s3://a/batch.json"):
        with pytest.raises(InputError, match="results go by its last part"):
            chains_of([wrong], destination)
    with pytest.raises(InputError, match="no capture"):
        chains_of([], destination)


def test_patterns_and_lists_name_many_captures(memory: Place, tmp_path: Path) -> None:
    for name in ("cup", "jug", "pot"):
        object_store.write(memory / name / "a.png", b"red")
        (tmp_path / name).mkdir()
    assert expand([f"{memory.url}/[cj]u?"]) == [f"{memory.url}/cup", f"{memory.url}/jug"]
    assert expand([f"{tmp_path}/*"]) == [str(tmp_path / name) for name in ("cup", "jug", "pot")]
    assert expand(["no/pattern"]) == ["no/pattern"]
    with pytest.raises(InputError, match="matches nothing"):
        expand([f"{memory.url}/x*"])
    object_store.write(memory / "shelf.txt", b"# a shelf\ns3://a/cup\n\n s3://a/jug\n")
    assert read_list(f"{memory.url}/shelf.txt") == ["s3://a/cup", "s3://a/jug"]
    with pytest.raises(InputError, match="one capture a line"):
        read_list(f"{memory.url}/none.txt")
