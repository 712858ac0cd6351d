"""Kill -9 at any moment, then `--resume`: the same files. `make kill-test` kills 70 runs, these tests 16."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hir_exporters.files.atomic import atomic_directory, atomic_path, is_partial

from hir_core.run.run_directory import RunDirectory, claimed_run
from tests.fixtures.runs import QUICK

ROOT = Path(__file__).resolve().parents[2]
pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals and fork")


def _kill_test(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, ROOT / "tools" / "kill_test.py", *arguments],
        capture_output=True,
        text=True,
        timeout=7200,  # a bound for a hang, not for speed
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "kills"), [("cached", "8"), ("traced", "4"), ("sfm", "4")])
def test_killed_runs_end_with_the_same_files(kind: str, kills: str) -> None:
    assert f"{kills} of {kills} the same" in _kill_test("--kills", kills, "--kind", kind)


def _command(capture: Path, run: Path, *arguments: str) -> list[str]:
    settings = [word for assignment in QUICK for word in ("--set", assignment)]
    return [sys.executable, "-m", "hir_core.cli", "reconstruct", str(capture), "-o", str(run), *settings, *arguments]


def _until(condition, process: subprocess.Popen[str]) -> None:  # type: ignore[no-untyped-def,type-arg]
    started = time.monotonic()
    while not condition():
        # bounds for a hang, not for speed: other tests may have the processors
        assert process.poll() is None and time.monotonic() - started < 600
        time.sleep(0.02)


@pytest.mark.slow
def test_a_killed_command_goes_on_inside_its_stage(tiny_capture: Path, tmp_path: Path) -> None:
    """The real command: SIGKILL after the geometry stage has stored a checkpoint; the resumed run continues from it."""
    run = tmp_path / "run"
    arguments = _command(
        tiny_capture, run, "--until", "geometry", "--deterministic", "--set", "checkpoint_seconds=0.05"
    )
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True) as process:
        kept = run / "stages" / "2-geometry" / "work" / "checkpoints"
        _until(lambda: kept.is_dir() and any(kept.glob("*.npz")), process)
        process.send_signal(signal.SIGKILL)
        process.wait()
    done = subprocess.run([*arguments, "--resume"], capture_output=True, text=True, check=True)
    assert "initializer: reused" in done.stderr and "geometry: computed again" in done.stderr
    assert not kept.exists(), "states go when their stage has ended"
    whole = _command(tiny_capture, tmp_path / "whole", "--until", "geometry", "--deterministic")
    subprocess.run(whole, capture_output=True, check=True)
    scenes = [folder / "stages" / "2-geometry" / "scene" / "arrays.npz" for folder in (run, tmp_path / "whole")]
    assert scenes[0].read_bytes() == scenes[1].read_bytes()


@pytest.mark.slow
def test_a_second_process_on_one_run_is_refused(tiny_capture: Path, tmp_path: Path) -> None:
    run = tmp_path / "run"
    arguments = _command(tiny_capture, run, "--set", "geometry.iterations=100000")
    with subprocess.Popen(arguments, stderr=subprocess.PIPE, text=True) as process:
        _until(lambda: (run / "run.json").exists(), process)
        second = subprocess.run([*arguments, "--resume"], capture_output=True, text=True)
        assert second.returncode == 2 and "another process works on" in second.stderr
        assert process.poll() is None, "the first goes on"
        process.kill()


def test_what_a_killed_write_leaves_is_removed_and_never_read(tmp_path: Path) -> None:
    """A process that dies between the temporary file and its rename."""
    code = (
        "import os, sys\nfrom pathlib import Path\n"
        "from hir_exporters.files.atomic import atomic_path, atomic_directory\n"
        "place = Path(sys.argv[1])\n"
        "with atomic_directory(place / 'stages') as folder:\n"
        "    (folder / 'half').write_text('half')\n"
        "    with atomic_path(place / 'run.json') as path:\n"
        "        path.write_text('{\"half\":')\n"
        "        os.kill(os.getpid(), 9)\n"
    )
    for _ in range(2):
        assert subprocess.run([sys.executable, "-c", code, str(tmp_path)]).returncode == -signal.SIGKILL
    left = sorted(tmp_path.iterdir())
    assert len(left) == 4 and all(is_partial(path) for path in left)
    with claimed_run(tmp_path, resume=False) as run:
        assert not [p for p in run.path.iterdir() if p.name != ".lock"], "an empty folder again"


def test_an_old_folder_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    with atomic_directory(tmp_path / "a") as folder:
        (folder / "x").write_text("old")
    with pytest.raises(KeyboardInterrupt), atomic_directory(tmp_path / "a") as folder:
        (folder / "x").write_text("new")
        raise KeyboardInterrupt
    assert (tmp_path / "a" / "x").read_text() == "old" and len(list(tmp_path.iterdir())) == 1
    with pytest.raises(KeyboardInterrupt), atomic_path(tmp_path / "b.txt") as path:
        path.write_text("half")
        raise KeyboardInterrupt
    assert not (tmp_path / "b.txt").exists() and len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
def test_a_damaged_result_is_computed_again(tiny_capture: Path, quick, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    run = quick(tiny_capture, tmp_path / "run", until="geometry", deterministic=True)
    stored = RunDirectory(run.path).stage("initializer") / "scene" / "arrays.npz"
    whole = stored.read_bytes()
    stored.write_bytes(whole[: len(whole) // 2])
    message: list[str] = []
    again = quick(tiny_capture, run.path, until="geometry", deterministic=True, resume=True, on_message=message.append)
    assert any("initializer: its stored result is damaged" in sentence for sentence in message)
    assert stored.read_bytes() == whole and again.reused == ("geometry",), "the same again, so what follows holds"
