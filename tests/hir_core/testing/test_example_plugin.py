"""examples/hir-plugin-example, installed into an environment of its own, is found and keeps every contract."""

from __future__ import annotations

import json
import shutil
import site
from pathlib import Path

import pytest

from tests.fixtures.runs import QUICK
from tests.fixtures.virtual_environments import EXAMPLE, environment_python, message, packages_of


@pytest.fixture(scope="module")
def python(wheels: list[Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The Python of an environment with the wheels of hir and of the example; their dependencies are borrowed from the
    environment that runs the tests, for torch and mitsuba take minutes to install.
    """
    found = environment_python(tmp_path_factory.mktemp("example") / "venv", *wheels)
    borrowed = [path for path in site.getsitepackages() if path.endswith("site-packages")]
    # a line of a .pth that begins with import is run: the borrowed packages come after the environment's own
    lines = "".join(f"import sys; sys.path.append({path!r})\n" for path in borrowed)
    (packages_of(found) / "borrowed.pth").write_text(lines)
    return found


@pytest.mark.slow
def test_its_components_are_found_by_installation(python: Path, tmp_path: Path) -> None:
    code = "import hir_core, hir_example; print(hir_core.__file__); print(hir_example.__file__)"
    for place in message(python, "-c", code, folder=tmp_path).split():
        assert Path(place).is_relative_to(python.parents[1]), "nothing is taken from the checkout"
    listed = json.loads(message(python, "-m", "hir_core.cli", "plugins", "--json", folder=tmp_path))
    assert listed["problems"] == []
    ours = {(row["kind"], row["name"]) for row in listed["components"] if row["distribution"] == "hir-plugin-example"}
    assert ours == {
        ("regularizer", "light_chroma"),
        ("geometry_renderer", "midpoint_outline"),
        ("reflectance_renderer", "supersampled"),
        ("exporter", "ply"),
    }


def test_its_preset_page_ranges_and_units_are_shown(python: Path, tmp_path: Path) -> None:
    said = message(python, "-m", "hir_core.cli", "plugins", "light_chroma", "--docs", folder=tmp_path)
    assert "floor  (number, default 0.05, ≥ 0)" in said and "\n# light_chroma\n" in said
    assert "trait environment: the term depends on the light" in said
    shown = message(python, "-m", "hir_core.cli", "config", "show", "--preset", "grey_light", folder=tmp_path)
    assert "light_chroma" in shown


@pytest.mark.slow
def test_it_keeps_every_contract(python: Path, tmp_path: Path) -> None:
    arguments = [python, "-m", "hir_core.cli", "check-plugin", "hir-plugin-example", "--json"]
    results = json.loads(message(*arguments, folder=tmp_path))["results"]
    assert {r["outcome"] for r in results} <= {"passed", "skipped"}
    assert sum(r["outcome"] == "passed" for r in results) > 60


@pytest.mark.slow
def test_its_own_tests_pass(python: Path, tmp_path: Path) -> None:
    shutil.copytree(EXAMPLE / "tests", tmp_path / "tests")
    summary = message(python, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests", folder=tmp_path).splitlines()[-1]
    assert "passed" in summary and "failed" not in summary


@pytest.mark.slow
def test_it_is_used_by_a_run_and_an_export(python: Path, tiny_capture: Path, tmp_path: Path) -> None:
    settings = (
        *(setting for setting in QUICK if not setting.startswith("reflectance_renderer.transport_ggx.steps")),
        "geometry.renderer=midpoint_outline",
        "reflectance.method=gradient",
        "reflectance.gradient.iterations=10",
        "reflectance.regularizers.light_chroma.weight=10",
        'export=["ply"]',
    )
    assignments = [word for setting in settings for word in ("--set", setting)]
    run = tmp_path / "run"
    message(python, "-m", "hir_core.cli", "reconstruct", tiny_capture, "-o", run, "-q", *assignments, folder=tmp_path)
    document = json.loads((run / "run.json").read_text())
    assert document["settings"]["geometry"]["renderer"] == "midpoint_outline"
    assert any("light_chroma (hir-plugin-example 0.1.0)" in plugin for plugin in document["plugins"])
    assert document["stages"]["reflectance"]["report"]["gradient"]["steps"] == 10
    (file,) = (run / "exports").iterdir()
    assert file.suffix == ".ply" and file.read_bytes().startswith(b"ply\n")
