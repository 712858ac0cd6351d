"""`hir bench materials`: captures, errors of material parameters, resumption, regret, spread and the bar."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import write_png

from benchmarks.materials.__main__ import write_index
from benchmarks.materials.recipes import recipes
from hir_core.capture import Capture, Pixels, View
from hir_core.cli import main
from hir_core.config import load_config
from hir_core.errors import ConfigError, InputError
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.run.run_directory import RunDirectory
from hir_core.scene import Material, Scene
from hir_core.testing.scenes import looking_at, smooth_sphere
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.inputs.materials_captures import MaterialsCapture, find_captures
from hir_plugins.commands.bench.inputs.parameter_errors import parameter_errors
from hir_plugins.commands.bench.inputs.simplified_truth import write_simplified
from hir_plugins.commands.bench.materials_options import MaterialsOptions, parse_seeds
from hir_plugins.commands.bench.results.bench_result import Result, Row, Timing
from hir_plugins.commands.bench.results.markdown_tables import result_markdown
from hir_plugins.commands.bench.results.materials_summary import (
    BARS,
    is_right_kind,
    materials_summary,
    seed_variation_table,
)
from hir_plugins.commands.bench.suites import materials_run, materials_suite
from hir_plugins.commands.bench.suites.forced_hypotheses import forcing_settings, hypotheses
from hir_plugins.commands.bench.suites.materials_run import RunFigures, current_key, run_figures

PLUGINS = PluginManager.discover()
TRUTH = {"kind": "metal", "light_frame": "camera", "within_model": True}


def made(root: Path, *names: str, **truth: object) -> None:
    """An index of the benchmark, and folders of captures that hold only their truth."""
    write_index(root)
    halves = {recipe.name: recipe.half for recipe in recipes()}
    for name in names:
        folder = root / halves[name] / name
        folder.mkdir(parents=True)
        (folder / "truth.json").write_text(json.dumps(TRUTH | truth))


def selected(capture: str = "a", seed: int = 0, half: str = "tuning", **errors: float) -> Row:
    labels = {
        "light": "world",
        "true light": "world",
        "kind": "metal",
        "true kind": "metal",
        "margin": "",
        "model": "m",
    }
    case = {"half": half, "capture": capture, "mesh": "truth", "seed": seed}
    return Row(case, "selected", "ours", Timing(1, 1, 1, 1, 1), errors, labels=labels)


class TestCaptures:
    def test_rendered_captures_of_a_half_are_found_and_the_others_are_missing(self, tmp_path: Path) -> None:
        made(tmp_path, "00_block_matt_overcast", "14_bowl_matt_sun")
        tuning = find_captures(tmp_path, ("tuning",))
        assert [c.name for c in tuning.captures] == ["00_block_matt_overcast"] and len(tuning.missing) == 27
        found = tuning.captures[0]
        assert (found.kind, found.light_frame, found.within_model, found.half) == ("metal", "camera", True, "tuning")
        both = find_captures(tmp_path, ("tuning", "validation"), ("00", "14_bowl_matt_sun", "15"))
        assert [c.half for c in both.captures] == ["tuning", "validation"]
        assert both.missing == {"15_mug_plastic_rough_two_colors": "validation"}

    def test_missing_and_damaged_captures_are_one_sentence_with_the_remedy(self, tmp_path: Path) -> None:
        with pytest.raises(InputError, match=r"make it with: python -m benchmarks\.materials make"):
            find_captures(tmp_path, ("tuning",))
        write_index(tmp_path)
        with pytest.raises(InputError, match=r"render them with: .*--only 00 01$"):
            find_captures(tmp_path, ("tuning",), ("00", "01"))
        with pytest.raises(InputError, match="no capture '14' in the half tuning"):
            find_captures(tmp_path, ("tuning",), ("14",))
        made(tmp_path, "00_block_matt_overcast", kind="wood")
        with pytest.raises(InputError, match=r"truth\.json is damaged"):
            find_captures(tmp_path, ("tuning",))
        (tmp_path / "captures.json").write_text('{"captures": {"00": "third"}}')
        with pytest.raises(InputError, match=r"captures\.json is damaged"):
            find_captures(tmp_path, ("tuning",))


class TestParameterErrors:
    @pytest.fixture
    def capture(self) -> Capture:
        pixels = Pixels(np.zeros((24, 24, 3), np.float32), np.ones((24, 24), np.float32), np.zeros((24, 24), bool))
        return Capture(Path("formula"), (View("test/000.png", looking_at((0, 0, 4), 24), lambda: pixels),))

    @staticmethod
    def write_truth(folder: Path, base: float, metallic: np.ndarray, roughness: float) -> None:
        folder.mkdir()
        shape, alpha = (24, 24, 3), np.ones((24, 24, 1))
        pictures = {
            "base_color": np.full(shape, linear_to_srgb(np.array(base))),
            "metallic": np.broadcast_to(metallic, shape),
            "roughness": np.full(shape, roughness),
        }
        for name, picture in pictures.items():
            write_png(folder / f"000_{name}.png", np.concatenate([picture, alpha], axis=-1).astype(np.float32))

    def test_known_differences_come_back(self, capture: Capture, tmp_path: Path) -> None:
        """Base colour half as bright: 0 dB of error once scaled; metalness .2 and roughness .3 off."""
        self.write_truth(tmp_path / "truth", 0.4, np.full((1, 1, 1), 0.8), 0.5)
        material = Material.metallic(torch.full((3,), 0.2), torch.ones(1), torch.tensor([0.64]))
        found = parameter_errors(Scene(smooth_sphere(3), material), capture, tmp_path / "truth")
        assert found.errors["metalness error"] == pytest.approx(0.2, abs=0.003), "8 bits"
        assert found.errors["roughness error"] == pytest.approx(0.3, abs=0.003), "glTF's roughness is √α"
        expected = -20 * np.log10(float(linear_to_srgb(np.array(0.4)) - linear_to_srgb(np.array(0.2))))
        assert found.errors["base colour dB"] == pytest.approx(expected, abs=0.2)
        assert found.errors["base colour scaled dB"] > 45
        assert found.metal_share == 1 and found.kind(material) == "metal"

    def test_a_model_without_metalness_has_its_diffuse_albedo_as_base_colour(
        self, capture: Capture, tmp_path: Path
    ) -> None:
        self.write_truth(tmp_path / "truth", 0.3, np.zeros((1, 1, 1)), 0.5)
        matt = Material("dielectric", torch.full((3,), 0.3), torch.zeros(1), torch.ones(1))
        found = parameter_errors(Scene(smooth_sphere(3), matt), capture, tmp_path / "truth")
        assert found.errors["base colour dB"] > 45 and found.errors["metalness error"] == 0
        assert "roughness error" not in found.errors, "without a lobe there is no roughness"
        assert found.kind(matt) == "diffuse"
        assert found.kind(replace(matt, specular_albedo=torch.full((1,), 0.04))) == "dielectric"

    @pytest.mark.parametrize(("share", "kind"), [(0.02, "dielectric"), (0.5, "mixed"), (0.98, "metal")])
    def test_the_kind_is_that_of_the_pixels(self, share: float, kind: str, capture: Capture, tmp_path: Path) -> None:
        self.write_truth(tmp_path / "truth", 0.3, np.zeros((1, 1, 1)), 0.5)
        material = Material.metallic(torch.full((3,), 0.5), torch.zeros(1), torch.ones(1))
        found = parameter_errors(Scene(smooth_sphere(3), material), capture, tmp_path / "truth")
        assert replace(found, metal_share=share).kind(material) == kind


def test_the_true_mesh_keeps_its_surface_with_fewer_triangles(tmp_path: Path) -> None:
    sphere = trimesh.creation.icosphere(subdivisions=4)
    sphere.export(tmp_path / "reference.obj")
    write_simplified(tmp_path / "reference.obj", tmp_path / "few" / "mesh.ply", 2000)
    found = trimesh.load(tmp_path / "few" / "mesh.ply", process=False)
    assert 1900 <= len(found.faces) <= 2000 < len(sphere.faces)
    assert np.abs(np.linalg.norm(found.vertices, axis=1) - 1).max() < 0.005 and found.is_watertight
    write_simplified(tmp_path / "reference.obj", tmp_path / "all.ply")
    assert len(trimesh.load(tmp_path / "all.ply", process=False).faces) == len(sphere.faces), "few enough already"


class TestRuns:
    @pytest.fixture
    def capture(self, tiny_capture: Path, tmp_path: Path) -> MaterialsCapture:
        """The tiny capture with made-up truth: white, no metal, roughness 1."""
        folder = tmp_path / "tuning" / "tiny"
        shutil.copytree(tiny_capture, folder)
        (folder / "truth_test").mkdir()
        for frame in json.loads((folder / "transforms_test.json").read_text())["frames"]:
            for name, value in {"base_color": 1.0, "metallic": 0.0, "roughness": 1.0}.items():
                picture = np.full((64, 64, 4), value, np.float32)
                picture[..., 3] = 1
                write_png(folder / "truth_test" / f"{Path(frame['file_path']).stem}_{name}.png", picture)
        return MaterialsCapture(folder, "tuning", "dielectric", "world", True)

    def test_a_run_is_measured_once_and_again_for_other_code(
        self, capture: MaterialsCapture, finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        runs: list[tuple[str, ...]] = []

        def reconstruct(source: Path, folder: Path, *, assignments: tuple[str, ...], **more: object) -> Run:
            runs.append(assignments)
            shutil.copytree(finished.path, folder)
            return Run(RunDirectory(folder), ())

        monkeypatch.setattr(materials_run, "reconstruct", reconstruct)
        monkeypatch.setattr(materials_run, "write_simplified", lambda source, mesh: None)
        monkeypatch.setattr(materials_run, "PATHS_PER_PIXEL", 4)
        key = replace(current_key(capture, "truth", 3), commit="1" * 40)
        first = run_figures(key, capture, tmp_path, PLUGINS)
        assert first.kind == "diffuse" and first.light_frame == "world" and first.model == "diffuse"
        assert 10 < first.errors["unseen dB, object"] < first.errors["unseen dB, frame"]
        assert first.errors["metalness error"] == 0 and first.errors["base colour dB"] < 30
        assert first.errors["relit scaled dB, frame"] > 10 and first.timing.cpu > 0
        assert first.margin_within_noise is None, "this run compared nothing"
        assert "seed=3" in runs[0] and "geometry.enabled=false" in runs[0]
        assert run_figures(key, capture, tmp_path, PLUGINS) == first and len(runs) == 1
        run_figures(replace(key, commit="2" * 40), capture, tmp_path, PLUGINS)
        assert len(runs) == 2, "another commit"
        for _ in range(2):
            run_figures(replace(key, commit="1" * 40 + "-dirty"), capture, tmp_path, PLUGINS)
        assert len(runs) == 4, "nobody knows which changes a result of changed files had"
        assert not [path for path in tmp_path.rglob("run.json") if "tuning" not in path.parts], "runs are deleted"

    def test_regret_is_what_the_best_forced_hypothesis_has_more(
        self, capture: MaterialsCapture, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def figures(key: materials_run.RunKey, *rest: object) -> RunFigures:
            level = 30.0 + (1.5 if "reflectance.light_frame=camera" in key.settings else 0.0) - len(key.settings)
            errors = {"unseen dB, object": level + key.seed}
            return RunFigures("metal", "camera", "m", errors, Timing(1, 1, 1, 1, 1), {}, {}, key.seed == 1)

        monkeypatch.setattr(materials_suite, "run_figures", figures)
        options = MaterialsOptions(tmp_path, seeds=(0, 1), mesh="truth", regret=True, settings=("atlas.padding=2",))
        bench = BenchOptions(PLUGINS, materials=options, workspace=tmp_path)
        write_index(tmp_path)
        (tmp_path / "tuning" / "00_block_matt_overcast").mkdir()
        shutil.move(capture.folder, tmp_path / "tuning" / "tiny")
        (tmp_path / "tuning" / "00_block_matt_overcast" / "truth.json").write_text(json.dumps(TRUTH))
        rows = list(materials_suite.materials_rows(bench))
        chosen = [row for row in rows if row.method == "selected" and row.timing]
        assert [row.errors["regret dB"] for row in chosen] == [pytest.approx(-0.5)] * 2
        assert [row.labels["margin"] for row in chosen] == ["clear", "within noise"]
        assert len([row for row in rows if row.method.startswith("forced")]) == 2 * len(hypotheses())
        assert len([row for row in rows if row.note == "not rendered"]) == 27


class TestHypotheses:
    def test_each_is_a_setting_that_exists(self) -> None:
        found = hypotheses()
        assert {"diffuse", "dielectric"} <= {hypothesis.kind for hypothesis in found}
        for hypothesis in found:
            reflectance = load_config(PLUGINS, assignments=hypothesis.assignments).reflectance
            assert reflectance.light_frame == hypothesis.light_frame
            assert (reflectance.brdf, reflectance.model) != ("auto", "auto"), hypothesis.name

    def test_kinds_are_those_that_the_settings_express(self) -> None:
        assert list(forcing_settings(frozenset({"auto", "paper", "dielectric"}))) == ["diffuse", "dielectric"]
        named = forcing_settings(frozenset({"auto", "diffuse", "dielectric", "metal", "mixed"}))
        assert named["metal"] == ("reflectance.brdf=metal",) and named["diffuse"] == ("reflectance.brdf=diffuse",)
        metallic = forcing_settings(frozenset({"auto", "dielectric", "metallic"}))
        assert metallic["mixed"] == ("reflectance.brdf=metallic", "reflectance.metalness=map")


class TestSummary:
    def test_figures_against_the_bar(self) -> None:
        good = [
            selected(f"c{i}", **{"unseen dB, object": 36.0, "relit scaled dB, frame": 33.0, "regret dB": 0.1})
            for i in range(3)
        ]
        bad = selected("d", **{"unseen dB, object": 20.0, "relit scaled dB, frame": 10.0, "regret dB": 5.0})
        bad = replace(bad, labels=bad.labels | {"light": "camera", "kind": "dielectric"})
        texts = {bar.name: bar.text([*good, bad]) for bar in BARS}
        assert texts["right light frame"] == "75 % ✗" and texts["regret at most 0.3 dB"] == "75 % ✗"
        assert texts["right kind, margin not within noise"] == "75 % ✗"
        assert texts["median unseen, object"] == "36.0 dB ✓" and texts["median relit (scaled), frame"] == "33.0 dB ✓"
        flagged = replace(bad, labels=bad.labels | {"margin": "within noise"})
        assert BARS[1].text([*good, flagged]) == "100 % ✓", "a flagged margin is not counted"
        assert BARS[1].text([flagged]) == "–"

    def test_a_diffuse_model_of_a_dielectric_is_right_and_of_a_metal_is_not(self) -> None:
        row = selected()
        diffuse = row.labels | {"kind": "diffuse"}
        assert is_right_kind(replace(row, labels=diffuse | {"true kind": "dielectric, outside the model"}))
        assert not is_right_kind(replace(row, labels=diffuse))

    def test_halves_and_captures_outside_the_model_are_separate(self) -> None:
        outside = selected("b", **{"unseen dB, object": 20.0})
        outside = replace(outside, labels=outside.labels | {"true kind": "dielectric, outside the model"})
        rows = [selected("a", **{"unseen dB, object": 35.0}), outside, selected("c", half="validation")]
        missing = Row(
            {"half": "tuning", "capture": "e", "mesh": "truth", "seed": 0},
            "selected",
            "ours",
            None,
            note="not rendered",
        )
        text = materials_summary([*rows, missing])
        assert "| tuning | truth | 2 all | 100 % ✓ | 50 % ✗ | – | 27.5 dB ✗ | – |" in text
        assert "| tuning | truth | 1 within the model | 100 % ✓ | 100 % ✓ | – | 35.0 dB ✓ | – |" in text
        assert "| validation | truth | 1 all |" in text and text.endswith("1 captures are not rendered: e.")

    def test_spread_is_the_standard_deviation_over_seeds(self) -> None:
        rows = [selected("a", seed, **{"unseen dB, object": level}) for seed, level in enumerate((30.0, 31.0, 32.0))]
        assert "| a | truth | 3 | 31.00 | 1.00 | m |" in seed_variation_table([*rows, selected("b")])
        assert seed_variation_table(rows[:1]) == ""

    def test_labels_are_columns_and_survive_the_file(self, tmp_path: Path) -> None:
        result = Result("materials", (selected("a", **{"unseen dB, object": 35.0}),))
        result.write(tmp_path / "materials.json")
        assert Result.read(tmp_path / "materials.json") == result
        text = result_markdown(result)
        assert "| method | light | true light | kind | true kind | margin | model |" in text
        assert "| world | world | metal | metal | – | m |" in text and "35.0 dB ✓" in text


class TestCommand:
    def test_options_of_the_suite_are_refused_without_it_and_need_their_folder(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        for arguments, message in (
            (["bench", "materials"], "--materials DIR"),
            (["bench", "materials", "--materials", str(tmp_path)], "benchmarks.materials make"),
            (["bench", "geometry", "--regret", "--half", "both"], "--half, --regret: only the suite materials"),
            (["bench", "materials", "--materials", str(tmp_path), "--seeds", "1,1"], "--seeds '1,1'"),
        ):
            with pytest.raises(SystemExit) as stop:
                main(arguments)
            assert stop.value.code == 2 and message in capsys.readouterr().err

    def test_seeds(self) -> None:
        assert parse_seeds("0,2, 5") == (0, 2, 5)
        for text in ("", "a", "-1", "0,0", "1.5"):
            with pytest.raises(ConfigError):
                parse_seeds(text)
