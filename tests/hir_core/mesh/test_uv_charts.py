"""Charts of small and large meshes: valid, as good as those of xatlas alone; xatlas in a process of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hir_exporters.files.subprocess_call import Arrays, SubprocessCrashError, run_in_subprocess
from hir_exporters.textures.uv_rasterization import rasterize_triangles

from hir_core.errors import StageError
from hir_core.mesh import uv_charts
from hir_core.mesh.conformal_maps import signed_areas, stretch
from hir_core.mesh.uv_charts import FACES_IN_PROCESS, cut_and_pack, run_simplified, run_xatlas
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


@pytest.mark.slow
def test_native_code_that_keeps_pythons_lock_does_not_hold_up_other_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """xatlas works on this mesh for some seconds; beside it, in this process, the second thread got no turn at all."""
    monkeypatch.setattr(uv_charts, "SIMPLIFIED_FROM", 1 << 30)
    mesh = bumpy_sphere(4)
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


@pytest.fixture
def few_coarse_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small meshes are simplified as far as large ones."""
    monkeypatch.setattr(uv_charts, "COARSE_FACES", 900)


def noisy_sphere(noise: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """A bumpy sphere of 5,120 triangles in the unit box, each vertex moved by about `noise` edges."""
    mesh = bumpy_sphere(4)
    positions, faces = mesh.positions.double().numpy(), mesh.faces.numpy()
    edge = np.linalg.norm(positions[faces[:, 0]] - positions[faces[:, 1]], axis=1).mean()
    outward = positions / np.linalg.norm(positions, axis=1, keepdims=True)
    moved = positions + noise * edge * np.random.default_rng(0).normal(size=(len(positions), 1)) * outward
    low, high = moved.min(axis=0), moved.max(axis=0)
    return ((moved - low) / (high - low).max()).astype(np.float32), faces.astype(np.uint32)


def overlapping_texels(atlas: Arrays, side: int = 512) -> int:
    corners = atlas["uvs"].astype(np.float64)[atlas["faces"].astype(np.int64)] * side
    return int(rasterize_triangles(corners, side, side, single=True)[2])


def seam_length(positions: np.ndarray, faces: np.ndarray, uv_faces: np.ndarray) -> float:
    """Length of the edges whose two faces have different coordinates there."""
    corners: dict[tuple[int, int], tuple[int, int]] = {}
    total = 0.0
    for face, uv_face in zip(faces.tolist(), uv_faces.tolist(), strict=True):
        for k in range(3):
            a, b = face[k], face[(k + 1) % 3]
            corners[a, b] = uv_face[k], uv_face[(k + 1) % 3]
    for (a, b), (s, t) in corners.items():
        if a < b and corners.get((b, a)) != (t, s):
            total += float(np.linalg.norm(positions[a] - positions[b]))
    return total


@pytest.mark.usefixtures("few_coarse_faces")
def test_charts_of_a_simplified_copy_are_valid_and_better_than_those_of_the_noise() -> None:
    """No texel is covered twice, every face has an area, and seams and stretch are below those of xatlas alone."""
    positions, faces = noisy_sphere()
    ours, theirs = run_simplified(positions, faces, 512, 4), run_xatlas(positions, faces, 512, 4)
    assert ours["faces"].shape == faces.shape
    assert ours["uvs"].min() >= 0 and ours["uvs"].max() <= 1
    assert overlapping_texels(ours) == 0
    length = {name: seam_length(positions, faces, a["faces"]) for name, a in (("ours", ours), ("xatlas", theirs))}
    assert length["ours"] < 0.8 * length["xatlas"]
    measured = [
        stretch(positions.astype(np.float64), faces.astype(np.int64), a["uvs"].astype(np.float64), a["faces"])
        for a in (ours, theirs)
    ]
    assert measured[0] < measured[1]
    assert int(ours["charts"]) < int(theirs["charts"])


@pytest.mark.usefixtures("few_coarse_faces")
def test_charts_of_a_simplified_copy_are_the_same_twice() -> None:
    mesh = noisy_sphere()
    first, second = run_simplified(*mesh, 256, 2), run_simplified(*mesh, 256, 2)
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])


@pytest.mark.usefixtures("few_coarse_faces")
def test_open_degenerate_and_non_manifold_meshes_have_coordinates_for_every_face() -> None:
    """A sphere with a hole, a face without area, a fin on an edge that has two faces already, and a lone small part."""
    positions, faces = noisy_sphere(0.0)
    open_faces = faces[60:]
    a, b, c = (int(i) for i in open_faces[0])
    count = len(positions)
    part = positions[faces[:1].reshape(-1)] * 0.1 + 2
    fin = [[a, b, count], [a, a, c], [count + 1, count + 2, count + 3]]
    added = np.concatenate([positions, positions[a : a + 1] * 1.1, part]).astype(np.float32)
    all_faces = np.concatenate([open_faces, np.array(fin, np.uint32)])
    atlas = run_simplified(added, all_faces, 256, 2)
    assert atlas["faces"].shape == all_faces.shape
    assert np.isfinite(atlas["uvs"]).all() and overlapping_texels(atlas, 256) == 0
    area = np.abs(signed_areas(atlas["uvs"].astype(np.float64), atlas["faces"].astype(np.int64)))
    proper = np.ones(len(all_faces), dtype=bool)
    proper[-2] = False
    assert (area[proper] > 0).mean() > 0.999


def test_large_meshes_are_charted_on_a_simplified_copy(monkeypatch: pytest.MonkeyPatch) -> None:
    called = []

    def recorded(target: str, arguments: dict[str, Any]) -> Arrays:
        called.append(target.rpartition(":")[2])
        faces = arguments["faces"]
        return {"faces": faces, "uvs": np.zeros((int(faces.max()) + 1, 2)), "charts": np.asarray(1)}

    monkeypatch.setattr(uv_charts, "run_in_subprocess", recorded)
    for subdivisions in (5, 6):
        mesh = bumpy_sphere(subdivisions)
        cut_and_pack(mesh.positions.numpy(), mesh.faces.numpy()[:40_000], 64, 1)
    monkeypatch.setattr(uv_charts, "SIMPLIFIED_FROM", 50_000)
    cut_and_pack(mesh.positions.numpy(), mesh.faces.numpy()[:40_000], 64, 1)
    assert called == ["run_simplified", "run_simplified", "run_xatlas"]
