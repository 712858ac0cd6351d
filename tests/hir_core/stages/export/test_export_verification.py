"""An export proves itself, beginning with the bytes on disk: what is whole passes, what is broken is told by name."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.asset_lamp import AssetLamp
from hir_exporters.exporter import ExportReport
from hir_exporters.formats import create_exporter
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.reading.asset_decoding import decode_material
from hir_exporters.reading.readback import ReadBack
from hir_exporters.textures.image_files import read_hdr, write_hdr
from pygltflib import GLTF2

from hir_core.cli import main
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.orbit_cameras import orbit_cameras
from hir_core.scene import Mesh
from hir_core.stages.export.export_rerendering import Rerender
from hir_core.stages.export.export_verification import ExportVerification, verify_export

GREY = {"diffuse_albedo": [0.4, 0.3, 0.2], "specular_albedo": [0.2] * 3, "roughness": 0.2}


def ball(model: str, **material: object) -> Asset:
    """A unit ball with a texture of soft stripes unless constants are given, under a light that differs everywhere."""
    import trimesh

    shape = trimesh.creation.uv_sphere(radius=1.0, count=[24, 24])
    points = np.asarray(shape.vertices)
    uvs = np.stack([0.5 - np.arctan2(points[:, 0], points[:, 2]) / (2 * np.pi), np.arccos(points[:, 1]) / np.pi], 1)
    stripes = 0.3 + 0.2 * np.sin(np.linspace(0, 12, 64))[:, None, None] * np.ones((64, 64, 3)) * [1, 0.8, 0.5]
    given = {"diffuse_albedo": stripes, "specular_albedo": [0.04] * 3, "roughness": 0.3} | material
    rows, columns = np.mgrid[0:16, 0:32] / 16
    light = np.stack([0.4 + rows, 0.5 + 0.3 * np.sin(3 * columns), 1.2 - rows], axis=-1)
    mesh = AssetMesh(points, points / np.linalg.norm(points, axis=1, keepdims=True), uvs, shape.faces)
    return Asset(mesh, AssetMaterial(model, **given), AssetEnvironment(light), name="ball")  # type: ignore[arg-type]


def verified(asset: Asset, folder: Path, spoil: object = None, **options: object) -> ExportVerification:
    """Writes a .glb, lets `spoil` change the files, verifies."""
    plugins = PluginManager.discover()
    report: ExportReport = plugins.create("exporter", "glb", options).write(asset, folder / "ball.glb")
    if callable(spoil):
        spoil(folder)
    cameras = {str(i): camera for i, camera in enumerate(orbit_cameras(5, 20.0, 96))}
    rerender = Rerender(asset, cameras, np.eye(4), plugins, side=48, samples=16)
    return verify_export(report, asset, options, rerender)


def brighten(folder: Path) -> None:
    """Someone changes the base colour in the file."""
    document = GLTF2().load(str(folder / "ball.glb"))
    document.materials[0].pbrMetallicRoughness.baseColorFactor = [0.7, 0.7, 0.7, 1.0]
    document.save(str(folder / "ball.glb"))


def dim(folder: Path) -> None:
    write_hdr(folder / "ball.hdr", read_hdr(folder / "ball.hdr") * np.float32(0.8))


def shrink(folder: Path) -> None:
    """Someone scales the positions to 0.8."""
    document = GLTF2().load(str(folder / "ball.glb"))
    accessor = document.accessors[document.meshes[0].primitives[0].attributes.POSITION]
    view = document.bufferViews[accessor.bufferView]
    blob = bytearray(document.binary_blob())
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    stop = start + 12 * accessor.count
    points = np.frombuffer(bytes(blob[start:stop]), np.float32) * np.float32(0.8)
    blob[start:stop] = points.astype(np.float32).tobytes()
    document.set_binary_blob(bytes(blob))
    document.save(str(folder / "ball.glb"))


@pytest.mark.parametrize("model", ["paper", "dielectric"])
def test_a_faithful_file_passes(model: str, tmp_path: Path) -> None:
    found = verified(ball(model), tmp_path)
    assert found.warnings == () and found.report["light"] == "ball.hdr"
    assert found.report["psnr"]["object"] > 45 and len(found.report["psnr"]["views"]) == 4
    assert ("paper" in found.report["rendered"]) is (model == "paper")
    assert "re-rendered from 4 cameras" in found.sentence()
    json.dumps(dict(found.report))


def test_lens_distortion_of_photographs_does_not_hinder(tmp_path: Path) -> None:
    """The cameras of a run keep the lenses of their photographs; what is rendered are undistorted photographs."""
    asset, plugins = ball("dielectric"), PluginManager.discover()
    report: ExportReport = plugins.create("exporter", "glb").write(asset, tmp_path / "ball.glb")
    straight = {str(i): camera for i, camera in enumerate(orbit_cameras(2, 20.0, 96))}
    curved = {name: replace(camera, distortion=(0.05, 0.0, 0.0, 0.0)) for name, camera in straight.items()}
    found = [
        verify_export(report, asset, {}, Rerender(asset, cameras, np.eye(4), plugins, side=48, samples=16))
        for cameras in (straight, curved)
    ]
    assert found[0] == found[1] and not found[1].warnings and "psnr" in found[1].report


def test_a_lamp_that_files_cannot_contain_is_no_fault_of_theirs(tmp_path: Path) -> None:
    asset = ball("dielectric")
    assert asset.environment is not None
    lamp = AssetLamp(np.array([9.0, 8.0, 7.0]), np.array([0.2, -0.3, 0.0]), 1.0)
    found = verified(replace(asset, environment=replace(asset.environment, lamp=lamp)), tmp_path)
    assert found.warnings == () and found.report["psnr"]["object"] > 45


@pytest.mark.parametrize(("spoil", "blamed"), [(brighten, "the material"), (dim, "the light"), (shrink, "the mesh")])
def test_what_is_broken_on_disk_is_named(spoil: object, blamed: str, tmp_path: Path) -> None:
    found = verified(ball("dielectric"), tmp_path, spoil)
    assert found.report["psnr"]["object"] < 35
    [sentence] = [w for w in found.warnings if "costs most" in w]
    assert f"{blamed} costs most" in sentence


@pytest.mark.slow
def test_noise_of_few_paths_does_not_count_as_an_error(tmp_path: Path) -> None:
    """The figures of 4 paths a pixel are those of 256."""
    plugins, asset = PluginManager.discover(), ball("dielectric")
    report: ExportReport = plugins.create("exporter", "glb").write(asset, tmp_path / "ball.glb")
    brighten(tmp_path)
    cameras = {str(i): camera for i, camera in enumerate(orbit_cameras(4, 20.0, 96))}
    few, many = (
        verify_export(report, asset, {}, Rerender(asset, cameras, np.eye(4), plugins, side=48, samples=paths)).report
        for paths in (4, 256)
    )
    assert (few["samples"], many["samples"]) == (4, 256)
    assert few["psnr"]["object"] == pytest.approx(many["psnr"]["object"], abs=0.2)
    assert few["costs"]["the material"] == pytest.approx(many["costs"]["the material"], abs=0.2)
    assert few["costs"]["the mesh"] > 60 and few["costs"]["the light"] > 60


def test_what_is_prepared_for_a_mesh_serves_all_parts_that_have_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The fitted scene, the file, its mesh, its material, its light: three times another mesh than before."""
    from hir_plugins.reflectance_renderers.mitsuba_ggx import mitsuba_mesh

    prepared = []

    class Counted(mitsuba_mesh.Surface):
        def __init__(self, mesh: Mesh) -> None:
            prepared.append(mesh)
            super().__init__(mesh)

    monkeypatch.setattr(mitsuba_mesh, "Surface", Counted)
    assert "the light" in verified(ball("dielectric"), tmp_path, brighten).report["costs"]
    assert len(prepared) == 3


def test_a_profile_that_cannot_represent_the_material_is_reported(tmp_path: Path) -> None:
    """Core metallic-roughness has no lobe without Fresnel."""
    asset = ball("paper", **GREY)
    assert verified(asset, tmp_path).warnings == ()
    found = verified(asset, tmp_path, profile="metalrough")
    assert found.report["psnr"]["object"] < 40 and "the material costs most" in found.warnings[0]


def test_a_file_that_is_cut_short_is_a_warning(tmp_path: Path) -> None:
    def cut(folder: Path) -> None:
        (folder / "ball.glb").write_bytes((folder / "ball.glb").read_bytes()[:200])

    found = verified(ball("dielectric"), tmp_path, cut)
    assert "cannot be read back" in found.warnings[0] and "ball.glb" in found.sentence()


def test_a_metallic_asset_is_rendered_from_its_file_as_metallic(tmp_path: Path) -> None:
    """Stripes of half metal, where another reading of the file would show."""
    base, rows = np.full((64, 64, 3), [0.9, 0.6, 0.2]), np.linspace(0, 12, 64)
    metalness = 0.5 + 0.5 * np.sin(rows)[:, None] * np.ones((64, 64))
    asset = replace(ball("dielectric"), material=AssetMaterial.metallic(base, metalness, 0.1))
    found = verified(asset, tmp_path)
    assert found.warnings == () and "as `metallic`" in found.report["rendered"]
    assert found.report["psnr"]["object"] > 50 and found.report["brdf"] < 0.01


@pytest.mark.parametrize(
    ("model", "profile"),
    [
        ("paper", "khr"),
        ("paper", "blender"),
        ("dielectric", "khr"),
        ("dielectric", "blender"),
        ("dielectric", "unity-legacy"),
    ],
)
def test_decoding_undoes_the_conversion(model: str, profile: str) -> None:
    """Before any rounding to 8 bits. What is left out is a least-squares fit, which nothing undoes."""
    material = ball(model, **GREY | {"specular_albedo": [0.1] * 3}).material
    surface = to_gltf(material, profile)  # type: ignore[arg-type]
    specular_surface = surface if profile == "unity-legacy" else None
    back = ReadBack(*[np.zeros((0, 3, 3))] * 3, surface=surface, specular_surface=specular_surface, normal=None)  # type: ignore[arg-type]
    decoded, _ = decode_material(back, profile)
    assert decoded.model == model
    np.testing.assert_allclose(decoded.diffuse_albedo, material.diffuse_albedo, rtol=1e-5)
    np.testing.assert_allclose(decoded.specular_albedo, material.specular_albedo, rtol=1e-5)
    np.testing.assert_allclose(decoded.roughness, material.roughness, rtol=1e-5)


def test_a_run_records_what_was_verified(finished: Run, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stage = finished.directory.read_run()["stages"]["export"]
    report = stage["report"]
    for name in ("glb", "usda", "usdz"):
        verification = report[name]["verified"]
        assert verification["psnr"]["object"] > 40 and verification["positions"] < 1e-6, name
        assert set(verification["health"]) >= {"constant_roughness", "unobserved_share", "shading_correlation"}
    assert report["exr"]["verified"]["mean_radiance"] < 1e-6
    page = (finished.path / "report.html").read_text(encoding="utf-8")
    assert f"{report['glb']['verified']['psnr']['object']:.1f} dB</td>" in page
    with pytest.raises(SystemExit) as stop:
        sizes = ["--height", "0.3", "--pivot", "base"]
        main(["export", str(finished.path), "-f", "glb", "-f", "obj", "-o", str(tmp_path), *sizes])
    assert stop.value.code == 0
    printed = capsys.readouterr().out
    assert "glb: read back" in printed and "re-rendered from 4 cameras" in printed
    [decibels] = re.findall(r"re-rendered from 4 cameras: ([0-9.]+) dB", printed)
    assert float(decibels) > 40, "the cameras move with the asset"
    assert "obj: no independent reader" in printed


def test_a_scene_alone_is_read_back_without_torch(finished: Run, tmp_path: Path) -> None:
    import subprocess
    import sys

    code = (
        "import sys\nfrom hir_core.cli.app import cli\n"
        f"cli.main(['export', {str(finished.directory.scene)!r}, '-f', 'glb', '-o', {str(tmp_path)!r}], "
        "standalone_mode=False)\nassert not {'torch', 'mitsuba'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert "read back" in done.stdout and "not re-rendered: only a run has cameras" in done.stdout


def test_a_light_that_moves_with_the_camera_is_the_runs_own(tmp_path: Path) -> None:
    asset = ball("dielectric")
    assert asset.environment is not None
    carried = replace(
        asset, environment=replace(asset.environment, frame="camera"), provenance={"first_view_camera_to_world": None}
    )
    plugins = PluginManager.discover()
    report = create_exporter("glb").write(asset, tmp_path / "ball.glb")
    cameras = {"a": orbit_cameras(1, 20.0, 48)[0]}
    found = verify_export(report, carried, {}, Rerender(carried, cameras, np.eye(4), plugins, side=48, samples=16))
    assert found.report["light"] == "the run's own" and found.report["psnr"]["object"] > 45


@pytest.mark.parametrize(
    ("report", "sentence"),
    [
        ({"not_read": "no independent reader"}, "no independent reader"),
        ({"mean_radiance": 0.0012}, "read back: mean radiance off by 0.0012"),
        ({"brdf": 0.01}, "read back: material off by 1.0% on the BRDF slice"),
        ({"not_rendered": "no light"}, "read back; not re-rendered: no light"),
        (
            {"psnr": {"object": 41.26, "views": {"a": 40.0, "b": 42.5}}, "engines": {"blender": 50.2, "unity": 31.8}},
            "read back; re-rendered from 2 cameras: 41.3 dB (worst 40.0) against the fitted scene, which "
            "measures the file and not the fit; by the formulas of engines, in dB: blender 50, unity 32",
        ),
    ],
)
def test_what_was_verified_in_one_line(report: dict[str, object], sentence: str) -> None:
    assert ExportVerification(report, ()).sentence() == sentence


def test_a_light_without_counterpart_is_reported(tmp_path: Path) -> None:
    write_hdr(tmp_path / "light.hdr", np.ones((4, 8, 3), np.float32))
    report = ExportReport((tmp_path / "light.hdr",))
    asset = replace(ball("paper"), environment=None)
    found = verify_export(report, asset)
    assert found.report == {"not_read": "the asset has no light"} and found.warnings == ()
    light = np.full((4, 8, 3), 1.1, np.float32)
    [problem] = verify_export(report, replace(asset, environment=AssetEnvironment(light))).warnings
    assert problem == "light.hdr: the light's mean is off by 9.1%"
