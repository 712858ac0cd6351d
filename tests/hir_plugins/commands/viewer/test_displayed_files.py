"""Files of other programs: what is wrong with them or not shown is one sentence in place of an empty page."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.scene_format import save_scene
from hir_exporters.textures.image_files import write_hdr
from PIL import Image

from hir_core.cli import main
from hir_core.errors import InputError
from hir_core.run.run_directory import RunDirectory
from hir_plugins.commands.viewer.displayed_asset import load_displayed_asset
from tests.fixtures.command_line import hir
from tests.fixtures.gltf_quads import FACES, POSITIONS, UVS, png, textured, write_quad
from tests.fixtures.octant_asset import asset

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


FOREIGN = {"extensionsUsed": ["KHR_materials_clearcoat", "ACME_glow"], "animations": [{"channels": [], "samplers": []}]}


def test_what_the_page_does_not_show_is_one_warning(tmp_path: Path) -> None:
    image = [{"uri": "beside.png"}]
    path = write_quad(tmp_path / "a.glb", textured(), changes=FOREIGN | {"images": image, "textures": [{"source": 0}]})
    with pytest.warns(UserWarning) as found:
        load_displayed_asset(path)
    (sentence,) = [str(warning.message) for warning in found]
    features = "ACME_glow, animations, the file 'beside.png' beside it"
    assert sentence.startswith(f"{path} is shown without {features}, which the page cannot show; bake what")


def test_what_a_converted_file_loses_is_one_warning(tmp_path: Path) -> None:
    coat = {"extensions": {"KHR_materials_clearcoat": {"clearcoatFactor": 1}}}
    path = write_quad(tmp_path / "a.gltf", coat, changes=FOREIGN)
    words = r"a\.gltf is read without clear coat \(KHR_materials_clearcoat\) and animations, which"
    with pytest.warns(UserWarning, match=words) as found:
        load_displayed_asset(path)
    assert len(found) == 1


def test_the_command_prints_the_warning(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_quad(tmp_path / "a.glb", {}, changes=FOREIGN)
    with pytest.raises(SystemExit) as stop:
        main(["view", str(path), "--save", str(tmp_path / "page.html"), "-q"])
    assert stop.value.code == 0
    assert capsys.readouterr().err.startswith(f"hir: {path} is shown without ACME_glow, animations, which ")


def test_a_light_in_the_file_is_named_unless_another_one_is_given(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_quad(tmp_path / "a.glb", {}, changes={"extensionsUsed": ["EXT_lights_image_based"]})
    write_hdr(tmp_path / "even.hdr", np.ones((4, 8, 3), np.float32))
    assert hir("view", path, "--save", tmp_path / "page.html", "-q") == 0
    assert capsys.readouterr().err.startswith(f"hir: {path} is shown without EXT_lights_image_based, which ")
    assert hir("view", path, "--light", tmp_path / "even.hdr", "--save", tmp_path / "page.html", "-q") == 0
    assert capsys.readouterr().err == ""


def test_an_unfinished_run_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = RunDirectory(tmp_path / "run")
    save_scene(asset(), run.scene)
    run.write_run({"stages": {"geometry": {}}})
    assert hir("view", run.path, "--save", tmp_path / "page.html", "-q") == 0
    sentence = "its latest call ended before the stage bake, so the page shows the scene of an earlier one; "
    assert f"hir: {run.path}: {sentence}finish the run with: hir reconstruct" in capsys.readouterr().err
    (run.path / "run.json").write_text("{")
    assert hir("view", run.path, "--save", tmp_path / "page.html", "-q") == 0, "a damaged run.json is no reason to end"


@pytest.mark.parametrize("suffix", ["glb", "gltf"])
@pytest.mark.parametrize(("profile", "light"), [("khr", True), ("blender", False), ("engine", False)])
def test_our_own_files_have_no_warning(profile: Any, light: bool, suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a.{suffix}"
    create_exporter(suffix, GltfConfig(profile=profile, image_based_light=light)).write(asset(), path)
    load_displayed_asset(path)  # a warning is an error here


def test_textures_without_a_decoder_in_the_page_are_converted(tmp_path: Path) -> None:
    picture = png(Image.new("RGB", (2, 2), "red"))
    path = write_quad(tmp_path / "a.glb", textured(), [picture], changes={"extensionsUsed": ["KHR_texture_basisu"]})
    assert b"KHR_texture_basisu" not in load_displayed_asset(path).glb
