"""The extension of Blender: its package, and what it does in Blender with a stand-in for hir, or with hir itself."""

from __future__ import annotations

import ast
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import time
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import trimesh
from hir_exporters.conventions import direction_to_latlong_uv, flip_v
from hir_exporters.format_options import GltfConfig
from hir_exporters.formats import create_exporter
from hir_exporters.light.environment_map import sample_latlong
from hir_exporters.textures.image_files import read_hdr
from parity.engines import blender_python
from scipy.spatial import cKDTree

from hir_plugins.initializers.existing_mesh.mesh_loading import load_mesh
from tests.docs.checkout import tool
from tests.fixtures.octant_asset import asset
from tests.fixtures.runs import QUICK

ROOT = Path(__file__).resolve().parents[2]
BUILDER = tool("build_blender_extension")
SOURCE = ROOT / "examples" / "engines" / "blender_extension"
SESSION = Path(__file__).with_name("blender_session.py")

DIRECTIONS = [[1, 0, 0], [-1, 0, 0], [0, 0.98, 0.2], [0, -0.98, 0.2], [0, 0, 1], [0, 0, -1], [0.6, 0.4, -0.7]]
"""In glTF's axes."""

STAND_IN = """#!{python}
import json, pathlib, shutil, sys, time
words = sys.argv[1:]
run = pathlib.Path(words[words.index("-o") + 1])
if words[0] in ("endless", "delight"):
    run.mkdir(parents=True, exist_ok=True)
    state = {{"stage": "reflectance", "step": 3, "steps": 20, "seconds": 9, "seconds_left": 150}}
    (run / "progress.json").write_text(json.dumps(state))
if words[0] == "endless":
    time.sleep(600)
if words[0] == "broken" or "broken=1" in words:
    print("a warning", "hir: the photographs show nothing", sep="\\n", file=sys.stderr)
    sys.exit(2)
if words[0] == "delight":
    shutil.copytree({run!r}, run, dirs_exist_ok=True)
    shutil.copy(words[1], run / "scan.glb")
    (run / "words.json").write_text(json.dumps(words))
if words[0] == "export":
    shutil.copytree(pathlib.Path({run!r}) / "exports", run, dirs_exist_ok=True)
"""


# ---- the package ----


def test_the_manifest_has_the_fields_that_blender_asks_for() -> None:
    manifest = tomllib.loads((SOURCE / "blender_manifest.toml").read_text(encoding="utf-8"))
    required = {"schema_version", "id", "version", "name", "tagline", "maintainer", "type", "license"}
    assert required | {"blender_version_min"} <= set(manifest)
    assert manifest["schema_version"] == "1.0.0" and manifest["type"] == "add-on"
    assert manifest["blender_version_min"] == "4.2.0"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert manifest["version"] == project["version"]
    assert manifest["license"] == [f"SPDX:{project['license']}"]
    assert list(manifest["permissions"]) == ["files"]
    for sentence in (manifest["tagline"], *manifest["permissions"].values()):
        assert len(sentence) <= 64 and sentence[-1].isalnum(), sentence
    assert set(manifest["tags"]) <= {"Import-Export", "Material", "Lighting"}


def test_the_archive_has_all_modules_and_nothing_else() -> None:
    names = {"LICENSE", "blender_manifest.toml", *(file.name for file in SOURCE.glob("*.py"))}
    assert set(BUILDER.members()) == names and "__init__.py" in names
    assert {path.name for path in SOURCE.iterdir() if path.name != "__pycache__"} == names - {"LICENSE"}


def test_the_archive_is_the_same_whenever_it_is_built(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = BUILDER.build(tmp_path / "a")
    assert first.name == "hir-0.1.0.zip"
    shutil.copytree(SOURCE, tmp_path / "source")
    for file in (tmp_path / "source").iterdir():
        os.utime(file, (10**9, 10**9)) if file.is_file() else None
    monkeypatch.setattr(BUILDER, "SOURCE", tmp_path / "source")
    second = BUILDER.build(tmp_path / "b")
    assert first.read_bytes() == second.read_bytes()
    with zipfile.ZipFile(first) as target:
        assert target.testzip() is None
        assert {(entry.date_time, entry.compress_type) for entry in target.infolist()} == {((1980, 1, 1, 0, 0, 0), 0)}
    changed = tmp_path / "source" / "preferences.py"
    changed.write_text(changed.read_text(encoding="utf-8") + "\n", encoding="utf-8")
    assert BUILDER.archive() != first.read_bytes()


def test_modules_import_only_what_blender_brings_and_no_network() -> None:
    brought = {"bpy", "mathutils", "numpy"}
    plain = {
        "atexit",
        "itertools",
        "json",
        "math",
        "os",
        "pathlib",
        "shlex",
        "shutil",
        "signal",
        "subprocess",
        "typing",
    }
    for file in SOURCE.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                names = {node.module or ""}
            else:
                continue
            assert names <= brought | plain | {"tempfile"}, f"{file.name}: {names}"


# ---- the process, without Blender ----


@pytest.fixture(scope="module")
def hir_process() -> ModuleType:
    specification = importlib.util.spec_from_file_location("hir_process", SOURCE / "hir_process.py")
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def exported_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a run with the octants, as hir writes it."""
    run = tmp_path_factory.mktemp("blender") / "octants"
    (run / "exports").mkdir(parents=True)
    (run / "scene").mkdir()
    (run / "run.json").write_text('{"format": "hir-run", "version": 2}', encoding="utf-8")
    create_exporter("glb", GltfConfig(profile="blender")).write(asset(), run / "exports" / "octants.glb")
    return run


@pytest.fixture(scope="module")
def stand_in(exported_run: Path) -> Path:
    """A program that behaves as hir: it writes the octants, whatever it is asked for."""
    program = exported_run.parent / "stand-in"
    program.write_text(STAND_IN.format(python=sys.executable, run=str(exported_run)), encoding="utf-8")
    program.chmod(0o755)
    return program


def test_progress_and_interruption(hir_process: ModuleType, stand_in: Path, tmp_path: Path) -> None:
    process = hir_process.HirProcess(str(stand_in), ["endless", "-o", tmp_path], tmp_path)
    assert process.progress() == "hir is starting" or "reflectance" in process.progress()
    deadline = time.monotonic() + 60
    while "reflectance" not in process.progress() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert process.progress() == "reflectance: 3 of 20, 2 min left"
    assert process.is_running and not process.was_stopped
    process.stop()
    process.wait()
    assert process.was_stopped and not process.has_succeeded
    process.end()


def test_sentences_of_failures(hir_process: ModuleType, stand_in: Path, tmp_path: Path) -> None:
    process = hir_process.HirProcess(str(stand_in), ["broken", "-o", tmp_path], tmp_path)
    process.wait()
    assert process.sentence() == "the photographs show nothing" and not process.was_stopped
    process.end()
    with pytest.raises(hir_process.HirError, match="preferences of the add-on"):
        hir_process.HirProcess(str(tmp_path / "none"), [], tmp_path)


# ---- in Blender ----


@pytest.fixture(scope="module")
def extension(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Blender's folder of the user, with the extension as Blender unpacks it."""
    if not blender_python().exists():
        pytest.skip("bpy is not installed: run tools/setup.sh blender, or set HIR_BLENDER_PYTHON")
    user = tmp_path_factory.mktemp("blender-user")
    with zipfile.ZipFile(BUILDER.build(user)) as target:
        target.extractall(user / "extensions" / "user_default" / "hir")
    return user


def in_blender(user: Path, program: Path, cases: dict[str, list[Any]]) -> dict[str, Any]:
    """Name → answer of the cases, each a function of blender_session.py and its arguments."""
    request, answer = user / "request.json", user / "answer.json"
    named = [
        [name, function, [str(a) if isinstance(a, Path) else a for a in words]]
        for name, (function, *words) in cases.items()
    ]
    request.write_text(json.dumps({"program": str(program), "answer": str(answer), "cases": named}), encoding="utf-8")
    answer.unlink(missing_ok=True)
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(user), "OMP_NUM_THREADS": "1"}
    words = [str(blender_python()), str(SESSION), str(request)]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False, timeout=1800)
    assert answer.is_file(), done.stdout[-2000:] + done.stderr[-2000:]
    answers: dict[str, Any] = json.loads(answer.read_text(encoding="utf-8"))
    for name, found in answers.items():
        assert "exception" not in found, f"{name}: {found['exception']}"
    return answers


@pytest.fixture(scope="module")
def session(
    extension: Path, exported_run: Path, stand_in: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, Any]]:
    """All answers of one Blender, which takes seconds to start."""
    work = tmp_path_factory.mktemp("blender-work")
    unexported = work / "unexported"
    (unexported / "scene").mkdir(parents=True)
    shutil.copy(exported_run / "run.json", unexported)
    (work / "photos").mkdir()
    (work / "modal").mkdir()
    glb = exported_run / "exports" / "octants.glb"

    def refit(run: str, axes: str, turned: bool, settings: str = "") -> list[Any]:
        return ["refitted", glb, work / "photos", work / run, axes, turned, settings, DIRECTIONS, work]

    answers = in_blender(
        extension,
        stand_in,
        {
            "registered": ["registered"],
            "imported": ["imported", exported_run],
            "exported first": ["imported", unexported],
            "light": ["world_radiance", exported_run, DIRECTIONS, work],
            "missing": ["missing_run", work / "photos"],
            "gltf": refit("gltf", "GLTF", False),
            "turned": refit("turned", "SOURCE", True),
            "turned y": refit("turned_y", "SOURCE_TURNED", True),
            "broken": refit("broken", "GLTF", False, "broken=1"),
            "refused": ["refused", work / "photos"],
            "modal": ["modal", stand_in, work / "modal"],
        },
    )
    yield answers | {"work": work, "glb": glb}


def light_along(directions: list[list[float]]) -> np.ndarray:
    """Radiance of the octants' light by hir's own lookup."""
    environment = asset().environment
    assert environment is not None
    units = np.array(directions) / np.linalg.norm(directions, axis=1, keepdims=True)
    return np.asarray(sample_latlong(np.asarray(environment.radiance), direction_to_latlong_uv(units)))


def test_the_extension_is_enabled_and_disabled(session: dict[str, Any]) -> None:
    assert session["registered"] == {"enabled": [True] * 4, "category": "hir", "disabled": [False] * 4}
    assert session["default_program"] == "hir"


@pytest.mark.parametrize("case", ["imported", "exported first"])
def test_a_run_is_imported_with_its_light(session: dict[str, Any], case: str) -> None:
    found = session[case]
    assert found["result"] == ["FINISHED"] and found["world"].startswith("hir octants")
    assert found["view"] == "Standard"
    assert found["textures"]["Base Color"] == [128, 64]
    mesh = trimesh.load(session["glb"], force="mesh", process=False)
    low, high = np.array(found["positions"]).min(axis=0), np.array(found["positions"]).max(axis=0)
    (x, y, z), (x1, y1, z1) = mesh.bounds  # Blender has +Z up, and glTF's +Z is its -Y
    np.testing.assert_allclose([low, high], [[x, -z1, y], [x1, -z, y1]], atol=1e-6)


def test_the_world_has_the_radiance_of_the_light(session: dict[str, Any]) -> None:
    values, expected = np.array(session["light"]["values"]), light_along(DIRECTIONS)
    np.testing.assert_allclose(values, expected, rtol=0.02)
    mirrored = light_along([[-x, y, z] for x, y, z in DIRECTIONS])
    assert np.abs(mirrored / expected - 1).max() > 0.2  # the light tells a mirror image from itself


def test_a_folder_without_a_run_is_refused(session: dict[str, Any]) -> None:
    assert "is not the folder of a run: it has no run.json" in session["missing"]["error"]


@pytest.mark.parametrize(("case", "axes"), [("gltf", "auto"), ("turned", "source"), ("turned y", "source")])
def test_materials_are_refitted(session: dict[str, Any], case: str, axes: str) -> None:
    found = session[case]
    assert found["result"] == ["FINISHED"] and found["unchanged"]
    assert found["objects"] == found["selected"] == [found["item"]]
    assert len(found["materials"]) == 1 and found["materials"] != ["old"]
    assert found["textures"]["Base Color"] == [128, 64]
    assert set(found["normal_uv_maps"]) <= {"scan's own"}
    np.testing.assert_allclose(found["values"], light_along(DIRECTIONS), rtol=0.02)
    run = session["work"] / case.replace(" ", "_")
    words = json.loads((run / "words.json").read_text(encoding="utf-8"))
    assert words[:1] == ["delight"] and words[2] == str(session["work"] / "photos")
    assert words[words.index("--axes") + 1] == axes
    assert "observers.progress_file={}" in words
    assert not Path(words[1]).parent.exists()  # the temporary folder


@pytest.mark.parametrize(("case", "y_up"), [("gltf", True), ("turned", False), ("turned y", True)])
def test_the_scan_that_hir_gets(session: dict[str, Any], case: str, y_up: bool) -> None:
    """The corners of all triangles in the axes that were chosen, with the UV map that textures use."""
    found = session[case]
    file = session["work"] / case.replace(" ", "_") / "scan.glb"
    scan = load_mesh(file)
    positions, uv = np.array(found["positions"]), flip_v(np.array(found["uv"]))  # Blender's v points up
    if y_up:
        positions = positions[:, [0, 2, 1]] * [1, 1, -1]
    corners = scan.faces.reshape(-1)
    expected = np.hstack([positions, uv])
    written = np.hstack([scan.positions[corners], scan.uvs[corners]])
    assert written.shape == expected.shape and len(np.unique(expected, axis=0)) > 4000
    for some, others in ((written, expected), (expected, written)):
        assert cKDTree(others).query(some)[0].max() < 1e-6
    picture = trimesh.load(file, force="mesh").visual.material.baseColorTexture  # type: ignore[union-attr]
    assert picture.size == (8, 4)  # the old texture, for the report's comparison


def test_an_error_of_hir_is_a_report(session: dict[str, Any]) -> None:
    found = session["broken"]
    assert found["error"] == "Error: the photographs show nothing"
    assert found["materials"] == ["old"] and found["unchanged"] and found["objects"] == [found["item"]]
    assert "has no UV map" in session["refused"]["no_uv"]
    assert "is not a folder of photographs" in session["refused"]["no_photos"]


def test_a_window_stays_usable_and_esc_cancels(session: dict[str, Any]) -> None:
    found = session["modal"]
    assert found["running"] == found["mouse"] == ["PASS_THROUGH"]
    assert found["status"] == "hir: reflectance: 3 of 20, 2 min left    Esc: cancel"
    assert found["esc"] == ["RUNNING_MODAL"]
    assert found["stopped"] == [["CANCELLED"], [[["WARNING"], "hir was cancelled"]], None, ["timer"], []]
    assert found["succeeded"] == [["FINISHED"], [], [True]]
    assert found["failed"] == [["CANCELLED"], [[["ERROR"], "the photographs show nothing"]]]
    assert found["closed"] is False


def test_blender_accepts_the_package(extension: Path) -> None:
    """By the validation that the Blender Extensions Platform uses, which is a program of its own."""
    validator = next(blender_python().parent.parent.glob("lib/*/site-packages/bpy/*/scripts/addons_core/bl_pkg/cli"))
    words = [str(blender_python()), str(validator / "blender_ext.py"), "validate", str(BUILDER.build(extension))]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0 and "Success" in done.stdout, done.stdout + done.stderr


@pytest.mark.slow
def test_hir_itself_refits_a_mesh(extension: Path, finished: Any, tiny_capture: Path, tmp_path: Path) -> None:
    """The exported asset of a run is the scan of its own photographs."""
    program = tmp_path / "hir"
    program.write_text(f"#!/bin/sh\nexec '{sys.executable}' -m hir_core.cli \"$@\"\n", encoding="utf-8")
    program.chmod(0o755)
    [scan] = (finished.directory.path / "exports").glob("*.glb")
    settings = " ".join(["atlas.texture_size=64", *(word for word in QUICK if word.startswith("reflectance"))])
    run = tmp_path / "run"
    answers = in_blender(
        extension,
        program,
        {
            "imported": ["imported", finished.directory.path],
            "refit": ["refitted", scan, tiny_capture, run, "GLTF", False, settings, DIRECTIONS, tmp_path],
        },
    )
    assert answers["imported"]["result"] == ["FINISHED"]
    found = answers["refit"]
    assert found["error"] == "" and found["unchanged"] and found["objects"] == [found["item"]]
    assert found["textures"]["Base Color"] == [64, 64]
    light = read_hdr(next((run / "exports").glob("*.hdr")))
    units = np.array(DIRECTIONS) / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
    expected = sample_latlong(light.astype(np.float64), direction_to_latlong_uv(units))
    np.testing.assert_allclose(found["values"], expected, rtol=0.05, atol=0.01)
    assert (run / "progress.json").is_file()
    assert (run / "stages" / "1-initializer" / "scan_texture.png").is_file()
