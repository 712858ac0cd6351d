"""What the core refuses, each in one sentence that says what, who and how to mend it."""

from __future__ import annotations

import json
import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hir_core.capture import Capture, Pixels, View
from hir_core.config import assign, load_config, read_toml
from hir_core.errors import CaptureError, ConfigError, HirError, InputError, PluginError
from hir_core.files.array_files import read_arrays
from hir_core.files.json_documents import read_json
from hir_core.files.light_setting import parse_light_file
from hir_core.plugins import Component, NoOptions, hookimpl
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.run.capture_store import read_cameras, restore_capture
from hir_core.run.device import resolve_device
from hir_core.run.progress_listener import read_curves
from hir_core.run.run_directory import RunDirectory, check_stage_name
from hir_plugins.commands.bench.results.bench_result import Result

PLUGINS = PluginManager.discover()


@dataclass(frozen=True)
class Wrong:
    """A file of this content, given to a reader, and what is said."""

    name: str
    content: bytes
    read: Callable[[Path], object]
    said: str
    kind: type[HirError] = InputError


def _run(path: Path) -> object:
    return RunDirectory(path.parent).read_run()


FILES = [
    Wrong("a.toml", b"a = [", read_toml, "a.toml: not valid TOML: Invalid value", ConfigError),
    Wrong("a.toml", b"\xff = 1", read_toml, "a.toml: not valid TOML: 'utf-8' codec", ConfigError),
    Wrong("a.toml", b"a = " + b"[" * 5000, read_toml, "a.toml: not valid TOML: maximum recursion", ConfigError),
    Wrong(
        "a.toml", b".".join([b"a"] * 60) + b" = 1", read_toml, "a.toml: its tables and lists are nested", ConfigError
    ),
    Wrong("a.toml", b"preset = 3", lambda p: load_config(PLUGINS, file=p), "preset is 3; it is the name", ConfigError),
    Wrong("run.json", b"{", _run, "run.json is not JSON"),
    Wrong("run.json", b"[" * 9999, _run, "run.json is not JSON"),
    Wrong("run.json", b"[]", _run, "run.json is not a JSON object"),
    Wrong("run.json", b"{}", _run, "run.json is no run: its format is None"),
    Wrong(
        "run.json",
        b'{"format": "hir-run", "version": 99}',
        _run,
        "has format version 99, this program reads 2; reconstruct the capture again",
    ),
    Wrong("run.json", b'{"format": "hir-run", "version": true}', _run, "has format version True"),
    Wrong("cameras.json", b'{"views": 3}', read_cameras, "cameras.json has no list of views"),
    Wrong("a.npz", b"PK", read_arrays, "a.npz cannot be read"),
    Wrong("bench.json", b"{}", Result.read, "is not a result of hir bench"),
    Wrong("bench.json", b'{"format": "hir-bench", "version": 1}', Result.read, "a row or field is malformed"),
]


@pytest.mark.parametrize("wrong", FILES, ids=lambda w: f"{w.name}-{w.said[:30]}")
def test_a_wrong_file_is_named(wrong: Wrong, tmp_path: Path) -> None:
    path = tmp_path / wrong.name
    path.write_bytes(wrong.content)
    with pytest.raises(wrong.kind) as found:
        wrong.read(path)
    assert wrong.said in str(found.value) and "\n" not in str(found.value)


def test_files_that_are_too_large_or_missing_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hir_core.files.json_documents._MAX_JSON_BYTES", 1 << 20)
    large = tmp_path / "large.json"
    large.write_bytes(b" " * ((1 << 20) + 1))
    with pytest.raises(InputError, match=r"large\.json is larger than 1 MiB"):
        read_json(large)
    with pytest.raises(InputError, match=r"gone\.json cannot be read: No such file"):
        read_json(tmp_path / "gone.json")
    with pytest.raises(InputError, match=r"gone\.npz cannot be read"):
        read_arrays(tmp_path / "gone.npz")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["geometry.iterations"], "write it as key=value, such as geometry.iterations=100"),
        (["=3"], "write it as key=value"),
        (["geometry=3", "geometry.iterations=3"], "'geometry' was set to a value before, and is used as a table here"),
        ([".".join("a" * 40) + "=1"], "nested deeper than 32 levels"),
        (["preset=[]"], "preset is []; it is the name of a preset: "),
        (["observers.nobody.a=1"], "there is no observer 'nobody'; installed: "),
        (["geometry.renderer=nobody"], "there is no geometry renderer named 'nobody'; installed: contour"),
    ],
)
def test_a_wrong_assignment_is_explained(words: list[str], said: str) -> None:
    with pytest.raises(HirError) as found:
        load_config(PLUGINS, assignments=words)
    assert said in str(found.value)


def test_a_value_that_is_no_toml_is_a_text() -> None:
    table: dict[str, object] = {}
    assign(table, "a.b = contour")
    assign(table, "a.c=[1, 2]")
    assign(table, "a.d=" + "[" * 5000)
    assert table == {"a": {"b": "contour", "c": [1, 2], "d": "[" * 5000}}


def test_names_of_stages_devices_and_lights() -> None:
    assert check_stage_name("atlas") == "atlas"
    with pytest.raises(ConfigError, match="there is no stage 'lunch'; the stages are: initializer, geometry, atlas"):
        check_stage_name("lunch")
    assert resolve_device("cpu") == "cpu" and resolve_device("auto") in ("cpu", "cuda")
    with pytest.raises(ConfigError, match="device 'tpu' is not known; it is auto, cpu or cuda"):
        resolve_device("tpu")
    assert parse_light_file("a*b.hdr*0.5") == (Path("a*b.hdr"), 0.5) and parse_light_file("a.hdr") == (
        Path("a.hdr"),
        1.0,
    )
    for text, said in (
        ("a.hdr*x", "the strength after [*] must be a number"),
        ("a.hdr*-1", "finite number of at least 0"),
        ("a.hdr*inf", "finite number of at least 0"),
    ):
        with pytest.raises(InputError, match=said):
            parse_light_file(text)


def test_cuda_that_is_not_there_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ConfigError, match="device cuda: torch finds no CUDA device; use --device cpu"):
        resolve_device("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    assert resolve_device("cuda") == resolve_device("auto") == "cuda"


def _registered(target: str) -> PluginManager:
    plugin = types.ModuleType("plugin")

    @hookimpl
    def hir_register_regularizers() -> list[Component]:
        return [Component(name="it", target=target, config=NoOptions, summary="It.")]

    plugin.hir_register_regularizers = hir_register_regularizers  # type: ignore[attr-defined]
    plugins = PluginManager()
    plugins.register(plugin, "theirs", "1")
    return plugins


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("no_such_module:It", "regularizer 'it' of theirs cannot be loaded from 'no_such_module:It'"),
        ("json:It", "regularizer 'it' of theirs cannot be loaded from 'json:It'"),
        ("json:dumps", "regularizer 'it' of theirs cannot be used: 'json:dumps' is not a class"),
    ],
)
def test_a_component_whose_code_is_not_there_names_its_distribution(target: str, said: str) -> None:
    with pytest.raises(PluginError) as found:
        _registered(target).create("regularizer", "it")
    assert said in str(found.value)


def test_nothing_to_choose_from_is_said() -> None:
    nobody = PluginManager()
    with pytest.raises(PluginError, match="there is no regularizer named 'it'; installed: none"):
        nobody.find("regularizer", "it")
    with pytest.raises(ConfigError, match="there is no preset 'fast'; installed: none"):
        nobody.preset("fast")
    with pytest.raises(
        PluginError, match="no reflectance renderer has the trait 'reference'; name one with --renderer"
    ):
        reference_renderer(nobody)
    with pytest.raises(PluginError, match=r"plugin 'gone\.py' cannot be imported .*gone\.py does not exist"):
        nobody.register_named("gone.py")


BLACK = Pixels(np.zeros((4, 6, 3), np.float32), None, np.zeros((4, 6), bool))


def test_pictures_and_masks_that_do_not_fit_are_named() -> None:
    with pytest.raises(CaptureError, match="an image of 6×4 cannot be downsampled by 5"):
        View("a", None, lambda: BLACK).pixels(5)
    with pytest.raises(CaptureError, match="the mask of a is 3×2, its image 6×4"):
        View("a", None, lambda: BLACK, mask=np.ones((2, 3), np.float32)).pixels()


CAPTURE = Capture(Path("it"), (View("a", None, lambda: BLACK),))
VIEW = {"name": "a", "camera": None, "distortion": [], "exposure": 1.0}
WHOLE = {"views": [VIEW], "light_frame": "world", "world_from_source": np.eye(4).tolist()}


@pytest.mark.parametrize(
    ("change", "arrays", "said"),
    [
        ({"views": [VIEW | {"name": "b"}]}, {}, "names 'b', which the capture lacks"),
        ({"views": [VIEW | {"exposure": "x"}]}, {}, "ValueError"),
        ({"views": [VIEW | {"white_balance": [1, 2]}]}, {}, "ValueError"),
        ({"views": 3}, {}, "TypeError"),
        ({"light_frame": "moon"}, {}, "KeyError: 'moon'"),
        ({"world_from_source": [1, 2]}, {}, "ValueError"),
        ({"irradiance": {"normal": [0, 1, 0], "values": {"a": [1, 2]}}}, {}, "ValueError"),
        ({"irradiance": {"normal": [0, 1, 0], "values": {"a": [1, 2, 1e999]}}}, {}, "ValueError"),
        ({"irradiance": {"normal": [0, 1, 0]}}, {}, "KeyError: 'values'"),
        ({"irradiance": 3}, {}, "TypeError"),
        ({}, {"mask_0": np.ones(3)}, "the mask of a is no picture"),
        ({}, {"mask_0": np.array([["x"]])}, "the mask of a is no picture"),
        ({}, {"points_positions": np.ones((3, 2))}, "its points are not three numbers each"),
        ({}, {"points_positions": np.ones((3, 3)), "points_colors": np.ones((2, 3))}, "not three numbers each"),
    ],
)
def test_a_damaged_capture_of_a_run_is_refused(
    change: dict[str, object], arrays: dict[str, np.ndarray], said: str, tmp_path: Path
) -> None:
    (tmp_path / "capture.json").write_text(json.dumps(WHOLE))
    np.savez(tmp_path / "capture.npz", mask_0=np.ones((4, 6), np.float32), points_positions=np.ones((2, 3)))
    whole = restore_capture(CAPTURE, tmp_path)
    assert whole.points is not None and whole.views[0].pixels().mask is not None
    (tmp_path / "capture.json").write_text(json.dumps(WHOLE | change))
    np.savez(tmp_path / "capture.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InputError) as found:
        restore_capture(CAPTURE, tmp_path)
    assert said in str(found.value)


@pytest.mark.parametrize(
    "arrays",
    [
        {"a": np.ones(3)},
        {"a": np.ones(3), "a@step": np.ones(2)},
        {"a": np.ones((3, 1)), "a@step": np.ones((3, 1))},
        {"a": np.array(["x"]), "a@step": np.ones(1)},
    ],
)
def test_curves_without_steps_are_refused(arrays: dict[str, np.ndarray], tmp_path: Path) -> None:
    assert read_curves(tmp_path / "gone.npz") == {}
    np.savez(tmp_path / "curves.npz", **arrays)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="holds a curve 'a' that is not a number a step"):
        read_curves(tmp_path / "curves.npz")
    np.savez(tmp_path / "curves.npz", a=np.ones(2), **{"a@step": np.arange(2)})  # type: ignore[arg-type]
    assert read_curves(tmp_path / "curves.npz")["a"][0].tolist() == [0, 1]


def test_the_renderer_that_ends_a_fit_is_looked_for_before_it_begins() -> None:
    with pytest.raises(PluginError, match="no reflectance renderer named 'mitsubi'"):
        load_config(PLUGINS, assignments=["reflectance.path_tracing.renderer=mitsubi"])


@pytest.mark.parametrize(
    "text", ["[geometry]\niteratons = 5\n", "[reflectance_renderer.transport_ggx]\nbounce = 5\n", 'seed = "x"\n']
)
def test_a_wrong_setting_is_that_of_its_file(text: str, tmp_path: Path) -> None:
    file, sound = tmp_path / "mine.toml", tmp_path / "sound.toml"
    file.write_text(text)
    sound.write_text("seed = 1\n")
    with pytest.raises(ConfigError, match=r"mine\.toml: "):
        load_config(PLUGINS, file=file)
    with pytest.raises(ConfigError) as raised:
        load_config(PLUGINS, file=sound, assignments=["geometry.iteratons=5"])
    assert "sound.toml" not in str(raised.value)
