"""`hir export`: a mesh with textures, its short options, vendors' hooks, and destinations that cannot be written."""

from __future__ import annotations

import json
import os
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.errors import ExportError
from hir_exporters.formats import create_exporter
from hir_exporters.reading.gltf_readback import read_gltf
from hir_exporters.scene_format import save_scene
from hir_exporters.textures.image_files import write_hdr, write_png
from pxr import Sdf, Usd

from hir_core.cli.export_command import parse_lods
from hir_core.run.run_directory import RunDirectory
from tests.fixtures.command_line import hir
from tests.fixtures.gltf_quads import write_quad
from tests.hir_exporters.reading.usd_samples import surface_of, write_box

ROOT = Path(__file__).resolve().parents[3]
PLATE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nvt 1 1\nf 1/1 2/2 3/3\nf 2/2 4/4 3/3\n"


def plate(roughness: object = 0.2) -> Asset:
    corners = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]
    mesh = AssetMesh(corners, [[0, 0, 1]] * 4, [[0, 1], [1, 1], [0, 0], [1, 0]], [[0, 1, 2], [1, 3, 2]])
    material = AssetMaterial("dielectric", [0.5, 0.4, 0.3], [0.04] * 3, np.asarray(roughness, np.float32))
    return Asset(mesh, material, AssetEnvironment(np.ones((4, 8, 3))), name="plate")


def document(path: Path) -> dict:
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def test_a_mesh_with_textures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plate.obj").write_text(PLATE)
    write_png(tmp_path / "color.png", np.tile(np.array([0.5, 0.25, 0.75]), (8, 8, 1)))
    arguments = ["--base-color", tmp_path / "color.png", "--roughness", 0.3, "-f", "glb", "-f", "usdz"]
    assert hir("export", tmp_path / "plate.obj", *arguments, "-o", tmp_path / "out") == 0
    message = capsys.readouterr()
    assert "by the formulas of engines, in dB: gltf" in message.out and "three.js" in message.out
    assert "asset: one roughness for the whole surface" in message.out
    back = read_gltf(tmp_path / "out" / "plate.glb")
    np.testing.assert_allclose(back.surface.roughness, 0.3, atol=1e-6)
    np.testing.assert_allclose(back.corner_uvs[0], [[0, 1], [1, 1], [0, 0]])


def test_what_an_import_leaves_out_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def edit(stage: Usd.Stage) -> None:
        surface_of(stage).CreateInput("opacity", Sdf.ValueTypeNames.Float).Set(0.5)

    path = write_box(tmp_path, edit)
    assert hir("export", path, "-f", "glb", "--no-verify", "-o", tmp_path / "out") == 0
    assert f"hir: {path}: opacity of its material is left out" in capsys.readouterr().err


def test_what_a_gltf_has_and_an_asset_has_not_is_named_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write_quad(tmp_path / "quad.glb", {"emissiveFactor": [1, 1, 1], "doubleSided": True})
    assert hir("export", path, "-f", "glb", "-o", tmp_path / "out") == 0
    named = [line for line in capsys.readouterr().err.splitlines() if "is read without" in line]
    assert len(named) == 1 and named[0].startswith(f"hir: {path} is read without emission and the back of its open")


def test_what_an_import_leaves_out_is_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "plate.obj").write_text("mtllib plate.mtl\nusemtl a\n" + PLATE)
    (tmp_path / "plate.mtl").write_text("newmtl a\nd 0.5\n")
    assert hir("export", tmp_path / "plate.obj", "-f", "obj", "--no-verify", "-o", tmp_path / "out") == 0
    assert "plate.obj: the import leaves out d 0.5 of the material 'a', because" in capsys.readouterr().err
    (tmp_path / "plate.obj").write_text(PLATE + "f 1/1 2/2 999999999/3\n")
    assert hir("export", tmp_path / "plate.obj", "-f", "obj", "-o", tmp_path / "out") == 2
    assert "plate.obj: mesh.faces has an index out of range in line 11" in capsys.readouterr().err


def test_a_scene_of_an_earlier_call_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_scene(plate(), tmp_path / "scene")
    run = RunDirectory(tmp_path)
    run.write_run({"stages": {"geometry": {}}})
    assert hir("export", tmp_path, "-f", "obj", "-o", tmp_path / "out") == 0
    shown = capsys.readouterr()
    assert "the scene of an earlier one; finish the run with" in shown.err and "plate.obj" in shown.out
    run.write_run({"stages": {"geometry": {}, "bake": {}}})
    assert hir("export", tmp_path, "-f", "obj", "--no-verify", "-o", tmp_path / "out") == 0
    assert "earlier" not in capsys.readouterr().err
    (tmp_path / "run.json").write_text("{")
    assert hir("export", tmp_path, "-f", "obj", "-o", tmp_path / "other") == 2
    assert "run.json" in capsys.readouterr().err and not (tmp_path / "other").exists()


def test_short_options_reach_the_formats_that_have_them(tmp_path: Path) -> None:
    save_scene(plate(), tmp_path / "scene")
    arguments = ["-f", "glb", "-f", "hdr", "--profile", "unity-legacy", "--budget", "web", "--lod", "1", "-q"]
    assert hir("export", tmp_path / "scene", *arguments, "-o", tmp_path / "out") == 0
    names = document(tmp_path / "out" / "plate.glb")["extensionsUsed"]
    assert names == ["KHR_materials_pbrSpecularGlossiness"] and (tmp_path / "out" / "plate_lod1.glb").is_file()
    assert parse_lods("100k,2.5k,7") == [100_000, 2500, 7]


def test_the_profile_engine_reaches_all_formats_that_have_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sky = np.full((32, 64, 3), 0.2)
    sky[6:9, 40:44] = 30
    metal = replace(plate(), material=AssetMaterial.metallic([0.9, 0.7, 0.4], 1.0, 0.3))
    save_scene(replace(metal, environment=AssetEnvironment(sky)), tmp_path / "scene")
    formats = [word for name in ("glb", "usda", "ktx", "obj") for word in ("-f", name)]
    assert hir("export", tmp_path / "scene", *formats, "--profile", "engine", "-o", tmp_path / "out") == 0
    message = capsys.readouterr()
    assert "load the residual environment beside it" in message.err
    assert "not re-rendered: profile engine changes material and light" in message.out
    assert "KHR_lights_punctual" in document(tmp_path / "out" / "plate.glb")["extensionsUsed"]
    assert 'def DistantLight "Light_0"' in (tmp_path / "out" / "plate_usda_lit.usda").read_text()
    glb, usda = (tmp_path / "out" / f"plate_{name}_residual.hdr" for name in ("glb", "usda"))
    assert glb.read_bytes() == usda.read_bytes() and not (tmp_path / "out" / "plate.hdr").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{tmp}/scene", "-f", "glb", "--set", "glb.lights=4"], "only profile engine has lights"),
        (["{tmp}/scene", "-f", "usda", "--profile", "khr"], "--profile: no format of usda has this option"),
        (["{tmp}/scene", "-f", "obj", "--profile", "khr"], "--profile: no format of obj has this option"),
        (["{tmp}/scene", "-f", "glb", "--lod", "many"], "'many' is not a number of triangles"),
        (["{tmp}/scene", "-f", "glb", "--roughness", "0.5"], "--roughness can only be used with a mesh"),
        (["{tmp}/plate.obj", "-f", "glb", "--roughness", "gone.png"], "gone.png for roughness does not exist"),
        (["{tmp}/plate.obj", "-f", "glb", "--roughness", "7"], "roughness is 7.0; it must be from 0 to 1"),
        (["{tmp}/plate.obj", "-f", "glb", "--light", "{tmp}/plate.obj"], "is a lat-long"),
        (
            ["{tmp}/plate.obj", "-f", "glb", "--light", "{tmp}/square.hdr"],
            "has 8 x 8 pixels; a lat-long image is twice",
        ),
        (["{tmp}/plate.obj", "-f", "glb", "--base-color", "{tmp}/scene"], "scene for base color is no file"),
        (["{tmp}/plate.obj", "-f", "hdr"], "there is no light to write; give it one (hir export --light)"),
        (["{tmp}/plate.obj", "-f", "obj", "-o", "{tmp}"], "plate.obj is a source of this export and would be replaced"),
        (["{tmp}/scene", "-f", "glb", "-o", "{tmp}/plate.obj"], "plate.obj: a file of that name exists"),
        (["{tmp}/scene", "-f", "glb", "--lod", "50,100"], "each level needs fewer triangles than the one before"),
        (["{tmp}/scene", "-f", "glb", "--set", "usdz.workflow=auto"], "usdz is not written; add -f usdz, or remove it"),
        (
            ["{tmp}/scene", "-f", "glb", "--profile", "blender", "--set", "glb.profile=khr"],
            "--profile and --set glb.profile differ; remove one of them",
        ),
        (["{tmp}/scene", "-f", "glb", "--set", "glb.image_format=ktx2"], "run `npm install ktx2-encoder@0.6`"),
        (["{tmp}/scene", "-f", "glb", "--set", "glb.max_texture_size=0"], "max_texture_size is 0; it must be from 1"),
        (["{tmp}/scene", "-f", "glb", "--height", "0"], "height is 0; it must be a positive number"),
        (["{tmp}/scene", "-f", "glb", "--height", "1", "--scale", "2"], "scale and height are both given"),
        (["{tmp}/scene", "-f", "fbx"], "fbx"),
        (["{tmp}/scene", "-f", "glb", "-o", "{tmp}/plate.obj/sub"], "plate.obj"),
    ],
)
def test_what_is_refused(
    arguments: list[str],
    message: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("HIR_NODE_MODULES", str(tmp_path))
    (tmp_path / "plate.obj").write_text(PLATE)
    write_hdr(tmp_path / "square.hdr", np.ones((8, 8, 3), np.float32))
    save_scene(plate(), tmp_path / "scene")
    arguments = [word.replace("{tmp}", str(tmp_path)) for word in arguments]
    before = sorted(tmp_path.rglob("*"))
    assert hir("export", *arguments, *([] if "-o" in arguments else ["-o", tmp_path / "out"])) == 2
    assert message in capsys.readouterr().err
    assert [p for p in sorted(tmp_path.rglob("*")) if p.is_file()] == [p for p in before if p.is_file()]


@pytest.mark.parametrize("pivot", ["source", "base", "centre"])
def test_height_and_pivot(pivot: str, tmp_path: Path) -> None:
    """The file's bounding box, and that only size and place differ from a file written without the options."""
    lifted = replace(plate(), mesh=replace(plate().mesh, positions=plate().mesh.positions * [1, 2, 1] + [3, 5, 7]))
    save_scene(lifted, tmp_path / "scene")
    arguments = ["-f", "glb", "-q", "--height", "0.24", "--pivot", pivot, "-o", tmp_path / "out"]
    assert hir("export", tmp_path / "scene", *arguments) == 0
    points = read_gltf(tmp_path / "out" / "plate.glb").corner_positions.reshape(-1, 3)
    low, high = points.min(axis=0), points.max(axis=0)
    np.testing.assert_allclose(high - low, [0.12, 0.24, 0], atol=1e-6)
    corner = {"source": [0.36, 0.6, 0.84], "base": [-0.06, 0, 0], "centre": [-0.06, -0.12, 0]}[pivot]
    np.testing.assert_allclose(low, corner, atol=1e-6)
    assert document(tmp_path / "out" / "plate.glb")["asset"]["extras"]["hir"]["placement"][0][0] == pytest.approx(0.12)


def test_formats_side_by_side_are_those_written_alone(tmp_path: Path) -> None:
    """Each format in one folder has the bytes that it has alone, and no file but the light belongs to two formats.

    A coloured lobe: the base colours of core metallic-roughness, of the extensions and of USD differ.
    """
    noise = np.random.default_rng(0).random((16, 16, 3))
    material = AssetMaterial("paper", 0.2 + 0.5 * noise, 0.1 + 0.2 * noise, 0.1 + 0.3 * noise[..., 0])
    save_scene(replace(plate(), material=material), tmp_path / "scene")
    formats = ("gltf", "obj", "usda", "usdc", "usdz", "glb", "hdr")
    every = [word for name in formats for word in ("-f", name)]
    assert hir("export", tmp_path / "scene", *every, "-q", "--no-verify", "-o", tmp_path / "all") == 0
    owners: dict[str, str] = {}
    for name in formats:
        assert hir("export", tmp_path / "scene", "-f", name, "-q", "--no-verify", "-o", tmp_path / name) == 0
        for file in sorted((tmp_path / name).iterdir()):
            assert file.read_bytes() == (tmp_path / "all" / file.name).read_bytes(), (name, file.name)
            assert file.suffix == ".hdr" or owners.setdefault(file.name, name) == name
    assert {file.name for file in (tmp_path / "all").iterdir()} == {*owners, "plate.hdr"}


def test_two_formats_that_write_one_file_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_scene(plate(), tmp_path / "scene")
    arguments = ["-f", "glb", "-f", "hdr", "--set", "hdr.height=8", "-o", tmp_path / "out"]
    assert hir("export", tmp_path / "scene", *arguments) == 2
    message = capsys.readouterr().err
    assert f"{tmp_path / 'out' / 'plate.hdr'}: the formats glb and hdr both write this file" in message
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["plate.glb", "plate.hdr"]


def test_another_light_beside_files_of_an_earlier_export_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Else plate_usda_lit.usda would show the other asset's light. The formats of the call are replaced freely."""
    asset = plate()
    assert asset.environment is not None
    save_scene(asset, tmp_path / "first")
    save_scene(replace(asset, environment=AssetEnvironment(2 * asset.environment.radiance)), tmp_path / "second")
    out = ["-q", "--no-verify", "-o", tmp_path / "out"]
    assert hir("export", tmp_path / "first", "-f", "usda", *out) == 0
    before = {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()}
    assert hir("export", tmp_path / "second", "-f", "glb", *out) == 2
    assert f"{tmp_path / 'out' / 'plate.hdr'} would be replaced by another one, but plate.usda of an earlier" in (
        capsys.readouterr().err
    )
    assert {file.name: file.read_bytes() for file in (tmp_path / "out").iterdir()} == before
    assert hir("export", tmp_path / "first", "-f", "glb", *out) == 0, "the same light"
    assert hir("export", tmp_path / "second", "-f", "glb", "-f", "usda", *out) == 0
    assert (tmp_path / "out" / "plate.hdr").read_bytes() != before["plate.hdr"]


def test_a_target_that_is_no_file_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_scene(plate(), tmp_path / "scene")
    (tmp_path / "out").mkdir()
    os.mkfifo(tmp_path / "out" / "plate.glb")
    assert hir("export", tmp_path / "scene", "-f", "glb", "-o", tmp_path / "out") == 2
    assert f"{tmp_path / 'out' / 'plate.glb'}: it is not a regular file" in capsys.readouterr().err
    assert [p.name for p in (tmp_path / "out").iterdir()] == ["plate.glb"]


def test_vendors_change_documents_before_they_are_written(tmp_path: Path) -> None:
    from pxr import Usd

    save_scene(plate(), tmp_path / "scene")
    plugin = ROOT / "examples" / "vendor_extension.py"
    arguments = ["-f", "glb", "-f", "usdz", "--plugin", plugin, "-q", "-o", tmp_path / "out"]
    assert hir("export", tmp_path / "scene", *arguments) == 0
    found = document(tmp_path / "out" / "plate.glb")
    assert found["nodes"][0]["extensions"]["ACME_catalogue"] == {"article": "plate", "triangles": 2}
    assert "ACME_catalogue" in found["extensionsUsed"] and "extensionsRequired" not in found
    stage = Usd.Stage.Open(str(tmp_path / "out" / "plate.usdz"))
    assert stage.GetDefaultPrim().GetCustomDataByKey("acme:article") == "plate"


def test_a_16k_texture_is_reduced_with_a_warning(tmp_path: Path) -> None:
    wide = plate(np.broadcast_to(np.linspace(0.1, 0.4, 16384), (4, 16384)))
    for suffix in ("glb", "usda", "obj"):
        report = create_exporter(suffix).write(wide, tmp_path / f"x.{suffix}")
        assert any("from 16384 to 4096 pixels" in warning for warning in report.warnings), suffix
    back = read_gltf(tmp_path / "x.glb")
    assert max(back.surface.roughness.shape) == 4096


@pytest.mark.skipif(not hasattr(os, "statvfs"), reason="limits file sizes as POSIX does")
@pytest.mark.parametrize("suffix", ["glb", "gltf", "usda", "usdz", "obj", "hdr", "exr", "ktx", "sh.json"])
def test_a_full_destination_leaves_nothing(suffix: str, tmp_path: Path) -> None:
    """A limit on file sizes stands for a full disk: the write fails in the middle."""
    import resource
    import signal

    old_limit, old_action = resource.getrlimit(resource.RLIMIT_FSIZE), signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    noise = np.random.default_rng(0).random((64, 64, 3)) * 0.5 + 0.1
    asset = replace(plate(noise[..., 0]), environment=AssetEnvironment(noise[:32]))
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (300, old_limit[1]))
        with pytest.raises(ExportError, match="space"):
            create_exporter(suffix).write(asset, tmp_path / f"x.{suffix}")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old_limit)
        signal.signal(signal.SIGXFSZ, old_action)
    assert [p.name for p in tmp_path.iterdir() if p.stat().st_size > 300 or p.name.startswith(".")] == []
    assert not (tmp_path / f"x.{suffix}").exists()


@pytest.mark.skipif(os.name != "posix", reason="needs the rights of POSIX")
@pytest.mark.parametrize("suffix", ["glb", "gltf", "usda", "usdz", "obj", "hdr", "exr", "ktx", "sh.json"])
def test_a_read_only_destination_is_named_and_left_alone(suffix: str) -> None:
    """A superuser may write everywhere, so that the test gives that up for a moment."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "locked"
        folder.mkdir(mode=0o555)
        Path(name).chmod(0o755)
        asset, exporter = plate(), create_exporter(suffix)
        exporter.write(asset, Path(name) / f"before.{suffix}")  # so that everything is imported
        root = os.geteuid() == 0
        try:
            if root:
                os.seteuid(65534)
            with pytest.raises(ExportError, match=r"locked.*permissions"):
                exporter.write(asset, folder / f"x.{suffix}")
        finally:
            if root:
                os.seteuid(0)
        assert list(folder.iterdir()) == []
