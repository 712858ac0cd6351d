"""Ctrl-C ends a command within two seconds at any point, and the run can be resumed."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hir_core.run.interrupt import MAX_EXIT_SECONDS
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory
from tests.fixtures.runs import QUICK

pytestmark = pytest.mark.skipif(os.name != "posix", reason="signals")

LIMIT_SECONDS = 2.0

NATIVE = """
import sys
from functools import partial
from hir_core.cli.app import _exit_at_once
from hir_core.run.interrupt import remember_interrupts

remember_interrupts(partial(_exit_at_once, ['reconstruct']))
import torch
torch.set_num_threads(1)
a = torch.rand(9000, 9000)
print("ready", flush=True)
{call}
"""
"""A call into native code of a minute or more, in which Python handles no signal."""


@pytest.mark.slow
def test_a_call_into_native_code_does_not_hold_it_up() -> None:
    assert MAX_EXIT_SECONDS < LIMIT_SECONDS
    code = NATIVE.format(call="torch.linalg.svdvals(a)")
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None and child.stderr is not None
        assert child.stdout.readline() == "ready\n"
        time.sleep(0.5)
        child.send_signal(signal.SIGINT)
        started = time.monotonic()
        assert child.wait(timeout=60) == 130
        took = time.monotonic() - started
        assert "--resume" in child.stderr.read()
    assert took < LIMIT_SECONDS + 1, "a second more than is promised: other tests may have the processors"


@pytest.mark.parametrize(
    ("command", "sentence"),
    [("check", "hir: interrupted\n"), ("reconstruct", "hir: interrupted; continue the run with --resume\n")],
)
def test_an_interrupted_command_says_one_sentence(
    command: str, sentence: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """`hir check` has no --resume to continue with."""
    from hir_core.cli import app

    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(app.cli, "main", interrupted)
    with pytest.raises(SystemExit) as ended:
        app.main([command, "folder"])
    assert ended.value.code == 130 and capsys.readouterr().err == sentence


def test_an_import_is_finished_before_the_command_ends(tmp_path: Path) -> None:
    """An exception while native code is initialised aborts the process, or the code makes an `ImportError` of it."""
    slow = "import time\nprint('ready', flush=True)\ntime.sleep(0.7)\nprint('imported', flush=True)\n"
    (tmp_path / "slow_module.py").write_text(slow)
    code = (
        "from functools import partial\nimport time\n"
        "from hir_core.cli.app import _exit_at_once\nfrom hir_core.run.interrupt import remember_interrupts\n"
        "remember_interrupts(partial(_exit_at_once, ['reconstruct']))\nimport slow_module\ntime.sleep(60)\n"
    )
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
    ) as child:
        assert child.stdout is not None and child.stderr is not None
        assert child.stdout.readline() == "ready\n"
        child.send_signal(signal.SIGINT)
        assert child.wait(timeout=60) == 130
        assert child.stdout.read() == "imported\n"
        assert child.stderr.read() == "hir: interrupted; continue the run with --resume\n"


def test_an_import_error_after_an_interrupt_is_no_bug(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from hir_core.cli import app

    def failed(*_: object, **__: object) -> None:
        raise ImportError("initialization failed")

    def leave(command_line: list[str]) -> None:
        raise SystemExit(app.INTERRUPTED)

    monkeypatch.setattr(app.cli, "main", failed)
    monkeypatch.setattr(app, "remember_interrupts", lambda leave: None)
    monkeypatch.setattr(app, "_exit_at_once", leave)
    monkeypatch.setattr(sys, "argv", ["hir", "reconstruct", "folder"])
    for interrupted, code in ((True, app.INTERRUPTED), (False, 1)):
        monkeypatch.setattr(app, "was_interrupted", lambda value=interrupted: value)
        with pytest.raises(SystemExit) as ended:
            app.main()
        assert ended.value.code == code
        assert ("this is a bug: ImportError" in capsys.readouterr().err) == (not interrupted)


@pytest.mark.slow
def test_any_moment_of_a_run_ends_in_time_and_resumes(tiny_capture: Path, tmp_path: Path) -> None:
    """Twelve interrupts of a run that is resumed after each; after its end a new run starts."""
    settings = [word for assignment in QUICK for word in ("--set", assignment)]
    arguments = [
        sys.executable,
        "-m",
        "hir_core.cli",
        "reconstruct",
        str(tiny_capture),
        "-o",
        str(tmp_path / "run"),
        *settings,
        "--resume",
        "--deterministic",
        "--set",
        "checkpoint_seconds=0.2",
    ]
    draw, slowest, interrupted = random.Random(0), 0.0, 0
    for _ in range(12):
        with subprocess.Popen(arguments, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as child:
            time.sleep(draw.uniform(2.5, 9.0))  # after the imports, in which Python is not ours yet
            child.send_signal(signal.SIGINT)
            started = time.monotonic()
            code = child.wait(timeout=60)
            took = time.monotonic() - started
            output = child.stderr.read() if child.stderr else ""
        if code == 130:
            interrupted += 1
            slowest = max(slowest, took)
        else:
            # nothing left to interrupt: the run has ended, and Python, which gives signals back to the system before
            # it takes its modules apart, at most ends by the signal itself
            assert code in (0, -signal.SIGINT) and _has_ended(tmp_path / "run"), output
            shutil.rmtree(tmp_path / "run")
    print(f"{interrupted} of 12 interrupted while they worked, slowest {slowest:.2f} s")
    assert interrupted >= 6 and slowest < LIMIT_SECONDS
    done = subprocess.run(arguments, capture_output=True, text=True)
    assert done.returncode == 0 and _has_ended(tmp_path / "run"), done.stderr


def _has_ended(run: Path) -> bool:
    """Whether every stage has ended and the report exists."""
    records = [RunDirectory(run).record(name) for name in STAGE_NAMES]
    return all(record is not None and record.finished for record in records) and (run / "report.html").exists()
