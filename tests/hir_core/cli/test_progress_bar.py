"""The progress bar: durations as text, one bar per stage, lines where there is no terminal."""

from __future__ import annotations

import numpy as np
import pytest

from hir_core.plugins.progress import Progress
from hir_core.terminal.progress_bar import ProgressBar, time_text


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.4, "0 s"),
        (59.4, "59 s"),
        (59.6, "1 min 00 s"),
        (125, "2 min 05 s"),
        (3599.4, "59 min 59 s"),
        (7380, "2 h 03 min"),
    ],
)
def test_times_in_words(seconds: float, text: str) -> None:
    assert time_text(seconds) == text


def test_each_stage_has_a_bar_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich then treats stderr as a terminal
    with ProgressBar() as bar:
        for progress in (
            Progress("geometry", 2, 8, 1.0),
            Progress("geometry", 8, 8, 4.0),
            Progress("atlas", 1, 3, 1.0),
        ):
            bar.update(progress)
            [task] = bar._bars.tasks
            assert (task.description, task.completed, task.total) == (progress.stage, progress.step, progress.steps)


def test_lines_without_a_terminal_tell_stage_loss_and_time_left(capsys: pytest.CaptureFixture[str]) -> None:
    with ProgressBar() as bar:
        bar.update(Progress("geometry", 2, 8, 10.0, {"loss": np.array([0.5, 0.25])}))
        bar.update(Progress("geometry", 3, 8, 11.0))
        bar.update(Progress("atlas", 1, 3, 1.0))
    output = capsys.readouterr().err.splitlines()
    assert [line.partition(":")[0] for line in output] == ["geometry", "atlas"], "not a line a step"
    assert "2/8 after 10 s" in output[0] and "30 s left" in output[0] and "loss 0.25" in output[0]
