"""`hir new-plugin` writes plugins that pass the contract tests as they are."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from importlib import import_module
from pathlib import Path

import pytest
from click.testing import CliRunner

from hir_core.cli.app import cli
from hir_core.errors import ConfigError
from hir_core.plugins.manager import KINDS, PluginManager
from hir_core.scaffold import write_one_file, write_plugin
from hir_core.testing import check_component, check_whole_plugin, whole_plugin
from hir_core.testing.captures import tiny_capture


def plugged(folder: Path, package: str, monkeypatch: pytest.MonkeyPatch) -> PluginManager:
    """A manager that knows the scaffold beside the built-ins, as if it were installed."""
    monkeypatch.syspath_prepend(str(folder))
    manager = PluginManager.discover()
    manager.register(import_module(f"{package}.plugin"), package.replace("_", "-"), "")
    assert manager.problems == []
    return manager


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=[] if k in ("regularizer", "mask_source") else [pytest.mark.slow]) for k in KINDS],
)
def test_scaffold_passes_the_checks_as_it_is_written(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = write_plugin(f"m {kind}", kind, tmp_path)
    package = f"hir_m_{kind}"
    folder = tmp_path / package.replace("_", "-")
    assert folder / package / "plugin.py" in files
    plugins = plugged(folder, package, monkeypatch)
    results = check_component(f"{kind}:m_{kind}", plugins=plugins)
    assert sum(result.outcome == "passed" for result in results) >= 12
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    assert project["entry-points"]["hir"] == {f"m_{kind}": f"{package}.plugin"}
    ruff = [sys.executable, "-m", "ruff", "check", "--isolated", "--line-length", "120", "--select", "E,F,I,B,UP"]
    done = subprocess.run([*ruff, "."], capture_output=True, text=True, cwd=folder)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("kind", ["observer", "command"])
def test_scaffold_without_a_component_passes_the_checks_as_it_is_written(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_plugin(f"m {kind}", kind, tmp_path)
    folder, package = tmp_path / f"hir-m-{kind}", f"hir_m_{kind}"
    monkeypatch.syspath_prepend(str(folder))
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    module, _, attribute = project["entry-points"]["hir"][f"m_{kind}"].partition(":")
    plugin = import_module(module)
    manager = PluginManager.discover()
    manager.register(getattr(plugin, attribute)() if attribute else plugin, f"hir-m-{kind}", "0.1.0")
    subject = whole_plugin(f"hir-m-{kind}", manager)
    assert subject is not None and module == f"{package}.plugin"
    outcomes = {result.check: result.outcome for result in check_whole_plugin(subject)}
    own = "observer_raises_nothing" if kind == "observer" else "commands_have_help"
    assert outcomes[own] == "passed"
    if kind == "command":
        (tmp_path / "run.json").write_text('{"stages": {"geometry": {}}}')
        done = CliRunner().invoke(manager.commands()["m-command"], [str(tmp_path)], catch_exceptions=False)
        assert done.output == "geometry\n"


def test_the_reader_of_the_scaffold_has_a_test_split(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_plugin("two splits", "capture_reader", tmp_path)
    reader = plugged(tmp_path / "hir-two-splits", "hir_two_splits", monkeypatch).create("capture_reader", "two_splits")
    folder = tmp_path / "capture"
    folder.mkdir()
    import_module("hir_two_splits.implementation").write_sample(tiny_capture(tmp_path / "truth").capture, folder)
    assert reader.splits(folder) == ["train"]
    shutil.copy(folder / "cameras.two_splits.json", folder / "cameras_test.two_splits.json")
    assert reader.splits(folder) == ["train", "test"] and reader.read(folder, "test").split == "test"


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=[] if k in ("capture_reader", "mask_source") else [pytest.mark.slow]) for k in KINDS],
)
def test_one_file_passes_and_is_used_by_its_path(kind: str, tmp_path: Path) -> None:
    path, use = write_one_file(f"grey {kind}", kind, tmp_path)
    assert path.name == f"grey_{kind}.py" and use.endswith(f"--plugin {path}")
    results = check_component(f"{kind}:grey_{kind}", plugins=PluginManager.discover((str(path),)))
    assert sum(result.outcome == "passed" for result in results) >= 12
    ruff = [sys.executable, "-m", "ruff", "check", "--isolated", "--line-length", "120", "--select", "E,F,I,B,UP"]
    done = subprocess.run([*ruff, path], capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stdout
    with pytest.raises(ConfigError, match="exists; choose another name"):
        write_one_file(f"grey {kind}", kind, tmp_path)


@pytest.mark.parametrize("kind", ["observer", "command"])
def test_one_file_of_another_kind_is_refused(kind: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["new-plugin", "it", "--kind", kind, "--one-file", "-o", str(tmp_path)])
    assert done.exit_code and list(tmp_path.iterdir()) == []
    assert isinstance(done.exception, ConfigError) and f"does not write the kind {kind}" in str(done.exception)


def test_invalid_names_and_existing_folders_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="does not begin with a letter"):
        write_plugin("42", "regularizer", tmp_path)
    for name in ("../mine", "plugins\\mine"):
        with pytest.raises(ConfigError, match="is a path; give the name alone"):
            write_plugin(name, "regularizer", tmp_path / "new")
    for name, letter in (("ünï", "ï"), ("my_term.py", ".")):  # they had become n.py and my_term_py.py
        with pytest.raises(ConfigError, match=re.escape(f"contains {letter!r}; names have letters a to z")):
            write_one_file(name, "regularizer", tmp_path / "new")
    write_plugin("hir-mine", "mask_source", tmp_path)
    assert (tmp_path / "hir-mine" / "hir_mine" / "plugin.py").is_file()
    with pytest.raises(ConfigError, match="exists"):
        write_plugin("mine", "mask_source", tmp_path)


def test_command_prints_the_next_steps(tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["new-plugin", "my-term", "--kind", "regularizer", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
    assert f"pip install -e {tmp_path / 'hir-my-term'}" in done.output
    assert "hir check-plugin hir-my-term" in done.output


@pytest.mark.parametrize(
    ("name", "kind", "owner"),
    [
        ("laplacian", "regularizer", "the regularizer 'laplacian' of hir"),
        ("hir-GLB", "exporter", "the exporter 'glb' of hir"),
        ("previews", "observer", "an installed observer"),
        ("batch", "command", "an installed command"),
        ("check-plugin", "command", "an installed command"),
    ],
)
def test_a_name_that_is_taken_is_refused(name: str, kind: str, owner: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["new-plugin", name, "--kind", kind, "-o", str(tmp_path)])
    assert isinstance(done.exception, ConfigError) and f"is taken by {owner}, which" in str(done.exception)
    assert list(tmp_path.iterdir()) == []


def test_a_name_of_another_kind_is_free(tmp_path: Path) -> None:
    done = CliRunner().invoke(cli, ["new-plugin", "laplacian", "--kind", "exporter", "-o", str(tmp_path)])
    assert done.exit_code == 0, done.output
