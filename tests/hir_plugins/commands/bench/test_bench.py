"""`hir bench`: measurements, result files, tables, comparisons, references and captures."""

from __future__ import annotations

import json
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import read_ldr

from hir_core.cli import main
from hir_core.errors import InputError
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager
from hir_core.run.machine import high_water_bytes
from hir_core.testing.scenes import looking_at
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.command import SUITE_NAMES
from hir_plugins.commands.bench.inputs import bench_captures, bench_shapes, exact_silhouettes, image_resampling
from hir_plugins.commands.bench.inputs.bench_shapes import bowl
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results import comparison, markdown_tables
from hir_plugins.commands.bench.results.bench_result import Result, Row, Timing
from hir_plugins.commands.bench.results.plot import plot_svg
from hir_plugins.commands.bench.suites import geometry_suite, regularizers_suite, shading_suite
from hir_plugins.commands.bench.suites.suite_registry import SUITES, suite_rows

ROOT = Path(__file__).resolve().parents[4]
SAMPLE = ROOT / "examples" / "sample_capture"


def row(
    method: str, times: tuple[float, float, float], error: float | None = None, size: int = 1, **fields: object
) -> Row:
    errors = {} if error is None else {"error": error}
    return Row({"size": size}, method, "ours", Timing(*times, 3, times[0], 1 << 20), errors, **fields)  # type: ignore[arg-type]


def result(*rows: Row) -> Result:
    return Result("geometry", rows, {"processor": "a", "cores": 2}, {"hir": "1"}, "2026-01-01")


class TestMeasuring:
    def test_times_exclude_the_warm_up(self) -> None:
        calls = []

        def work() -> None:
            calls.append(1)
            time.sleep(0.02)

        found = measure(work, repeats=3)
        assert len(calls) == 4 and found.repeats == 3, "one more for the warm-up"
        assert 0.02 <= found.minimum <= found.median <= found.maximum < 1.0
        assert found.cpu < found.minimum, "sleeping takes no CPU time"

    def test_long_measurements_are_not_repeated(self) -> None:
        assert measure(lambda: time.sleep(0.02), repeats=50, warm_up=False, max_repeat_s=0.05).repeats < 10

    def test_memory_is_that_of_the_call(self) -> None:
        if high_water_bytes() is None:
            pytest.skip("this system does not report the peak memory of a process")
        small = measure(lambda: np.ones(1000), repeats=1)
        large = measure(lambda: np.ones(50 << 17), repeats=1)  # 50 MiB of float64
        assert small.memory_bytes is not None and large.memory_bytes is not None
        assert 45 << 20 < large.memory_bytes < 80 << 20 and small.memory_bytes < 10 << 20


class TestFiles:
    def test_written_results_are_read_unchanged(self, tmp_path: Path) -> None:
        written = result(row("contour", (1.0, 2.0, 3.0), 0.1), Row({"size": 2}, "soft", "peer", None, note="left out"))
        written.write(tmp_path / "a.json")
        assert Result.read(tmp_path / "a.json") == written

    def test_a_result_has_the_commit_of_the_code_and_an_older_file_has_none(self, tmp_path: Path) -> None:
        written = Result("geometry", ())
        if (ROOT / ".git").exists():
            head = subprocess.run(["git", "-C", ROOT, "rev-parse", "HEAD"], capture_output=True, text=True, check=True)
            assert written.commit.removesuffix("-dirty") == head.stdout.strip()
        written.write(tmp_path / "a.json")
        assert Result.read(tmp_path / "a.json") == written
        document = json.loads((tmp_path / "a.json").read_text())
        (tmp_path / "a.json").write_text(json.dumps({k: v for k, v in document.items() if k != "commit"}))
        assert Result.read(tmp_path / "a.json").commit == ""

    def test_the_bowl_is_closed_and_hollow_and_its_inside_faces_the_camera(self) -> None:
        import trimesh

        made = bowl()
        closed = trimesh.Trimesh(made.positions.numpy(), made.faces.numpy(), process=False)
        assert closed.is_watertight and closed.is_winding_consistent and closed.volume > 0
        solid = 2 * np.pi / 3 * (1 - 0.9**3)
        assert closed.volume == pytest.approx(solid, rel=0.01)
        make_bowl, eye = shading_suite.SHADED_MESHES["bowl"]
        assert make_bowl is bowl
        # the ray from the camera to the middle of the inside meets that point first
        queries, down = MeshQueries(closed.vertices, closed.faces), np.array([[0.0, -0.9, 0.0]]) - eye
        assert queries.first_distances(np.array([eye]), down) == pytest.approx([1.0], abs=1e-3)

    @pytest.mark.parametrize(
        "document",
        [{}, *({"format": "hir-bench", "version": 1, "rows": rows} for rows in ([{"case": {}}], [0.5], {"case": {}}))],
    )
    def test_other_files_are_refused(self, document: dict[str, object], tmp_path: Path) -> None:
        (tmp_path / "b.json").write_text(json.dumps(document))
        with pytest.raises(InputError, match=r"b\.json"):
            Result.read(tmp_path / "b.json")

    def test_table_contains_every_figure_and_notes_missing_ones(self) -> None:
        text = markdown_tables.result_markdown(
            result(
                row("contour", (0.001, 0.002, 0.25), 0.00123), Row({"size": 20480}, "b", "peer", None, note="too slow")
            )
        )
        assert "| 1 | contour | 0.001 / 0.002 / 0.25 | 0.001 | 1 MiB | 0.0012 |  |" in text
        assert "| 20,480 | b (peer) | – | – | – | – | too slow |" in text
        assert "a, 2 cores" in text and "2026-01-01" in text
        widths = {line.count("|") for line in text.splitlines() if line.startswith("|")}
        assert len(widths) == 1

    def test_cases_of_different_kinds_are_in_separate_tables(self) -> None:
        fit_rows = Row({"capture": "spot"}, "fit", "ours", Timing(1, 1, 1, 1, 1), {"unseen dB": 30.0})
        text = markdown_tables.result_markdown(result(row("a", (1, 2, 3), 0.1), fit_rows))
        first, second, machine = text.strip().split("\n\n")
        assert first.startswith("| size | method") and "capture" not in first and "30.00" not in first
        assert second.startswith("| capture | method") and "30.00" in second and "a, 2 cores" in machine

    def test_plot_is_the_same_for_the_same_rows(self) -> None:
        pytest.importorskip("matplotlib", reason="pip install 'hir[reconstruct]'")
        rows = result(row("a", (1, 2, 3), 0.1), row("a", (2, 4, 6), 0.05, size=2), row("b", (9, 9, 9)))
        first = plot_svg(rows)
        assert first.startswith("<?xml") and first == plot_svg(rows)
        assert plot_svg(result()) == ""


class TestComparison:
    def test_ratios_and_noise(self) -> None:
        before = result(row("fast", (1.0, 1.1, 1.2), 0.2), row("noisy", (1.0, 2.0, 3.0)), row("gone", (1, 1, 1)))
        after = result(row("fast", (0.5, 0.55, 0.6), 0.1), row("noisy", (1.5, 2.4, 3.5)), row("new", (1, 1, 1)))
        fast, noisy = comparison.compare_results(before, after)
        assert fast.seconds == pytest.approx(0.5) and fast.significant and fast.errors == {"error": pytest.approx(0.5)}
        assert noisy.seconds == pytest.approx(1.2) and not noisy.significant
        text = comparison.comparison_table(before, after)
        assert "1.20 (noise)" in text and "Only in the first: size 1 · gone" in text and "second: size 1 · new" in text

    def test_decibels_are_differences(self) -> None:
        a, b = (Row({}, "fit", "ours", Timing(1, 1, 1, 1, 1), {"unseen dB": v}) for v in (30.0, 31.5))
        assert comparison.compare_results(result(a), result(b))[0].errors == {"unseen dB": pytest.approx(1.5)}


class TestReferences:
    def test_area_of_polygons_is_that_of_a_square(self) -> None:
        corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0.0]])
        view = looking_at((0, 0, 4), 512, 1.4)
        faces = np.array([[0, 1, 2], [0, 2, 3], [0, 1, 2]])
        # the square is 1.4 · 512 / 4 pixels wide; overlapping triangles count once
        assert exact_silhouettes.silhouette_area(corners, faces, view) == pytest.approx((1.4 * 512 / 4) ** 2, rel=1e-12)

    def test_errors_of_exact_and_of_halved_gradients(self) -> None:
        plugins = PluginManager.discover()
        positions, faces = bench_shapes.bumpy_sphere(2)
        derivatives = exact_silhouettes.exact_area_derivatives(positions, faces)
        contour = plugins.create("geometry_renderer", "contour", {})
        found = geometry_suite.relative_errors(
            geometry_suite.overlap_gradients(contour, positions, faces, 512), derivatives, 512
        )
        assert found["gradient error"] < 0.01 and found["area error"] < 1e-3
        # at half the size the same figures hold: they are scaled to one image
        half = geometry_suite.relative_errors(
            geometry_suite.overlap_gradients(contour, positions, faces, 256), derivatives, 256
        )
        assert half["gradient error"] < 0.02

        def half_as_large() -> tuple[list[np.ndarray], list[float]]:
            gradients, areas = geometry_suite.overlap_gradients(contour, positions, faces, 512)()
            return [0.5 * g for g in gradients], [0.5 * a for a in areas]

        assert geometry_suite.relative_errors(half_as_large, derivatives, 512)["gradient error"] == pytest.approx(
            0.5, abs=0.01
        )

    def test_the_slow_method_is_the_reference_of_the_others(self) -> None:
        plugins = PluginManager.discover()
        config = plugins.find("regularizer", "bilateral_specular").component.config
        methods = regularizers_suite.methods_of(config)
        assert regularizers_suite.REFERENCE_METHOD in methods and len(methods) > 1
        assert regularizers_suite.methods_of(plugins.find("regularizer", "laplacian").component.config) == ()


class TestSuites:
    def test_the_command_lists_every_suite(self) -> None:
        assert set(SUITES) == set(SUITE_NAMES)

    def test_sizes_that_would_exceed_the_limit_are_omitted_with_a_note(self) -> None:
        bench_options = BenchOptions(PluginManager.discover(), limit_seconds=1.0)
        slow = Timing(0.4, 0.5, 0.6, 3, 0.4)
        assert (
            bench_options.exceeds_limit(slow, 4)
            and not bench_options.exceeds_limit(slow, 1.5)
            and not bench_options.exceeds_limit(None, 100)
        )
        assert "0.5 s" in bench_options.omission_note(slow)

    @pytest.mark.slow
    def test_quick_regularizers_in_single_precision_are_those_in_double(self) -> None:
        bench_options = BenchOptions(PluginManager.discover(), quick=True, repeats=1)
        rows = {r.method: r for r in suite_rows("regularizers", bench_options)}
        fast = {name for name in rows if ", " in name and not name.endswith(regularizers_suite.REFERENCE_METHOD)}
        assert {"laplacian", "edge_length"} <= set(rows) and fast
        for name, found in rows.items():
            limit = 0.1 if name in fast else 1e-3  # what a fast method approximates; rounding
            assert found.errors["gradient error"] < limit, name

    @pytest.mark.slow
    @pytest.mark.parametrize("suite", ["geometry", "export", "shading"])
    def test_every_suite_without_a_capture_runs(self, suite: str, tmp_path: Path) -> None:
        with pytest.raises(SystemExit) as stop:
            main(["bench", suite, "--quick", "--repeats", "1", "--no-peers", "-o", str(tmp_path), "-q"])
        assert stop.value.code == 0
        found = Result.read(tmp_path / f"{suite}.json")
        assert found.rows and all(r.timing is not None or r.note for r in found.rows)
        assert (tmp_path / f"{suite}.svg").stat().st_size > 1000

    def test_a_capture_without_a_true_mesh_writes_no_result(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        with pytest.raises(SystemExit) as stop:
            main(["bench", "initializers", "--capture", str(SAMPLE), "-o", str(tmp_path)])
        assert stop.value.code == 0 and "nothing was measured" in capsys.readouterr().err
        assert not list(tmp_path.iterdir())

    def test_invalid_arguments_are_named(self, capsys: pytest.CaptureFixture[str]) -> None:
        for arguments, message in (
            (["bench", "speed"], "there is no suite 'speed'"),
            (["bench", "end-to-end"], "--capture DIR"),
        ):
            with pytest.raises(SystemExit) as stop:
                main(arguments)
            assert stop.value.code == 2 and message in capsys.readouterr().err


class TestCaptures:
    def test_reduced_captures_keep_colours_and_every_other_split(self, tmp_path: Path) -> None:
        folder = bench_captures.make_reduced_capture(SAMPLE, tmp_path / "small", 5, 64)
        frames = json.loads((folder / "transforms_train.json").read_text())["frames"]
        assert len(frames) == 5 and bench_captures.capture_size(folder) == (5, 64)
        assert bench_captures.capture_size(SAMPLE) == (24, 256)
        name = Path(frames[0]["file_path"]).with_suffix(".png")
        small, large = read_ldr(folder / name), read_ldr(SAMPLE / name)
        assert small.shape == (64, 64, 4)
        np.testing.assert_allclose(small[..., 3].mean(), large[..., 3].mean(), atol=0.5 / 255)
        assert (folder / "transforms_relight_0.json").is_file() and list(folder.glob("*.hdr"))

    def test_resized_captures_repeat_views_and_enlarge_images(self, tmp_path: Path) -> None:
        folder = bench_captures.make_resized_capture(SAMPLE, tmp_path / "large", 26, 320)
        frames = json.loads((folder / "transforms_train.json").read_text())["frames"]
        assert len(frames) == 26 and bench_captures.capture_size(folder) == (26, 320)
        assert frames[25]["transform_matrix"] == frames[1]["transform_matrix"]
        enlarged = read_ldr(folder / Path(frames[1]["file_path"]).with_suffix(".png"))
        original = json.loads((SAMPLE / "transforms_train.json").read_text())["frames"][1]
        small = read_ldr(SAMPLE / Path(original["file_path"]).with_suffix(".png"))
        assert enlarged.shape == (320, 320, 4)
        np.testing.assert_allclose(enlarged[..., 3].mean(), small[..., 3].mean(), atol=2 / 255)
        fewer = bench_captures.make_resized_capture(SAMPLE, tmp_path / "small", 5, 64)
        assert bench_captures.capture_size(fewer) == (5, 64)

    def test_reducing_averages_light_where_it_is_covered(self) -> None:
        picture = np.zeros((2, 2, 4), np.float32)
        picture[0, 0] = [1, 1, 1, 1]
        picture[0, 1] = [0, 0, 0, 1]
        (pixel,) = image_resampling.downsample_rgba(picture, 2).reshape(-1, 4)
        # half of the light, in sRGB; two of four pixels are covered
        np.testing.assert_allclose(pixel, [0.7353569, 0.7353569, 0.7353569, 0.5], atol=1e-6)
