"""A run's folder with links or pipes is refused before anything in it is opened or written."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import HirError

from hir_core.run.run_directory import claimed_run, open_run
from tests.reliability import seeds

LINKED = (
    "run.json",
    ".lock",
    "log.txt",
    "timings.json",
    "stages/2-geometry/stage.json",
    "exports/a.glb",
    "stages/2-geometry",
)


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / "run").mkdir()
    seeds.run(tmp_path / "run")
    return tmp_path / "run"


@pytest.mark.parametrize("place", LINKED)
def test_a_link_in_a_run_is_refused_and_nothing_is_written_through_it(
    place: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from hir_core.cli.app import main

    outside = run.parent / "outside"
    is_folder = (run / place).is_dir()
    if is_folder or (run / place).exists():
        (run / place).rename(outside)
    else:
        outside.write_text("precious")
        (run / place).parent.mkdir(exist_ok=True)
    content = None if is_folder else outside.read_bytes()
    (run / place).symlink_to(outside)
    with pytest.raises(HirError, match=r"is a symbolic link, .* remove it$"), claimed_run(run, resume=True):
        pass
    with pytest.raises(HirError, match=r"is a symbolic link"):
        open_run(run)
    with pytest.raises(SystemExit) as ended:
        main(["reconstruct", "examples/sample_capture", "-o", str(run), "--resume"])
    assert ended.value.code == 2 and "symbolic link" in capsys.readouterr().err
    assert is_folder or outside.read_bytes() == content


def test_a_link_to_nothing_is_refused_too(run: Path) -> None:
    """Opening it for writing would create a file outside."""
    (run / "log.txt").symlink_to(run.parent / "created")
    with pytest.raises(HirError, match="symbolic link"), claimed_run(run, resume=True):
        pass
    assert not (run.parent / "created").exists()


@pytest.mark.parametrize("place", ["run.json", "timings.json", "stages/2-geometry/stage.json"])
def test_a_pipe_in_a_run_does_not_block(place: str, run: Path) -> None:
    (run / place).unlink()
    os.mkfifo(run / place)
    with pytest.raises(HirError, match="not a regular file"), claimed_run(run, resume=True):
        pass
    with pytest.raises(HirError, match="not a regular file"):
        open_run(run)


def test_the_folder_of_a_run_may_itself_be_a_link(run: Path) -> None:
    (run.parent / "link").symlink_to(run)
    assert open_run(run.parent / "link").read_run()["seed"] == 0


def test_a_linked_light_of_a_run_is_not_exported(run: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hir_core.cli.app import main

    outside = run.parent / "private.exr"
    outside.write_bytes(b"private")
    (run / "scene").mkdir(exist_ok=True)
    (run / "scene" / "scene.json").write_text("{}")
    (run / "stages" / "4-reflectance" / "scene").mkdir(parents=True)
    (run / "stages" / "4-reflectance" / "scene" / "take_0.radiance.exr").symlink_to(outside)
    for command in (
        ["export", str(run), "--take", "a", "-f", "hdr", "-o", str(run.parent / "out")],
        ["view", str(run)],
    ):
        with pytest.raises(SystemExit) as ended:
            main(command)
        assert ended.value.code == 2 and "take_0.radiance.exr is a symbolic link" in capsys.readouterr().err


def test_a_camera_that_cannot_be_inverted_is_one_sentence(run: Path) -> None:
    from hir_core.run.capture_store import camera_from_document

    sound = {"K": np.eye(3).tolist(), "world_to_camera": np.eye(4).tolist(), "width": 4, "height": 4}
    assert camera_from_document(sound, "cameras.json").width == 4
    for name, size in (("K", 3), ("world_to_camera", 4)):
        with pytest.raises(HirError, match=r"cameras.json: .*cannot be inverted"):
            camera_from_document(sound | {name: np.zeros((size, size)).tolist()}, "cameras.json")


@pytest.mark.parametrize("content", ['{"captures": {}, "n": ' + "9" * 401 + "}", '{"reason": "\\ud800"}'])
def test_a_manifest_with_nonsense_is_one_sentence(content: str, tmp_path: Path) -> None:
    from hir_plugins.commands.batch.scheduling.manifest import Manifest
    from hir_plugins.commands.batch.storage.storage_path import StoragePath

    (tmp_path / "batch.json").write_text(content)
    with pytest.raises(HirError, match="is not JSON"):
        Manifest(StoragePath(str(tmp_path / "batch.json")), {}).read()
