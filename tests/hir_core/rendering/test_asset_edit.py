"""`hir edit`: factors do what they say, a new light is in place of the old one, the run stays as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial
from hir_exporters.scene_format import load_scene, save_scene
from hir_exporters.textures.image_files import read_ldr, write_hdr

from hir_core.cli import main
from hir_core.errors import InputError
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.asset_edit import AssetEdit, apply_edit, edit_run
from hir_core.run.run_directory import RunDirectory
from hir_core.testing.assets import textured_asset
from tests.fixtures.command_line import hir


def test_factors_are_those_of_engines() -> None:
    asset = textured_asset()
    found = apply_edit(asset, AssetEdit(roughness=1.5, tint=(1.0, 0.5, 0.25), specular=2.0))
    np.testing.assert_allclose(
        np.sqrt(found.material.roughness), np.minimum(np.sqrt(asset.material.roughness) * 1.5, 1), rtol=1e-5
    )
    np.testing.assert_allclose(found.material.diffuse_albedo, asset.material.diffuse_albedo * [1, 0.5, 0.25], rtol=1e-6)
    np.testing.assert_allclose(
        found.material.specular_albedo, np.minimum(asset.material.specular_albedo * 2, 1), rtol=1e-6
    )
    assert found.provenance["edited"] == "roughness × 1.5, albedo × 1 0.5 0.25, specular × 2"
    np.testing.assert_array_equal(found.mesh.positions, asset.mesh.positions)
    np.testing.assert_array_equal(apply_edit(asset, AssetEdit()).material.roughness, asset.material.roughness)


def test_factors_of_a_metallic_material_are_of_its_parameters() -> None:
    rng = np.random.default_rng(0)
    base, metalness = rng.random((8, 8, 3)), rng.random((8, 8))
    made = AssetMaterial.metallic(base, metalness, 0.09)
    asset = replace(textured_asset(), material=made)
    edit = AssetEdit(roughness=2.0, tint=(1.0, 0.5, 2.0), specular=2.0, metalness=1.5)
    found = apply_edit(asset, edit)
    assert found.material.model == "metallic" and found.material.metalness is not None
    np.testing.assert_allclose(found.material.metalness, np.minimum(metalness * 1.5, 1), rtol=1e-6)
    np.testing.assert_allclose(found.material.base_color, np.minimum(base * [1, 0.5, 2], 1), atol=1e-6)
    np.testing.assert_allclose(found.material.roughness, 0.36, rtol=1e-6)
    assert found.material.dielectric_f0 == 0.08
    assert found.provenance["edited"] == "roughness × 2, albedo × 1 0.5 2, specular × 2, metalness × 1.5"
    same = apply_edit(asset, AssetEdit()).material
    np.testing.assert_allclose(same.specular_albedo, made.specular_albedo, atol=5e-7)


def test_light_is_replaced_strength_included(tmp_path: Path) -> None:
    radiance = np.full((8, 16, 3), 2.0, np.float32)
    write_hdr(tmp_path / "even.hdr", radiance)
    found = apply_edit(textured_asset(), AssetEdit(light=f"{tmp_path / 'even.hdr'}*0.25"))
    assert found.environment is not None and found.environment.frame == "world"
    np.testing.assert_allclose(found.environment.radiance, 0.5, rtol=0.01)


@pytest.mark.parametrize(
    ("edit", "message"),
    [
        (AssetEdit(roughness=-1), "--roughness"),
        (AssetEdit(specular=float("nan")), "--specular"),
        (AssetEdit(tint=(1, -1, 1)), "--tint"),
        (AssetEdit(light="gone.hdr"), "gone.hdr"),
        (AssetEdit(metalness=-1), "--metalness -1: the factor must be a finite number"),
        (AssetEdit(metalness=0.5), "--metalness: the asset's material is 'dielectric', which has none; leave it out"),
    ],
)
def test_invalid_edits_are_refused(edit: AssetEdit, message: str) -> None:
    with pytest.raises(InputError, match=message):
        apply_edit(textured_asset(), edit)


def test_command_writes_a_scene_and_a_picture(finished: Run, tmp_path: Path) -> None:
    before = (finished.directory.scene / "scene.json").read_bytes()
    arguments = [
        "edit",
        str(finished.path),
        "-o",
        str(tmp_path / "red"),
        "--tint",
        "1",
        "0.1",
        "0.1",
        "--size",
        "48",
        "-q",
    ]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert stop.value.code == 0
    assert (finished.directory.scene / "scene.json").read_bytes() == before
    plain, red = load_scene(finished.directory.scene), load_scene(tmp_path / "red")
    np.testing.assert_allclose(
        red.material.diffuse_albedo[..., 1], plain.material.diffuse_albedo[..., 1] * 0.1, rtol=1e-5
    )
    picture = read_ldr(tmp_path / "red.png")
    assert picture.shape == (48, 96, 4)
    left, right = picture[:, :48], picture[:, 48:]
    inside = (left[..., 3] > 0.5) & (right[..., 3] > 0.5)
    assert inside.mean() > 0.05
    assert right[inside][:, 1].mean() < 0.7 * left[inside][:, 1].mean(), "less green"
    assert right[inside][:, 0].mean() > 0.8 * left[inside][:, 0].mean(), "as much red"


def test_an_edit_that_changes_nothing_is_refused(
    finished: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["edit", str(finished.path), "-o", str(tmp_path / "same"), "--roughness", "1"])
    assert stop.value.code == 2 and not (tmp_path / "same").exists()
    assert "nothing would change; give --roughness" in capsys.readouterr().err


def test_other_folders_are_not_overwritten(finished: Run, tmp_path: Path) -> None:
    plugins = PluginManager.discover()
    with pytest.raises(InputError, match="has no finished scene"):
        edit_run(tmp_path, AssetEdit(), tmp_path / "out", plugins)
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "to_mother.txt").write_text("dear")
    with pytest.raises(InputError, match="is not empty and no scene folder"):
        edit_run(finished.path, AssetEdit(), tmp_path / "letters", plugins, picture=False)
    assert [file.name for file in (tmp_path / "letters").iterdir()] == ["to_mother.txt"]
    with pytest.raises(InputError, match=r"to_mother\.txt is a file; choose an empty or new folder"):
        edit_run(finished.path, AssetEdit(), tmp_path / "letters" / "to_mother.txt", plugins, picture=False)


def test_a_photograph_is_not_replaced_by_the_picture(tmp_path: Path) -> None:
    save_scene(textured_asset(), tmp_path / "scene")
    (tmp_path / "003.png").write_bytes(b"a photograph")
    with pytest.raises(InputError, match=r"003\.png exists; choose another name for the folder, or use --no-picture"):
        edit_run(tmp_path / "scene", AssetEdit(2.0), tmp_path / "003", PluginManager.discover())
    assert (tmp_path / "003.png").read_bytes() == b"a photograph" and not (tmp_path / "003").exists()


@pytest.mark.parametrize("place", ["scene", "stages/4-reflectance/scene", "stages/new"])
def test_results_of_a_run_are_not_overwritten(place: str, tmp_path: Path) -> None:
    run = tmp_path / "mug"
    save_scene(textured_asset(), run / "scene")
    save_scene(textured_asset(), run / "stages" / "4-reflectance" / "scene")
    (run / "run.json").write_text("{}")
    before = {file: file.read_bytes() for file in run.rglob("*") if file.is_file()}
    plugins = PluginManager.discover()
    for source in (run, run / "scene"):
        with pytest.raises(InputError, match="holds results of the run mug; choose a new folder"):
            edit_run(source, AssetEdit(roughness=2.0), run / place, plugins, picture=False)
    assert {file: file.read_bytes() for file in run.rglob("*") if file.is_file()} == before
    beside = edit_run(run, AssetEdit(roughness=2.0), run / "rough", plugins, picture=False)
    assert beside == [run / "rough" / "scene.json"]


def test_a_scene_without_light_needs_one_for_its_picture(tmp_path: Path) -> None:
    plugins = PluginManager.discover()
    save_scene(replace(textured_asset(), environment=None), tmp_path / "dark")
    with pytest.raises(InputError, match="has no light, so it cannot be rendered; give a light with --light"):
        edit_run(tmp_path / "dark", AssetEdit(), tmp_path / "out", plugins)
    written = edit_run(tmp_path / "dark", AssetEdit(roughness=0.5), tmp_path / "plain", plugins, picture=False)
    assert written == [tmp_path / "plain" / "scene.json"]
    again = edit_run(tmp_path / "plain", AssetEdit(roughness=0.5), tmp_path / "plain", plugins, picture=False)
    assert again == written, "a scene folder may be written over"


def test_an_unfinished_run_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_scene(textured_asset(), tmp_path / "run" / "scene")
    run = RunDirectory(tmp_path / "run")
    arguments = ("edit", run.path, "--roughness", 2, "--no-picture", "-q", "-o")
    run.write_run({"stages": {"geometry": {}}})
    assert hir(*arguments, tmp_path / "one") == 0
    sentence = "its latest call ended before the stage bake, so the edit starts from the scene of an earlier one; "
    assert f"hir: {run.path}: {sentence}finish the run with: hir reconstruct" in capsys.readouterr().err
    run.write_run({"stages": {"geometry": {}, "bake": {}}})
    assert hir(*arguments, tmp_path / "two") == 0 and capsys.readouterr().err == ""
    (run.path / "run.json").write_text("{")
    assert hir(*arguments, tmp_path / "three") == 0
