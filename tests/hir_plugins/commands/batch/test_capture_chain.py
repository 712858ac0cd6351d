"""What follows each outcome."""

from __future__ import annotations

from hir_plugins.commands.batch.retries import Patience
from hir_plugins.commands.batch.scheduling.capture_chain import Chain
from hir_plugins.commands.batch.scheduling.messages import Outcome
from hir_plugins.commands.batch.scheduling.time_estimate import Estimate
from hir_plugins.commands.batch.stage_groups import GROUPS

PATIENCE = Patience(tries=3, first_seconds=2.0, factor=4.0)


def settle(chain: Chain, *outcomes: Outcome) -> list[str]:
    return [chain.settle(outcome, PATIENCE, now=100.0, chance=1.0) for outcome in outcomes]


def test_four_groups_make_a_capture() -> None:
    chain = Chain("cup", "s3://shelf/cup")
    done = Outcome("done", content="c0ffee", seconds={"compute": 2.0})
    last = Outcome("done", record={"psnr": {"object": 30.0}, "thumbnail": "data:"})
    assert settle(chain, done, done, done, last) == ["next group", "next group", "next group", "done"]
    assert chain.state == "done" and chain.content == "c0ffee" and set(chain.seconds) == {g.name for g in GROUPS}
    entry = chain.entry()
    assert entry["psnr"] == {"object": 30.0} and "thumbnail" not in entry and "group" not in entry


def test_trouble_is_tried_again_and_the_count_begins_anew_with_each_group() -> None:
    chain = Chain("cup", "cup")
    died = Outcome("trouble", "the worker's process died")
    assert settle(chain, died) == ["again"] and chain.not_before == 102.0
    assert settle(chain, died) == ["again"] and chain.not_before == 108.0
    assert settle(chain, Outcome("done"), died, died) == ["next group", "again", "again"] and chain.retries == 4
    assert settle(chain, died) == ["failed"]
    assert chain.reason == "geometry: the worker's process died, 3 times" and chain.entry()["group"] == "geometry"


def test_broken_capture_is_never_tried_twice() -> None:
    chain = Chain("cup", "cup")
    assert settle(chain, Outcome("failed", "cup/03.png is cut off", lines=("a traceback",))) == ["failed"]
    assert chain.reason == "initialization: cup/03.png is cut off" and chain.lines == ["a traceback"]
    assert chain.retries == 0 and chain.state == "failed"


def test_unchanged_capture_keeps_what_is_known_of_its_result() -> None:
    chain = Chain("cup", "cup")
    chain.take_result({"content": "c0ffee", "settings": "5e7", "psnr": {"object": 31.0}, "thumbnail": "data:"})
    assert chain.finished == ("c0ffee", "5e7")
    assert settle(chain, Outcome("unchanged", content="c0ffee")) == ["unchanged"]
    assert chain.state == "done" and chain.entry()["psnr"] == {"object": 31.0}


def test_entry_of_an_earlier_call_is_remembered_and_a_damaged_one_does_no_harm() -> None:
    chain = Chain("cup", "cup")
    settle(chain, Outcome("trouble", "the node left"), Outcome("done", content="c0ffee", seconds={"compute": 2.0}))
    again = Chain("cup", "cup")
    again.take_over(chain.entry())
    assert (again.content, again.seconds, again.retries) == ("c0ffee", chain.seconds, 1)
    again.take_over({"seconds": 3, "content": None, "state": []})
    assert again.content == "" and again.state == "waiting" and again.seconds == chain.seconds


def test_estimate_needs_one_of_each_group_and_then_counts_down() -> None:
    estimate, chain = Estimate(), Chain("cup", "cup")
    for group, seconds in enumerate((2.0, 10.0, 30.0)):
        estimate.learn(group, seconds)
    assert estimate.left(chain) is None and estimate.batch_left([chain], 1, 1) is None
    estimate.learn(3, 4.0)
    estimate.learn(1, 12.0)
    assert estimate.left(chain, running=1.0) == 1.0 + 11.0 + 30.0 + 4.0
    chain.group = 2
    assert estimate.left(chain, running=50.0) == 4.0, "a group that takes longer than usual is about to end"
    assert estimate.left(Chain("jug", "jug", state="done")) == 0.0
    assert estimate.batch_left([chain], untouched=3, at_once=2) == (34.0 + 3 * 47.0) / 2
