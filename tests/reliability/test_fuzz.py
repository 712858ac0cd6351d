"""Readers read mutated files or refuse them with one sentence (`make fuzz` runs this for minutes)."""

from __future__ import annotations

import random
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.reliability.fuzz_targets import TARGETS, Target, remove_folders
from tests.reliability.mutations import mutated

SECONDS = 5.0
"""An upper limit for each of these small files on a busy machine."""


@pytest.fixture(scope="module", autouse=True)
def _tidy() -> Iterator[None]:
    yield
    remove_folders()


@pytest.mark.filterwarnings("ignore:clip.mp4 gives only")
@pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.name)
def test_a_whole_file_is_read(target: Target) -> None:
    assert target(target.seeds()[0]) or target.name == "video", "the seed is a file that can be read"


@pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.name)
def test_changed_files_are_read_or_refused_in_one_sentence(target: Target) -> None:
    seeds = target.seeds()

    @settings(
        max_examples=4 if target.slow else 15,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.integers(0, 2**32))
    def attack(number: int) -> None:
        rng = random.Random(number)
        data = mutated(rng.choice(seeds), rng)
        started = time.monotonic()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            target(data)
        assert time.monotonic() - started < SECONDS, "hangs"

    attack()


@pytest.mark.filterwarnings("ignore:clip.mp4 gives only")
@pytest.mark.parametrize("target", TARGETS, ids=lambda t: t.name)
def test_empty_and_random_files(target: Target, tmp_path: Path) -> None:
    for data in (b"", b"\0" * 64, b"{}", b"[]", b"null", bytes(random.Random(0).randrange(256) for _ in range(512))):
        target(data)
