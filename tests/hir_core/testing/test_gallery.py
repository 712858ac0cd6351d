"""Each plugin of examples/gallery keeps its contracts and does its work in a run."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from hir_core.cli.app import cli
from hir_core.pipeline import Run, reconstruct
from hir_core.plugins.manager import PluginManager
from hir_core.testing import check_component, check_whole_plugin, whole_plugin
from hir_core.testing.captures import tiny_capture
from hir_core.testing.running import named
from tests.fixtures.command_line import hir
from tests.fixtures.runs import QUICK, make_tiny

GALLERY = Path(__file__).resolve().parents[3] / "examples" / "gallery"
PLUGINS = sorted(path.stem for path in GALLERY.glob("*.py"))

EXPECTED_FAILURES = {"lambert_sh": {"agrees_with_the_reference": "nine harmonics cast no shadows"}}


def loaded(name: str) -> tuple[PluginManager, str]:
    path = str(GALLERY / f"{name}.py")
    return PluginManager.discover((path,)), path


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if name == "lambert_sh" else []) for name in PLUGINS]
)
def test_keeps_its_contracts_and_fits_a_page(name: str) -> None:
    plugins, path = loaded(name)
    subject = whole_plugin(path, plugins)
    assert subject is not None
    check_whole_plugin(subject)
    for registered in named(path, plugins):
        check_component(registered, plugins=plugins, expected_failures=EXPECTED_FAILURES.get(name))
    assert len(Path(path).read_text(encoding="utf-8").splitlines()) < 160


def test_symmetry_is_zero_for_a_mirrored_shape_and_pulls_a_dent_out() -> None:
    torch = pytest.importorskip("torch")
    from hir_core.scene import Scene
    from hir_core.testing.scenes import sphere

    plugins, _ = loaded("symmetry")
    mesh = sphere(12, 16, dtype=torch.float64)
    assert float(plugins.create("regularizer", "symmetry").prepare(Scene(mesh))(Scene(mesh))) < 1e-20
    dented = mesh.positions.clone()
    right = dented[:, 0] > 0.9
    dented[right, 0] -= 0.15
    scene = Scene(mesh.with_positions(dented))
    energy = plugins.create("regularizer", "symmetry", {"reach": 0.5}).prepare(scene)
    positions = dented.clone().requires_grad_()
    (gradient,) = torch.autograd.grad(energy(Scene(mesh.with_positions(positions))), positions)
    assert float(gradient[right, 0].mean()) < 0, "a step against the gradient moves the dent outwards"


def test_nsvf_names_say_the_split(tmp_path: Path) -> None:
    plugins, _ = loaded("nsvf")
    written = import_module("hir_plugin_nsvf").write_sample(tiny_capture(tmp_path, 4, 24).capture, tmp_path)
    reader = plugins.create("capture_reader", "nsvf")
    assert reader.splits(written) == ["train"]
    for folder, suffix in (("pose", "txt"), ("rgb", "png")):
        shutil.move(written / folder / f"0_0002.{suffix}", written / folder / f"2_0002.{suffix}")
    assert [view.name for view in reader.read(written).views] == ["0_0000", "0_0001", "0_0003"]
    assert [view.name for view in reader.read(written, "test").views] == ["2_0002"]


def test_web_glb_is_smaller_and_needs_no_extension(tmp_path: Path) -> None:
    import pygltflib

    from hir_core.testing.assets import textured_asset

    plugins, _ = loaded("web_glb")
    report = plugins.create("exporter", "web.glb", {"warn_above": 1e-6}).write(textured_asset(), tmp_path / "a.web.glb")
    assert pygltflib.GLTF2().load(str(tmp_path / "a.web.glb")).extensionsRequired == []
    assert any("reduce texture_size" in warning for warning in report.warnings)


@pytest.mark.slow
def test_ranges_and_units_are_in_its_errors_and_details(capsys: pytest.CaptureFixture[str]) -> None:
    _, path = loaded("web_glb")
    assert hir("plugins", "web.glb", "--plugin", path) == 0
    said = capsys.readouterr().out
    assert "texture_size  (integer, default 1024, 16 … 8192 pixels)" in said
    assert "Larger textures are reduced" in said and "trait gltf" in said
    _, path = loaded("symmetry")
    assert hir("config", "show", "--plugin", path, "--set", "geometry.regularizers.symmetry.reach=3") == 2
    assert "option 'reach' is 3; it must be > 0 and ≤ 1" in capsys.readouterr().err
    assert hir("config", "schema", "--plugin", path) == 0
    schema = json.loads(capsys.readouterr().out)["components"]["regularizer"]["symmetry"]["properties"]["reach"]
    assert (schema["exclusiveMinimum"], schema["maximum"]) == (0, 1)


def test_compare_runs_prints_what_differs(tmp_path: Path) -> None:
    plugins, _ = loaded("compare_runs")
    for name, seed in (("first", 1), ("second", 2)):
        run = tmp_path / name
        run.mkdir()
        document = {"settings": {"seed": seed, "device": "cpu"}, "stages": {"geometry": {"report": {"iou": 0.9}}}}
        (run / "run.json").write_text(json.dumps(document))
        (run / "timings.json").write_text(json.dumps({"stages": {"geometry": {"seconds": 2.0 * seed}}}))
    arguments = ["compare-runs", str(tmp_path / "first"), str(tmp_path / "second"), "--json"]
    done = CliRunner().invoke(cli, arguments, obj={"plugins": plugins}, catch_exceptions=False)
    assert json.loads(done.output)["rows"] == {"settings.seed": [1, 2], "geometry.seconds": [2.0, 4.0]}


@pytest.mark.slow
def test_term_observer_and_format_take_part_in_a_run(tmp_path: Path, quick: Callable[..., Run]) -> None:
    plugins = PluginManager.discover(
        tuple(str(GALLERY / f"{name}.py") for name in ("symmetry", "metrics_log", "web_glb"))
    )
    capture = make_tiny(tmp_path / "capture")
    settings = ("geometry.regularizers.symmetry.weight=10", "observers.metrics_log={}", 'export=["web.glb"]')
    run = quick(capture, tmp_path / "run", *settings, plugins=plugins)
    lines = [json.loads(line) for line in (run.path / "metrics" / "log.jsonl").read_text().splitlines()]
    assert {line["stage"] for line in lines} >= {"geometry", "reflectance"}
    assert any("symmetry" in line["name"] for line in lines)
    assert "<polyline" in (run.path / "metrics" / "index.html").read_text()
    assert any(file.name.endswith(".web.glb") for file in (run.path / "exports").iterdir())
    assert run.directory.read_run()["plugin_problems"] == []


@pytest.mark.slow
def test_lambert_harmonics_fit_a_capture(tmp_path: Path) -> None:
    plugins, _ = loaded("lambert_sh")
    capture = make_tiny(tmp_path / "capture")
    settings = ("reflectance.renderer=lambert_sh", "reflectance_renderer.lambert_sh.steps=60", 'export=["glb"]')
    common = [each for each in QUICK if "transport_ggx" not in each and "light_frame" not in each]
    run = reconstruct(capture, tmp_path / "run", assignments=(*common, *settings), device="cpu", plugins=plugins)
    report: Any = run.directory.read_run()["stages"]["reflectance"]["report"]
    assert report["method"] == "solver" and report["model"].startswith("diffuse")


@pytest.mark.slow
def test_nsvf_capture_becomes_a_run(tmp_path: Path, quick: Callable[..., Run]) -> None:
    plugins, _ = loaded("nsvf")
    written = tmp_path / "capture"
    written.mkdir()
    import_module("hir_plugin_nsvf").write_sample(tiny_capture(tmp_path, 12, 64).capture, written)
    masks = 'masks=["color_key"]'
    run = quick(written, tmp_path / "run", masks, "reflectance.enabled=false", "export=[]", plugins=plugins)
    assert run.directory.read_run()["capture"]["reader"] == "nsvf"
    assert (run.directory.path / "report.html").is_file()
