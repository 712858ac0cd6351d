"""Files with broken geometry are one sentence in place of an empty page."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hir_core.cli import main
from hir_core.errors import InputError
from hir_plugins.commands.viewer.displayed_asset import load_displayed_asset
from tests.fixtures.gltf_quads import FACES, POSITIONS, UVS, write_quad

NAN = POSITIONS + np.array([np.nan, 0, 0], np.float32)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_numbers_that_are_not_finite_are_one_sentence(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    write_quad(path, {}, attributes={"POSITION": NAN})
    with pytest.raises(InputError, match=rf"a\.{suffix}: POSITION of a mesh has NaN or infinite numbers; export it"):
        load_displayed_asset(path)
    write_quad(path, {}, attributes={"TEXCOORD_0": UVS * np.float32(np.nan)})
    with pytest.raises(InputError, match=rf"a\.{suffix}: TEXCOORD_0 of a mesh has NaN or infinite numbers"):
        load_displayed_asset(path)


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
def test_an_index_out_of_range_is_one_sentence(suffix: str, tmp_path: Path) -> None:
    path = write_quad(tmp_path / f"a.{suffix}", {}, faces=np.array([0, 1, 2, 0, 2, 60000], np.uint16))
    with pytest.raises(InputError, match=rf"a\.{suffix}: a mesh has the index 60000, but 4 vertices; export it again"):
        load_displayed_asset(path)


def test_the_command_ends_without_a_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_quad(tmp_path / "a.glb", {}, attributes={"POSITION": NAN})
    with pytest.raises(SystemExit) as stop:
        main(["view", str(path), "--save", str(tmp_path / "page.html")])
    assert stop.value.code == 2 and not (tmp_path / "page.html").exists()
    assert capsys.readouterr().err.count("\n") == 1


def test_a_page_is_not_written_over_files_of_other_kinds(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_quad(tmp_path / "a.glb", {}, faces=FACES)
    before = path.read_bytes()
    with pytest.raises(SystemExit) as stop:
        main(["view", str(path), "--save", str(path)])
    assert stop.value.code == 2 and path.read_bytes() == before
    assert "give a name that ends in .html" in capsys.readouterr().err


def test_a_sound_file_is_passed_on(tmp_path: Path) -> None:
    path = write_quad(tmp_path / "a.glb", {}, faces=FACES)
    assert load_displayed_asset(path).glb == path.read_bytes()
