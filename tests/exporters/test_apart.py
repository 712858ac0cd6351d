"""A function in a process of its own: values there and back, and what its end becomes."""

import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.apart import ChildError, call_apart
from hir_exporters.errors import ExportError, InputError

HERE = "tests.exporters.test_apart"


def echoed(**given: Any) -> dict[str, Any]:
    return {**given, "process": np.asarray(os.getpid())}


def refused() -> dict[str, Any]:
    raise ExportError("x.usdz has no mesh")


def broken() -> dict[str, Any]:
    raise ValueError("nothing of ours")


def ended() -> dict[str, Any]:
    os.abort()


@pytest.fixture(autouse=True)
def _found(monkeypatch: pytest.MonkeyPatch) -> None:
    """The child finds this file as it finds everything else: by the path of its parent."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent.parent.parent))


def test_arrays_numbers_and_words_come_back_from_another_process() -> None:
    given = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "n": 3, "word": "größer.usdz"}
    found = call_apart(f"{HERE}:echoed", given)
    np.testing.assert_array_equal(found["a"], given["a"])
    assert found["a"].dtype == np.float32 and int(found["n"]) == 3 and str(found["word"]) == "größer.usdz"
    assert int(found["process"]) != os.getpid()


@pytest.mark.parametrize(
    ("name", "error", "words"),
    [("refused", InputError, "^x.usdz has no mesh$"), ("broken", ChildError, "^ValueError: nothing of ours$"),
     ("ended", ChildError, "^exit code -6$"), ("missing", ChildError, "has no attribute 'missing'")],
)  # fmt: skip
def test_its_end_is_one_sentence(name: str, error: type[Exception], words: str) -> None:
    if name == "ended" and os.name != "posix":
        pytest.skip("signals")
    with pytest.raises(error, match=words):
        call_apart(f"{HERE}:{name}", {})


def test_nothing_that_needs_unpickling_comes_back() -> None:
    with pytest.raises(ChildError, match=r"allow_pickle|Object arrays"):
        call_apart(f"{HERE}:echoed", {"a": np.array([{}], object)})


def ticks_during(work: Callable[[], object]) -> int:
    """How often a second thread came to its turn, five times a second at most."""
    count, going = 0, True

    def tick() -> None:
        nonlocal count
        while going:
            time.sleep(0.2)
            count += 1

    thread = threading.Thread(target=tick)
    thread.start()
    work()
    going = False
    thread.join()
    return count


def test_native_code_that_keeps_pythons_lock_does_not_hold_up_other_threads() -> None:
    """xatlas works on this mesh for some seconds; beside it, in this process, the second thread got no turn at all."""
    from hir_core.charts import SMALL, cut_and_pack, run_xatlas
    from tests.reflectance.shapes import bumpy_sphere

    mesh = bumpy_sphere(5)
    positions, faces = mesh.positions.numpy(), mesh.faces.numpy()
    assert len(faces) > SMALL
    alone: list[Any] = []
    assert ticks_during(lambda: alone.append(cut_and_pack(positions, faces, 256, 2))) >= 3
    uv_faces, uvs, charts = alone[0]
    assert uvs.min() >= 0 and uvs.max() <= 1 and charts > 1
    small = bumpy_sphere(3)
    given = {"faces": small.faces.numpy().astype(np.uint32), "resolution": 128, "padding": 2}
    here = run_xatlas(positions=small.positions.numpy(), **given)
    there = call_apart("hir_core.charts:run_xatlas", {"positions": small.positions.numpy(), **given})
    for name in here:
        np.testing.assert_array_equal(here[name], there[name])
    assert uv_faces.shape == faces.shape
