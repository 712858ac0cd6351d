"""`hir check` of thousands of photographs: no step grows with the square of their number, and it says how far it is."""

from __future__ import annotations

import json
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from hir_core.capture import Capture, Pixels, View
from hir_core.intake.mask_agreement import MAX_HULL_VIEWS, mask_agreement
from hir_core.intake.picture_statistics import find_duplicates
from tests.reliability import seeds

FRAMES = 10_000


@pytest.mark.slow
def test_duplicates_among_ten_thousand_photographs_need_little_memory() -> None:
    """The matrix of all pairs has 800 MB, and its computation held three."""
    rng = np.random.default_rng(0)
    pictures = [rng.random((8, 8, 3)).astype(np.float32) for _ in range(FRAMES - 1)]
    pictures.append(pictures[17])
    everywhere = np.zeros((8, 8), bool)
    photographs = [Pixels(picture, None, everywhere) for picture in pictures]
    tracemalloc.start()
    assert find_duplicates(photographs) == [(17, FRAMES - 1)]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 600 << 20


@pytest.mark.slow
def test_equal_photographs_are_named_once_each() -> None:
    """All pairs of 10,000 equal photographs would be 50 million."""
    pixels = Pixels(np.full((8, 8, 3), 0.5, np.float32), None, np.zeros((8, 8), bool))
    assert find_duplicates([pixels] * FRAMES) == [(0, i) for i in range(1, FRAMES)]


def test_the_hull_is_made_of_a_bounded_number_of_masks(monkeypatch: pytest.MonkeyPatch) -> None:
    from hir_core.intake import mask_agreement as module

    given: list[int] = []
    monkeypatch.setattr(module, "_consensus_hull", lambda pairs: given.append(len(pairs)))
    from tests.fixtures.silhouette_captures import dome

    camera, mask = dome(1, 4.0, np.zeros(3), 50.0, 32)[0], np.ones((4, 4), np.float32)
    assert mask_agreement([camera] * FRAMES, [mask] * FRAMES).iou == (0.0,) * FRAMES
    assert mask_agreement([camera] * 5, [mask] * 5).iou == (0.0,) * 5
    assert given == [MAX_HULL_VIEWS, 5]


def test_masks_of_ten_thousand_photographs_are_found_in_seconds(tmp_path: Path) -> None:
    """Each search looked at all masks: 10^8 comparisons of names."""
    from hir_plugins.readers.parsing.mask_files import MaskIndex

    photos = [tmp_path / f"{i:05d}.jpg" for i in range(FRAMES)]
    started = time.perf_counter()
    index = MaskIndex([tmp_path / f"{i:05d}_mask.png" for i in range(FRAMES)])
    assert [index.match(photo) for photo in photos] == [tmp_path / f"{p.stem}_mask.png" for p in photos]
    assert time.perf_counter() - started < 10


def test_a_long_check_says_how_far_it_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    from hir_core.cli.check_command import with_progress
    from hir_core.terminal import progress_bar

    monkeypatch.setattr(progress_bar, "LINE_SECONDS", 0.0)
    pixels = Pixels(np.zeros((4, 4, 3), np.float32), None, np.zeros((4, 4), bool))
    views = tuple(View(str(i), None, lambda: pixels) for i in range(3))
    counted = with_progress(Capture(path=Path(), views=views)).views
    for view in counted * 3:
        view.pixels()
    lines = capsys.readouterr().err.splitlines()
    assert [line.split(";")[0] for line in lines] == [
        f"decoded {i} of 3 photographs (reading {reading}, each is read at least twice)"
        for reading in (1, 2, 3)
        for i in (1, 2, 3)
    ]
    assert "--photographs N" in lines[0] and "Ctrl-C" in lines[0]


def test_a_part_of_the_photographs_can_be_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hir_core.cli.app import main

    for i in range(9):
        seeds.picture(tmp_path / f"{i}.png")
    with pytest.raises(SystemExit) as ended:
        main(["check", str(tmp_path), "--photographs", "3", "-v"])
    output = capsys.readouterr().out
    assert ended.value.code == 0 and "3 photographs of" in output


@pytest.mark.slow
def test_ten_thousand_photographs_are_checked(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Without a limit of seconds, which would be one of the machine: benchmarks are not tests."""
    from hir_core.cli.app import main

    seeds.transforms(tmp_path)
    transforms = tmp_path / "transforms_train.json"
    document = json.loads(transforms.read_text())
    frames, every = document["frames"], []
    for i in range(FRAMES):
        frame = frames[i % len(frames)]
        source = next(tmp_path.glob(frame["file_path"].removeprefix("./") + "*"))
        link = tmp_path / "many" / f"{i:05d}{source.suffix}"
        link.parent.mkdir(exist_ok=True)
        link.hardlink_to(source)
        every.append(frame | {"file_path": f"many/{link.name}"})
    transforms.write_text(json.dumps(document | {"frames": every}))
    with pytest.raises(SystemExit) as ended:
        main(["check", str(tmp_path)])
    output = capsys.readouterr()
    assert ended.value.code == 0 and f"{FRAMES} photographs" in output.out.replace(",", "")
