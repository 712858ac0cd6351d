"""A full disk and a read-only folder give one sentence, and existing files stay intact."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hir_exporters.errors import HirError
from hir_exporters.scene_format import load_scene, save_scene

from hir_core.pipeline import Run
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory
from tests.reliability import seeds

MOST_SCENE = 3 << 20


@contextlib.contextmanager
def small_disk(folder: Path, size: str, options: str = "") -> Iterator[Path]:
    """A file system of `size` in memory at `folder`; skips where mounting is not allowed."""
    folder.mkdir(exist_ok=True)
    arguments = ["mount", "-t", "tmpfs", "-o", f"size={size}{options}", "tmpfs", str(folder)]
    done = subprocess.run(arguments, capture_output=True, text=True)
    if done.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {done.stderr.strip()}")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="tmpfs")
def test_a_full_disk_ends_a_run_in_one_sentence_and_the_run_goes_on_when_there_is_room(
    tiny_capture: Path, finished: Run, quick: Callable[..., Run], tmp_path: Path
) -> None:
    needed = sum(p.stat().st_size for p in finished.path.rglob("*") if p.is_file())
    with small_disk(tmp_path / "disk", f"{needed // 2048}k") as disk:
        with pytest.raises(HirError, match="space") as found:
            quick(tiny_capture, disk / "run", deterministic=True)
        assert "\n" not in str(found.value)
        run = RunDirectory(disk / "run")
        ended = [name for name in STAGE_NAMES if (record := run.record(name)) is not None and record.finished]
        assert ended, "half of a run fits"
        subprocess.run(["mount", "-o", "remount,size=100m", str(disk)], check=True)
        again = quick(tiny_capture, disk / "run", deterministic=True, resume=True)
        assert set(ended) <= set(again.reused)
        same = [p.relative_to(finished.directory.scene) for p in finished.directory.scene.iterdir()]
        for name in same:
            assert (again.directory.scene / name).read_bytes() == (finished.directory.scene / name).read_bytes()


@pytest.mark.skipif(sys.platform != "linux", reason="tmpfs")
def test_a_full_disk_leaves_an_older_scene_as_it_was(tmp_path: Path) -> None:
    asset = seeds.asset()
    with small_disk(tmp_path / "disk", "64k") as disk:
        save_scene(asset, disk / "scene")
        before = {p.name: p.read_bytes() for p in (disk / "scene").iterdir()}
        (disk / "filler").write_bytes(os.urandom(24 << 10))
        with pytest.raises(HirError, match="No space left"):
            for _ in range(4):
                save_scene(asset, disk / "scene-2")
                (disk / "scene-2").rename(disk / f"kept-{os.urandom(2).hex()}")
        assert {p.name: p.read_bytes() for p in (disk / "scene").iterdir()} == before
        load_scene(disk / "scene")


@pytest.mark.skipif(sys.platform != "linux", reason="tmpfs")
def test_a_read_only_folder_is_one_sentence(tiny_capture: Path, quick: Callable[..., Run], tmp_path: Path) -> None:
    with small_disk(tmp_path / "disk", "1m") as disk:
        subprocess.run(["mount", "-o", "remount,ro", str(disk)], check=True)
        with pytest.raises(HirError, match=r"cannot write.*Read-only file system"):
            quick(tiny_capture, disk / "run")
        with pytest.raises(HirError, match="Read-only file system"):
            save_scene(seeds.asset(), disk / "scene")


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full")
def test_a_log_on_a_full_disk_loses_its_line_and_not_the_run(tmp_path: Path) -> None:
    from hir_core.run.run_log import write_log

    (tmp_path / "log.txt").symlink_to("/dev/full")
    write_log(tmp_path / "log.txt", "a sentence")
