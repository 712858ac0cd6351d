"""xatlas gives the same atlas in a process of its own, while other threads continue."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hir_exporters.files.subprocess_call import SubprocessCrashError, run_in_subprocess

from hir_core.errors import StageError
from hir_core.mesh import uv_charts
from hir_core.mesh.uv_charts import FACES_IN_PROCESS, cut_and_pack, run_xatlas
from tests.fixtures.scenes import bumpy_sphere


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
    mesh = bumpy_sphere(5)
    positions, faces = mesh.positions.numpy(), mesh.faces.numpy()
    assert len(faces) > FACES_IN_PROCESS
    alone: list[Any] = []
    assert ticks_during(lambda: alone.append(cut_and_pack(positions, faces, 256, 2))) >= 3
    uv_faces, uvs, charts = alone[0]
    assert uvs.min() >= 0 and uvs.max() <= 1 and charts > 1
    small = bumpy_sphere(3)
    given = {"faces": small.faces.numpy().astype(np.uint32), "resolution": 128, "padding": 2}
    here = run_xatlas(positions=small.positions.numpy(), **given)
    there = run_in_subprocess("hir_core.mesh.uv_charts:run_xatlas", {"positions": small.positions.numpy(), **given})
    for name in here:
        np.testing.assert_array_equal(here[name], there[name])
    assert uv_faces.shape == faces.shape


def test_an_end_without_an_atlas_is_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    def ended(target: str, given: object) -> None:
        raise SubprocessCrashError("exit code -11")

    monkeypatch.setattr(uv_charts, "run_in_subprocess", ended)
    mesh = bumpy_sphere(5)
    with pytest.raises(StageError, match=r"xatlas ended without an atlas \(exit code -11\); repair the mesh"):
        cut_and_pack(mesh.positions.numpy(), mesh.faces.numpy(), 64, 1)
