"""Files of a finished run that were changed, deleted or added are noticed by `--resume` and written again."""

from __future__ import annotations

import json
import random
import shutil
import time
from pathlib import Path

import pytest

from hir_core.config import RunConfig
from hir_core.files.file_checksums import changed_file, checksums, regular_files
from hir_core.pipeline import Run
from hir_core.report import pictures_damage
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory

CLOCKED = {"timings.json", "report.html", "log.txt", ".lock"}
WRITTEN_ANEW = {"run.json", "capture/cameras.json"}
"""Files that every call writes from the stages' own."""
SIDE = RunConfig().report_side


def files_of(run: Path) -> dict[str, bytes]:
    """Files that must be the same after a resume, without those that contain times."""
    return {
        path.relative_to(run).as_posix(): path.read_bytes()
        for path in sorted(run.rglob("*"))
        if path.is_file() and path.name not in CLOCKED and "work" not in path.relative_to(run).parts
    }


def noticed(run: Path) -> bool:
    """Is any file of the run not as a stage or the report wrote it?"""
    directory = RunDirectory(run)
    records = [directory.record(name) for name in STAGE_NAMES]
    return any(r is None or directory.damage(r) for r in records) or pictures_damage(directory, SIDE) is not None


def flip(path: Path, offset: int) -> None:
    content = bytearray(path.read_bytes())
    content[offset] ^= 1 + offset % 255
    path.write_bytes(content)


@pytest.mark.slow
def test_a_flipped_byte_in_any_file_of_a_run_is_noticed(finished: Run, tmp_path: Path) -> None:
    run = tmp_path / "run"
    shutil.copytree(finished.path, run)
    assert not noticed(run)
    tried = 0
    for name, content in files_of(run).items():
        if name in WRITTEN_ANEW:
            continue
        size = len(content)
        for offset in sorted({0, size // 7, size // 3, size // 2, 5 * size // 6, size - 1}):
            flip(run / name, offset)
            assert noticed(run), f"byte {offset} of {name}"
            (run / name).write_bytes(content)
            tried += 1
    assert tried > 150 and not noticed(run)


def flip_random_bit(path: Path, draw: random.Random) -> str:
    """Changes one bit; returns what was changed."""
    content = bytearray(path.read_bytes())
    offset, bit = draw.randrange(len(content)), draw.randrange(8)
    content[offset] ^= 1 << bit
    path.write_bytes(content)
    return f"bit {bit} of byte {offset} of {path}"


RANDOM_FLIPS = 256


@pytest.mark.slow
def test_random_bits_of_a_run_are_noticed(finished: Run, tmp_path: Path) -> None:
    """Files are drawn alike, large or small; the files that every call writes anew have a test of their own."""
    run, draw = tmp_path / "run", random.Random(0)
    shutil.copytree(finished.path, run)
    whole = {name: content for name, content in files_of(run).items() if name not in WRITTEN_ANEW}
    flipped = set()
    for _ in range(RANDOM_FLIPS):
        name = draw.choice(sorted(whole))
        changed = flip_random_bit(run / name, draw)
        assert noticed(run), changed
        (run / name).write_bytes(whole[name])
        flipped.add(name)
    folders = {Path(name).parts[0] for name in flipped}
    assert {"stages", "scene", "exports", "report"} <= folders and len(flipped) > 0.9 * len(whole)


@pytest.mark.slow
def test_random_bits_of_files_that_every_call_writes_change_nothing(
    tiny_capture: Path,
    quick,  # type: ignore[no-untyped-def]
    finished: Run,
    tmp_path: Path,
) -> None:
    run, whole, draw = tmp_path / "run", files_of(finished.path), random.Random(0)
    shutil.copytree(finished.path, run)
    for _ in range(6):
        for name in (*sorted(WRITTEN_ANEW), "timings.json", "log.txt"):
            changed = flip_random_bit(run / name, draw)
            again = quick(tiny_capture, run, deterministic=True, resume=True)
            assert again.reused == STAGE_NAMES and files_of(run) == whole, changed


def test_times_of_stages_that_are_damaged_are_left_out(
    tiny_capture: Path,
    quick,  # type: ignore[no-untyped-def]
    finished: Run,
    tmp_path: Path,
) -> None:
    """A document that is sound JSON with other keys or values: a resumed run ends, and names what it lost."""
    run = tmp_path / "run"
    shutil.copytree(finished.path, run)
    document = json.loads((run / "timings.json").read_text())
    stages = document["stages"]
    stages["initializer"]["secondt"] = stages["initializer"].pop("seconds")
    stages["geometry"]["milestones"] = [["MODEL", "soon"]]
    stages["atlas"]["seconds"] = float("inf")
    stages["bake"]["peak_memory_bytes"] = "much"
    (run / "timings.json").write_text(json.dumps(document))
    said: list[str] = []
    again = quick(tiny_capture, run, deterministic=True, resume=True, on_message=said.append)
    assert again.reused == STAGE_NAMES and files_of(run) == files_of(finished.path)
    assert any("times of" in text and "lost" in text for text in said)
    kept = json.loads((run / "timings.json").read_text())
    assert not {"initializer", "geometry", "atlas", "bake"} & set(kept["stages"])
    assert kept["report"] == document["report"], "its pictures were right"
    for damaged in ({"seconds": 1.0}, {"seconds": "soon", "processor_seconds": 1.0}, 7):
        (run / "timings.json").write_text(json.dumps(kept | {"report": damaged}))
        quick(tiny_capture, run, deterministic=True, resume=True)
        assert "report" not in json.loads((run / "timings.json").read_text()), damaged


@pytest.mark.slow
def test_a_run_with_a_damaged_bit_in_every_file_has_the_bytes_of_the_first_again(
    tiny_capture: Path,
    quick,  # type: ignore[no-untyped-def]
    finished: Run,
    tmp_path: Path,
) -> None:
    run, whole, draw = tmp_path / "run", files_of(finished.path), random.Random(0)
    shutil.copytree(finished.path, run)
    for name in whole:
        flip_random_bit(run / name, draw)
    again = quick(tiny_capture, run, deterministic=True, resume=True)
    assert again.reused == () and files_of(run) == whole


@pytest.mark.slow
def test_a_resumed_run_with_damaged_files_has_the_bytes_of_the_first(
    tiny_capture: Path,
    quick,  # type: ignore[no-untyped-def]
    finished: Run,
    tmp_path: Path,
) -> None:
    run, whole = tmp_path / "run", files_of(finished.path)
    shutil.copytree(finished.path, run)
    glb, mesh = run / "exports" / f"{tiny_capture.name}.glb", run / "scene" / "mesh.ply"
    arrays, picture = RunDirectory(run).stage("atlas") / "scene" / "arrays.npz", next((run / "report").glob("*.png"))
    glb.unlink()
    for path in (mesh, arrays, picture, run / "run.json", run / "timings.json"):
        flip(path, path.stat().st_size // 2)
    said: list[str] = []
    again = quick(tiny_capture, run, deterministic=True, resume=True, on_message=said.append)
    assert again.reused == ("initializer", "geometry", "reflectance")
    for path in (glb, mesh, arrays):
        assert any(str(path) in sentence for sentence in said), path
    found = files_of(run)
    assert found.keys() == whole.keys()
    assert [name for name in whole if found[name] != whole[name]] == []


@pytest.mark.slow
def test_a_garbled_export_and_picture_are_written_again_and_nothing_else(
    tiny_capture: Path,
    quick,  # type: ignore[no-untyped-def]
    finished: Run,
    tmp_path: Path,
) -> None:
    run, whole = tmp_path / "run", files_of(finished.path)
    shutil.copytree(finished.path, run)
    picture = next((run / "report").glob("*.png"))
    flip(run / "exports" / f"{tiny_capture.name}.glb", 1000)
    flip(picture, 100)
    said: list[str] = []
    again = quick(tiny_capture, run, deterministic=True, resume=True, on_message=said.append)
    assert again.reused == STAGE_NAMES[:-1] and files_of(run) == whole
    assert any(sentence.startswith("report: ") and str(picture) in sentence for sentence in said)


def test_a_run_of_100_megabytes_is_verified_within_a_second(tmp_path: Path) -> None:
    block = bytes(range(256)) * 4096
    for number in range(10):
        (tmp_path / f"{number}.exr").write_bytes(block * 10)
    written = checksums(tmp_path, regular_files(tmp_path))
    started = time.process_time()
    assert changed_file(tmp_path, written) is None and len(written) == 10
    assert time.process_time() - started < 1.0
