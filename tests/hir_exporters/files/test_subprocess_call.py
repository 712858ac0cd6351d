"""A function in a process of its own: values there and back, and what its end becomes."""

import os
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.errors import ExportError, InputError
from hir_exporters.files.subprocess_call import Limits, SubprocessCrashError, run_in_subprocess

HERE = "tests.hir_exporters.files.test_subprocess_call"


def echoed(**given: Any) -> dict[str, Any]:
    return {**given, "process": np.asarray(os.getpid())}


def refused() -> dict[str, Any]:
    raise ExportError("x.usdz has no mesh")


def broken() -> dict[str, Any]:
    raise ValueError("nothing of ours")


def ended() -> dict[str, Any]:
    os.abort()


def sleeping() -> dict[str, Any]:
    time.sleep(60)
    return {}


def hungry() -> dict[str, Any]:
    return {"a": np.ones(1 << 30, np.uint8)[:1]}


@pytest.fixture(autouse=True)
def _found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The child finds this file as it finds everything else: by the path of its parent."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent.parent))


def test_arrays_numbers_and_words_come_back_from_another_process() -> None:
    given = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "n": 3, "word": "größer.usdz"}
    found = run_in_subprocess(f"{HERE}:echoed", given)
    np.testing.assert_array_equal(found["a"], given["a"])
    assert found["a"].dtype == np.float32 and int(found["n"]) == 3 and str(found["word"]) == "größer.usdz"
    assert int(found["process"]) != os.getpid()


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [
        ("refused", InputError, "^x.usdz has no mesh$"),
        ("broken", SubprocessCrashError, "^ValueError: nothing of ours$"),
        ("ended", SubprocessCrashError, "^exit code -6$"),
        ("missing", SubprocessCrashError, "has no attribute 'missing'"),
    ],
)
def test_its_end_is_one_sentence(name: str, error: type[Exception], words: str) -> None:
    if name == "ended" and os.name != "posix":
        pytest.skip("signals")
    with pytest.raises(error, match=words):
        run_in_subprocess(f"{HERE}:{name}", {})


def test_nothing_that_needs_unpickling_comes_back() -> None:
    with pytest.raises(SubprocessCrashError, match=r"allow_pickle|Object arrays"):
        run_in_subprocess(f"{HERE}:echoed", {"a": np.array([{}], object)})


def test_a_subprocess_ends_where_it_takes_too_long() -> None:
    started = time.monotonic()
    with pytest.raises(SubprocessCrashError, match="more than 1 seconds"):
        run_in_subprocess(f"{HERE}:sleeping", {}, Limits(seconds=1, memory_bytes=8 << 30))
    assert time.monotonic() - started < 30


@pytest.mark.skipif(sys.platform != "linux", reason="the system does not limit memory")
def test_a_subprocess_gets_no_more_memory() -> None:
    assert run_in_subprocess(f"{HERE}:hungry", {})["a"].tolist() == [1]
    with pytest.raises(SubprocessCrashError, match=r"MemoryError|allocate"):
        run_in_subprocess(f"{HERE}:hungry", {}, Limits(seconds=60, memory_bytes=1 << 30))
