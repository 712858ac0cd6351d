"""report.html: its script runs in a browser, its pictures are embedded, its values are escaped."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.asset import AssetMaterial, describe
from hir_exporters.scene_format import save_scene
from hir_exporters.textures.image_files import read_ldr

from hir_core.files.json_documents import read_json, write_json
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.rendering import converged_pair
from hir_core.rendering.reference_renderer import render_view
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.report import (
    convergence,
    embedded_pictures,
    history_chart,
    model_selection_table,
    refresh_page,
    relit_pictures,
    rendered_pictures,
    report_page,
    tables,
)
from hir_core.report.curve_svg import block_means, curve_svg
from hir_core.report.rendered_pictures import light_picture
from hir_core.run.run_directory import STAGE_NAMES, RunDirectory
from hir_core.terminal.run_results import decisions
from hir_core.testing.assets import textured_asset

SHOOT = Path(__file__).resolve().parents[3] / "tools" / "shoot_report.py"


def test_page_works_in_a_browser(finished: Run, chromium: list[str], tmp_path: Path) -> None:
    page = finished.path / "report.html"
    arguments = [
        *chromium,
        f"--user-data-dir={tmp_path}",
        "--dump-dom",
        "--virtual-time-budget=3000",
        page.as_uri(),
    ]
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=90, check=True)
    document = done.stdout
    slides = len(re.findall(r'class="slide', document))
    assert len(re.findall(r'class="slide shown"', document)) == 1, "the script selected the first view"
    assert f"1 of {slides}" in document and len(re.findall(r'class="thumb', document)) == slides
    sources = re.findall(r'<img[^>]* src="([^"]{20})', document)
    assert len(sources) >= 4 * 4 + 2 and all(source.startswith("data:image/jpeg;") for source in sources)
    assert "{{" not in re.sub(r"<(script|style).*?</\1>", "", document, flags=re.S), "every expression is rendered"
    assert re.search(r'<iframe id="model"[^>]* src="blob:', document), "the page of the asset was unpacked"


@pytest.mark.slow
@pytest.mark.parametrize(("theme", "background"), [("light", (0xF6, 0xF5, 0xF2)), ("dark", (0x13, 0x14, 0x17))])
def test_asset_is_drawn_in_either_theme(
    finished: Run, chromium: list[str], tmp_path: Path, theme: str, background: tuple[int, int, int]
) -> None:
    spec = spec_from_file_location("shoot_report", SHOOT)
    assert spec is not None and spec.loader is not None
    tool = module_from_spec(spec)
    spec.loader.exec_module(tool)
    tool.shoot(finished.path / "report.html", tmp_path / "page.png", 1280, 700, theme)
    picture = read_ldr(tmp_path / "page.png")[..., :3] * 255
    assert np.abs(picture[5, 5] - background).max() < 1.5
    # the frame with the asset: right half, below the button; its background is near black
    frame = picture[120:500, 700:1180]
    drawn = np.abs(frame - [0x17, 0x18, 0x1B]).max(axis=2) > 8
    assert 0.05 < drawn.mean() < 0.9, "the asset and the background around it"


def test_large_photographs_are_shown_and_measured_reduced(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    directory = RunDirectory(tmp_path / "run")
    shown = rendered_pictures.write_pictures(directory, PluginManager.discover(), reduced_side=20)
    for view in shown["views"]:
        picture = read_ldr(directory.report / view["fit"])
        assert 20 <= max(picture.shape[:2]) < 40 and view["measured_at"] == list(picture.shape[1::-1])
        assert view["object"] > 15, "the reduced photograph is that of the reduced camera"
    write_json(directory.report / "views.json", shown)
    refresh_page(directory, PluginManager.discover())
    width, height = shown["views"][0]["measured_at"]
    assert f"measured at {width}×{height}" in (directory.path / "report.html").read_text(encoding="utf-8")


def test_few_samples_give_the_figures_of_many(finished: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each view is rendered twice, with independent noise, which the figures then do not contain."""
    shutil.copytree(finished.path, tmp_path / "run")
    directory, plugins = RunDirectory(tmp_path / "run"), PluginManager.discover()
    labels: list[str] = []

    def rendered(renderer: object, scene: object, camera: object, label: str) -> Any:
        if not label.startswith(relit_pictures.RELIT):
            labels.append(label)
        return render_view(renderer, scene, camera, label)  # type: ignore[arg-type]

    monkeypatch.setattr(converged_pair, "render_view", rendered)
    monkeypatch.setattr(converged_pair, "MAX_ROUNDS", 1)
    found = {}
    for samples in (32, 256):
        monkeypatch.setattr(rendered_pictures, "SAMPLES", samples)
        found[samples] = rendered_pictures.write_pictures(directory, plugins)["views"]
    assert len(set(labels)) == 2 * len(found[32]) and len(labels) == 2 * len(set(labels))
    for few, many in zip(found[32], found[256], strict=True):
        assert few["object"] != many["object"], "both are the same renders"
    # a single view with 32 paths varies by 0.07 dB, the mean of four by half of it
    for region in ("object", "frame"):
        few_mean, many_mean = (np.mean([view[region] for view in found[samples]]) for samples in (32, 256))
        assert few_mean == pytest.approx(many_mean, abs=0.08)


def test_metalness_is_shown_where_the_asset_has_it(tmp_path: Path) -> None:
    metalness = np.array([[0.0, 1.0], [0.25, 1.0]])
    for name, m in (("texture", metalness), ("constant", 0.5)):
        asset = replace(textured_asset(), material=AssetMaterial.metallic([0.9, 0.6, 0.2], m, 0.1))
        save_scene(asset, tmp_path / name)
        shown = rendered_pictures.asset_pictures(tmp_path / name)["metalness"]
        np.testing.assert_allclose(shown[..., 0], m if name == "texture" else np.full((32, 32), 0.5))
    save_scene(textured_asset(), tmp_path / "dielectric")
    assert "metalness" not in rendered_pictures.asset_pictures(tmp_path / "dielectric")
    page = embedded_pictures.textures(RunDirectory(tmp_path), describe(asset))
    assert "Metalness, one value" in page and "0.500" in page


def test_history_has_the_figures_of_the_run(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    directory = RunDirectory(tmp_path / "run")
    document, timings = directory.read_run(), directory.read_timings()
    found = convergence.history(directory, document, timings)
    assert [stage for stage, _ in found.ends] == list(STAGE_NAMES)
    assert found.ends[-1][1] == pytest.approx(timings["seconds"], rel=1e-6)
    (stages,) = [series for series in found.series if series.kind == "stages"]
    assert len(stages.psnr) == 2 and stages.psnr[1] > 10, "the first mesh and the finished asset"
    views = read_json(directory.report / "views.json")
    large = np.mean([view["object"] for view in views["views"]])
    assert stages.psnr[1] == pytest.approx(large, abs=0.5), "64 pixels are not reduced"
    # a run on which nothing was measured has a page too
    (directory.report / "views.json").unlink()
    (directory.path / "timings.json").write_text("{}")
    text = refresh_page(directory, PluginManager.discover()).read_text(encoding="utf-8")
    assert "No stage was measured" in text and "There is no view with a mask" in text


def test_history_marks_stages_and_every_point() -> None:
    series = (
        convergence.Series("held <out>", "held-out", (3.0, 6.0, 9.0), (20.0, 24.0, 25.0)),
        convergence.Series("unseen views", "unseen", (10.0,), (24.5,)),
    )
    drawn = history_chart.history_chart(convergence.History(series, (("initializer", 1.0), ("reflectance", 10.0))))
    assert drawn.count("<circle") == 3 + 2 and drawn.count("<polyline") == 1 and "held &lt;out&gt;" in drawn
    assert drawn.count('class="band') == 2 and "reflectance · 9 s" in drawn and "nan" not in drawn
    points = re.findall(r'points="([^"]+)"', drawn)[0].split()
    heights = [float(point.split(",")[1]) for point in points]
    assert heights == sorted(heights, reverse=True), "a larger value is drawn higher"


@pytest.mark.parametrize(("low", "high"), [(0, 1), (0.013, 0.9), (20, 36), (-5, 1e4)])
def test_ticks_are_round_and_inside(low: float, high: float) -> None:
    found = history_chart.ticks(low, high, 6)
    assert 3 <= len(found) <= 8 and found[0] >= low - 1e-9 and found[-1] <= high + 1e-9
    steps = np.diff(found)
    assert np.allclose(steps, steps[0]) and f"{steps[0]:e}"[0] in "125"


def comparison_entry(name: str) -> dict[str, object]:
    return {"model": name, "held_out_db": 20.0, "gain_db": 0.1, "standard_error_db": None, "accepted": True}


REFINEMENT = {
    "renderer": "mitsuba_ggx",
    "before_db": 30.0,
    "after_db": 31.5,
    "gain_db": 1.5,
    "standard_error_db": 0.1,
    "accepted": True,
}


def test_model_selection_shows_times_and_refinements() -> None:
    def section(seconds: list[float], **report: object) -> str:
        return model_selection_table.model_selection({"stages": {"reflectance": {"report": report}}}, seconds)

    entries = [comparison_entry(name) for name in "abc"]
    page = section([2.0, 4.0, 10.0], comparisons=entries, albedo_refinement=REFINEMENT)
    assert re.findall(r">(\d+) s<", page) == ["2", "2", "6"]
    assert "±" in page and page.count("<tr") == 4
    assert "30.00 → 31.50 dB (1.50 ± 0.10 dB): accepted" in page
    untimed = section([], comparisons=entries)
    assert untimed.count('<td class="number">–</td>') == 3 and "solved again" not in untimed
    assert "1.50 ± 0.10 dB" in section([], comparisons=[], model="diffuse", albedo_refinement=REFINEMENT)


def test_a_revised_mesh_is_said() -> None:
    sentence = "the revised mesh is kept: with the revised one held-out views gain 1.4 ± 0.6 dB"
    revision = {"changed": True, "accepted": True, "held_out_views": 6, "near_tie": True, "sentence": sentence}
    report = {"comparisons": [comparison_entry("a")], "revision": revision}
    document = {"stages": {"reflectance": {"report": report}}}
    page = model_selection_table.model_selection(document, [2.0])
    assert f"Material and light showed another mesh; {sentence} (6 views). The gain is within noise." in page
    assert not re.findall(r">(\d+) s<", page), "the times are those of the first mesh"
    assert decisions(document) == {"mesh": sentence}
    report["revision"] = {"changed": False, "accepted": False, "sentence": ""}
    assert "another mesh" not in model_selection_table.model_selection(document, []) and decisions(document) == {}


def test_where_the_scale_comes_from_is_said() -> None:
    report = {"light_scale": {"source": "card", "sentence": "from the card; the light agrees"}}
    document = {"stages": {"reflectance": {"report": report}}}
    page = model_selection_table.model_selection(document, [])
    assert "The scale between albedo and light is from the card; the light agrees." in page
    assert decisions(document) == {"scale": "from the card; the light agrees"}
    report["light_scale"]["source"] = "assumed"
    assert decisions(document) == {}


@pytest.mark.parametrize("source", ["ARKit", ""])
def test_what_gave_the_metres_is_said(source: str) -> None:
    document = {
        "stages": {"initializer": {"report": {"scale_from": source}}},
        "capture": {"views": 12},
        "settings": {"preset": "fast"},
        "seed": 0,
    }
    assert decisions(document) == ({"metres": "from ARKit"} if source else {})
    assert (
        ("Metres from ARKit." in report_page.lead(document)) == ("Metres" in report_page.lead(document)) == bool(source)
    )


def test_a_correction_of_measured_depths_is_said() -> None:
    sentence = "measured depths are 1.20% longer than the scale of the cameras says (± 0.20%); they are corrected"
    document = {
        "stages": {"initializer": {"report": {"depth_scale": {"factor": 0.988, "sentence": sentence}}}},
        "capture": {"views": 12},
        "settings": {"preset": "fast"},
        "seed": 0,
    }
    assert decisions(document) == {"depths": sentence}
    assert f" M{sentence[1:]}. Preset" in report_page.lead(document)
    document["stages"]["initializer"]["report"]["depth_scale"]["sentence"] = ""  # type: ignore[index]
    assert decisions(document) == {} and "easured depths" not in report_page.lead(document)


HYPOTHESES = [
    {"hypothesis": "metal, light in the world", "held_out_db": [20.0, 24.0], "dropped": False},
    {
        "hypothesis": "diffuse, light on the camera",
        "held_out_db": [15.0],
        "dropped": True,
        "margin_db": 5.0,
        "standard_error_db": 0.4,
    },
]
EXPLANATION = {
    "chosen": "metal, light in the world",
    "sentence": "metal, light in the world; next: diffuse, light on the camera, 5.0 ± 0.4 dB worse",
    "held_out_views": 6,
    "near_tie": False,
}


def test_model_selection_shows_hypotheses_and_the_margin() -> None:
    def section(**explanation: object) -> str:
        report = {"hypotheses": HYPOTHESES, "explanation": EXPLANATION | explanation, "comparisons": []}
        return model_selection_table.model_selection({"stages": {"reflectance": {"report": report}}}, [])

    page = section()
    assert "Metal, light in the world; next: diffuse, light on the camera, 5.0 ± 0.4 dB worse (6 held-out" in page
    assert re.findall(r">(selected|dropped|rejected)<", page) == ["selected", "dropped"]
    assert ">24.00<" in page and ">5.00 ± 0.40<" in page and "within noise" not in page
    assert "The margin is within noise" in section(near_tie=True)


LAMP = {
    "took_part": False,
    "compared_with": "diffuse, light in the world",
    "gain_db": 0.3,
    "standard_error_db": 0.4,
    "held_out_views": 6,
    "near_tie": True,
}


def test_decisions_within_noise_are_named() -> None:
    def section(**report: object) -> str:
        return model_selection_table.model_selection({"stages": {"reflectance": {"report": report}}}, [])

    page = section(lamp=LAMP)
    assert "lamp near the camera are not among the hypotheses: a short fit gains 0.3 ± 0.4 dB over diffuse" in page
    assert "The gain is within noise." in page and "within noise" not in section(lamp=LAMP | {"near_tie": False})
    assert ">accepted, within noise<" in section(comparisons=[comparison_entry("a") | {"near_tie": True}])
    refined = section(albedo_refinement=REFINEMENT | {"near_tie": True}, model="diffuse")
    assert "accepted. The gain is within noise." in refined


HOSTILE = "<script>alert(1)</script>\"'onload='x"


def with_hostile_strings(value: object) -> object:
    """The document with every string replaced, and a hostile key added to every table of figures."""
    if isinstance(value, dict):
        return {key: with_hostile_strings(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [with_hostile_strings(inner) for inner in value]
    return HOSTILE if isinstance(value, str) else value


def test_hostile_strings_of_all_documents_are_escaped(finished: Run, tmp_path: Path) -> None:
    shutil.copytree(finished.path, tmp_path / "run")
    directory = RunDirectory(tmp_path / "run")
    document = directory.read_run()
    fixed = {key: document[key] for key in ("format", "version")}
    figures = {"frame": 30.0, "object": 20.0}
    document["metrics"] = {HOSTILE: {"psnr": figures, "psnr_scaled": figures, "light": {"file": HOSTILE}}}
    document["stages"]["reflectance"]["report"] |= {
        "comparisons": [comparison_entry(HOSTILE)],
        "hypotheses": [dict(HYPOTHESES[1])],
        "explanation": dict(EXPLANATION),
        "albedo_refinement": REFINEMENT | {"renderer": HOSTILE},
        "lamp": LAMP | {"compared_with": HOSTILE},
    }
    document["stages"]["bake"]["report"] |= {"diffuse_albedo": HOSTILE, "model": HOSTILE}
    document["stages"]["export"]["report"] = {HOSTILE: {"verified": {"not_read": HOSTILE, "rendered": HOSTILE}}}
    document["stages"]["atlas"]["warnings"] = [HOSTILE]
    document["plugin_problems"] = [HOSTILE]
    write_json(directory.path / "run.json", with_hostile_strings(document) | fixed)  # type: ignore[operator]
    timings = with_hostile_strings(directory.read_timings())
    assert isinstance(timings, dict)
    timings["stages"]["reflectance"]["milestones"] = []
    write_json(directory.path / "timings.json", timings)
    views = read_json(directory.report / "views.json")
    for view in views["views"]:
        view |= {"name": HOSTILE, "measured_at": [640, 480]}
    write_json(directory.report / "views.json", views)
    evaluation = directory.evaluation("test")
    evaluation.mkdir(parents=True)
    for kind in ("true", "fit", "difference"):
        shutil.copy(directory.report / views["views"][0][kind], evaluation / f"0_{kind}.png")
    write_json(evaluation / "metrics.json", {"views": [{"name": HOSTILE, "file": "0.exr", "psnr": figures}]})
    page = refresh_page(directory, PluginManager()).read_text(encoding="utf-8")
    assert page.count("&lt;script&gt;alert(1)") > 20, "the strings are on the page"
    assert "<script>alert" not in page and "'onload='" not in page


def test_steps_of_successive_loops_are_cumulative() -> None:
    np.testing.assert_array_equal(convergence.cumulative_steps(np.array([1, 2, 3, 1, 2])), [1, 2, 3, 4, 5])
    np.testing.assert_array_equal(convergence.cumulative_steps(np.array([5, 10, 15])), [5, 10, 15])


def test_curve_of_many_steps_is_reduced_and_finite() -> None:
    steps, values = block_means(np.arange(10_000.0), np.where(np.arange(10_000) % 7, 1.0, np.nan))
    assert len(steps) == len(values) == 400 and (values == 1).all()
    assert "nan" not in curve_svg("flat <loss>", np.arange(5), np.zeros(5))
    assert "&lt;loss&gt;" in curve_svg("flat <loss>", np.arange(5), np.zeros(5))
    assert curve_svg("one", np.arange(1), np.zeros(1)) == ""


def test_views_are_evenly_spaced_from_first_to_last() -> None:
    assert evenly_spaced_indices(24, 4) == [0, 8, 15, 23]
    assert (
        evenly_spaced_indices(2, 4) == [0, 1]
        and evenly_spaced_indices(1, 4) == [0]
        and evenly_spaced_indices(0, 4) == []
    )


def test_black_light_is_a_black_picture() -> None:
    assert light_picture(np.zeros((4, 8, 3), np.float32)).max() == 0


def test_the_table_of_stages_shows_spikes_of_the_final_mesh() -> None:
    """Both figures of the mesh after the stage; nothing for a stage without a mesh, or of an older run."""
    before, after = {"largest_dihedral_deg": 20.0, "longest_edge_ratio": 1.5}, {"largest_dihedral_deg": 151.2}
    assert tables.spikes({"mesh": {"before": before, "after": after}}) == []
    found = tables.spikes({"mesh": {"before": before, "after": after | {"longest_edge_ratio": 7.04}}})
    assert found == ["largest dihedral angle 151°", "longest edge 7.0 median edges"]
    assert tables.spikes({"iou": 1.0}) == []
