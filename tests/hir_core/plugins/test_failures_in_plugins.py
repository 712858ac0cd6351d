"""What a component of a plugin raises, or returns in place of what it should, is named with component and plugin."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import pytest

from hir_core.cli import main
from hir_core.errors import PluginError
from hir_core.intake.mask_sources import apply_mask_sources
from hir_core.intake.reader_lookup import read_capture
from hir_core.optimization.weighted_energies import prepare_energies
from hir_core.plugins import hookimpl
from hir_core.plugins.failure_origin import origin_of
from hir_core.plugins.manager import PluginManager
from hir_core.stages.export.asset_export import export_asset
from hir_core.stages.initializer_result import checked_report, checked_result, checked_scan
from hir_core.testing.assets import textured_asset
from hir_core.testing.captures import surface_mesh, tiny_capture

FILE = """
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import CaptureReader, Initializer, MaskSource, Regularizer
from hir_exporters.exporter import Exporter

class Reader(CaptureReader):
    def __init__(self, config): ...
    def matches(self, path): return True
    def splits(self, path): return ["train"]
    def read(self, path, split="train"): return None

class Masks(MaskSource):
    def __init__(self, config): ...
    def masks(self, capture, scene): return None

class Term(Regularizer):
    def __init__(self, config): ...
    def prepare(self, scene): return None

class Late(Regularizer):
    def __init__(self, config): ...
    def prepare(self, scene):
        def energy(scene): return scene.no_such_part
        return energy

class Full(Exporter):
    def __init__(self, config): ...
    def write(self, asset, destination, edit=None): raise OSError("disk full")

class Silent(Exporter):
    def __init__(self, config): ...
    def write(self, asset, destination, edit=None): return None

def of(name): return [Component(n.lower(), f"hir_plugin_failing:{n}") for n in name.split()]
@hookimpl
def hir_register_capture_readers(): return of("Reader")
@hookimpl
def hir_register_mask_sources(): return of("Masks")
@hookimpl
def hir_register_regularizers(): return of("Term Late")
@hookimpl
def hir_register_exporters(): return of("Full Silent")
@hookimpl
def hir_gltf_document(document): document.buffers = object()
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plugin") / "failing.py"
    path.write_text(FILE)
    return path


@pytest.fixture(scope="module")
def plugins(file: Path) -> PluginManager:
    return PluginManager.discover((str(file),))


def said(call: Callable[[], object]) -> str:
    with pytest.raises(PluginError) as caught:
        call()
    return str(caught.value)


def test_what_a_reader_returns_is_checked(plugins: PluginManager, file: Path, tmp_path: Path) -> None:
    sentence = said(lambda: read_capture(tmp_path, "train", plugins, "reader"))
    assert sentence == f"the capture reader 'reader' of {file} returned None from read; return a Capture"


def test_what_a_mask_source_returns_is_checked(plugins: PluginManager, file: Path, tmp_path: Path) -> None:
    capture = tiny_capture(tmp_path, views=2, size=8).without_masks()
    sentence = said(lambda: apply_mask_sources(capture, None, ["masks"], {}, plugins, known="photographs"))
    assert sentence.startswith(f"the mask source 'masks' of {file} returned None from masks; return a list of numpy")


def test_what_a_regularizer_returns_is_checked(plugins: PluginManager) -> None:
    sentence = said(lambda: prepare_energies(surface_mesh(8), {"term": {}}, plugins))
    assert sentence == "the regularizer 'term' returned None from prepare; return a function of the scene"


def test_what_an_exporter_returns_is_checked(plugins: PluginManager, file: Path, tmp_path: Path) -> None:
    sentence = said(lambda: export_asset(textured_asset(), ["silent"], tmp_path, plugins))
    assert sentence == f"the exporter 'silent' of {file} returned None from write; return an ExportReport"


def test_a_document_that_a_hook_broke_is_named_with_the_plugin(
    plugins: PluginManager, file: Path, tmp_path: Path
) -> None:
    sentence = said(lambda: export_asset(textured_asset(), ["glb"], tmp_path, plugins))
    assert re.match(r"the exporter 'glb' of hir raised \w+: .* after its document was edited by", sentence)
    assert f"hir_gltf_document of {file}" in sentence


@dataclass(frozen=True)
class Returns:
    """An initializer that reports and offers these values."""

    value: Any

    def report(self) -> Any:
        return self.value

    def scan(self) -> Any:
        return self.value


def test_what_an_initializer_returns_is_checked(tmp_path: Path) -> None:
    capture, scene = tiny_capture(tmp_path, views=2, size=8).capture, surface_mesh(8)
    assert checked_result((capture, scene), "it") == (capture, scene)
    assert checked_result((capture, None), "it") == (capture, None)
    assert said(lambda: checked_result(capture, "it")) == "it returned a Capture from initialize; return capture, scene"
    assert "a Capture, and a Scene or None" in said(lambda: checked_result((capture, scene.mesh), "it"))
    scene.mesh.topology.faces[0, 0] = len(scene.mesh.positions)
    count = len(scene.mesh.positions)
    assert f"0 … {count} of a mesh that has {count}" in said(lambda: checked_result((capture, scene), "it"))


def test_what_an_initializer_reports_is_checked() -> None:
    assert checked_report(Returns({"a": 1}), "it") == {"a": 1}  # type: ignore[arg-type]
    assert said(lambda: checked_report(Returns(None), "it")) == "it returned None from report; return a dict"  # type: ignore[arg-type]
    assert checked_scan(Returns(None), "it") is None  # type: ignore[arg-type]
    assert said(lambda: checked_scan(Returns("a.ply"), "it")) == "it returned a str from scan; return a Scan or None"  # type: ignore[arg-type]


def raised_in(call: Callable[[PluginManager], object], plugins: PluginManager) -> BaseException:
    """The exception of a command, which has its plugins in a variable."""
    with pytest.raises(Exception) as caught:
        call(plugins)
    return caught.value


def test_the_exporter_that_raised_is_named(plugins: PluginManager, file: Path, tmp_path: Path) -> None:
    error = raised_in(lambda known: export_asset(textured_asset(), ["full"], tmp_path, known), plugins)
    assert isinstance(error, OSError) and origin_of(error) == f"the exporter 'full' of {file}"


def test_the_regularizer_whose_term_raised_later_is_named(plugins: PluginManager, file: Path) -> None:
    scene = surface_mesh(8)
    error = raised_in(lambda known: prepare_energies(scene, {"late": {}}, known)(scene), plugins)
    assert isinstance(error, AttributeError) and origin_of(error) == f"the regularizer 'late' of {file}"


def test_a_defect_of_this_program_has_no_plugin(plugins: PluginManager) -> None:
    error = raised_in(lambda known: known.call(None, "no_such_hook"), plugins)  # type: ignore[arg-type]
    assert isinstance(error, AttributeError) and origin_of(error) == ""
    assert origin_of(raised_in(lambda known: np.linalg.inv(np.zeros((2, 2))), plugins)) == ""


def test_the_command_line_names_what_raised(
    plugins: PluginManager, file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def export(known: PluginManager = plugins) -> None:
        export_asset(textured_asset(), ["full"], tmp_path, known)

    manager = PluginManager()
    register = hookimpl(lambda cli: cli.add_command(click.Command("write", callback=export)))
    manager.register(SimpleNamespace(__name__="example", hir_register_commands=register), "example", "1")
    with pytest.raises(SystemExit) as stopped:
        main(["write"], manager)
    assert stopped.value.code == 1
    assert capsys.readouterr().err == (
        f"hir: the exporter 'full' of {file} raised OSError: disk full; report it to its author "
        "(-v prints the traceback)\n"
    )
