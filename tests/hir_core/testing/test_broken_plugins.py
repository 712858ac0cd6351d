"""Each contract has a plugin that breaks it, and it alone; the sound ones that they are made of break none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import pytest

from hir_core.plugins import Component
from hir_core.plugins.loading import module_from_file
from hir_core.plugins.manager import PluginManager, Registered
from hir_core.testing import ContractError, all_checks, check_component, check_whole_plugin, whole_plugin
from hir_core.testing.checks import every_kind
from hir_core.testing.checks.reflectance_renderer_checks import _factor
from hir_core.testing.running import Result, as_registered, plugin_checks
from tests.hir_core.testing import (
    broken_exporters,
    broken_initializers,
    broken_inputs,
    broken_regularizers,
    broken_renderers,
)

CAMERAS = "cameras_are_the_true_ones"

QUICK: dict[str, Mapping[str, Component]] = {
    "regularizer": broken_regularizers.BROKEN,
    "geometry_renderer": broken_renderers.BROKEN_GEOMETRY,
    "capture_reader": broken_inputs.BROKEN_READERS,
    "mask_source": broken_inputs.BROKEN_MASKS,
    "exporter": broken_exporters.BROKEN_EXPORTERS,
    "initializer": {k: v for k, v in broken_initializers.BROKEN_INITIALIZERS.items() if k != CAMERAS},
}
SLOW: dict[str, Mapping[str, Component]] = {
    "reflectance_renderer": broken_renderers.BROKEN_REFLECTANCE,
    "initializer": {CAMERAS: broken_initializers.BROKEN_INITIALIZERS[CAMERAS]},
}
FROM_FILES = ("imports_light", "imports_quickly", "requirements_declared", "missing_extra_is_named")
SOUND = [
    ("regularizer", broken_regularizers.SOUND),
    ("regularizer", broken_regularizers.SOUND_LAGGED),
    ("geometry_renderer", broken_renderers.geometry()),
    ("capture_reader", broken_inputs.reader()),
    ("mask_source", broken_inputs.mask_source()),
    ("initializer", broken_initializers.surface()),
    ("exporter", broken_exporters.obj()),
    ("exporter", broken_exporters.ply()),
    ("exporter", broken_exporters.corners(broken_exporters.CornersWithAWarning)),
    ("exporter", broken_exporters.usda()),
]


def cases(table: Mapping[str, Mapping[str, Component]]) -> list[object]:
    return [
        pytest.param(kind, component, check, id=f"{check}-{component.target.rpartition(':')[2]}")
        for kind, broken in table.items()
        for check, component in broken.items()
    ]


def failed(results: list[Result]) -> list[str]:
    return [result.check for result in results if result.outcome == "failed"]


@pytest.fixture(scope="module")
def plugins() -> PluginManager:
    return PluginManager.discover()


def test_every_contract_has_its_broken_plugin() -> None:
    covered = {check for table in (*QUICK.values(), *SLOW.values()) for check in table}
    of_plugins = {check.name for check in plugin_checks()}
    assert covered | {*FROM_FILES, "devices_agree"} == set(all_checks()) - of_plugins
    assert of_plugins == set(BROKEN_PLUGINS)


@pytest.mark.parametrize(("kind", "component", "check"), cases(QUICK))
def test_breaks_its_contract(kind: str, component: Component, check: str, plugins: PluginManager) -> None:
    results = check_component(as_registered(kind, component), plugins=plugins, only=[check], raises=False)
    assert failed(results) == [check], [r.detail for r in results if r.outcome == "failed"]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "component", "check"), [*cases(QUICK), *cases(SLOW)])
def test_breaks_no_other_contract(kind: str, component: Component, check: str, plugins: PluginManager) -> None:
    results = check_component(as_registered(kind, component), plugins=plugins, raises=False)
    assert failed(results) == [check], [r.detail for r in results if r.outcome == "failed"]


@pytest.mark.parametrize(("kind", "component"), SOUND, ids=[f"{k}-{c.name}" for k, c in SOUND])
def test_sound_ones_break_none(kind: str, component: Component, plugins: PluginManager) -> None:
    check_component(as_registered(kind, component), plugins=plugins)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "component"),
    [
        ("reflectance_renderer", broken_renderers.reflectance()),
        ("reflectance_renderer", broken_renderers.solving(broken_renderers.Exposed)),
        ("reflectance_renderer", broken_renderers.of_takes(broken_renderers.Exposed)),
        ("reflectance_renderer", broken_renderers.with_lamp(broken_renderers.Traced)),
        ("initializer", broken_initializers.cameras()),
    ],
    ids=["reflectance_renderer", "solver", "takes", "lamp", "cameras"],
)
def test_slow_sound_ones_break_none(kind: str, component: Component, plugins: PluginManager) -> None:
    check_component(as_registered(kind, component), plugins=plugins)


@pytest.mark.gpu
def test_devices_agree_is_broken_by_one_that_goes_elsewhere(plugins: PluginManager) -> None:
    component = as_registered("regularizer", broken_regularizers.BROKEN_ON_CUDA)
    assert failed(check_component(component, plugins=plugins, raises=False)) == ["devices_agree"]


FILE = """
from hir_core.plugins.interfaces import Regularizer
from hir_core.plugins import Component, NoOptions, hookimpl
{at_the_top}

class Spread(Regularizer):
    def __init__(self, config: NoOptions) -> None: ...

    def prepare(self, scene):
        {inside}
        return lambda scene: (scene.mesh.positions - scene.mesh.positions.mean(dim=0)).square().sum()

def ideal(scene):
    from dataclasses import replace
    return replace(scene, mesh=scene.mesh.with_positions(scene.mesh.positions * 0))

@hookimpl
def hir_register_regularizers():
    return [Component("{name}", "hir_plugin_{name}:Spread", summary="Keeps vertices together.",
                      requires={requires}, traits=frozenset({{"differentiable"}}), testing="hir_plugin_{name}:ideal")]
"""
SLOW_IMPORT = "import sys, time; time.sleep(0 if 'pytest' in sys.modules else 2.5)"
"""The contract imports the file in a process of its own; this process need not wait."""


@pytest.mark.parametrize(
    ("check", "at_the_top", "inside", "requires"),
    [
        ("imports_light", "import torch", "", ("torch",)),
        ("imports_quickly", SLOW_IMPORT, "", ()),
        ("requirements_declared", "", "import torch", ()),
    ],
    ids=["imports_light", "imports_quickly", "requirements_declared"],
)
def test_file_breaks_its_contract(
    check: str,
    at_the_top: str,
    inside: str,
    requires: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(every_kind, "TRIES", 1)  # more of them are for a busy machine
    path = tmp_path / f"broken_{check}.py"
    path.write_text(FILE.format(at_the_top=at_the_top, inside=inside, requires=requires, name=path.stem))
    plugins = PluginManager.discover((str(path),))
    results = check_component(path.stem, plugins=plugins, only=[check], raises=False)
    assert failed(results) == [check], [r.detail for r in results if r.outcome == "failed"]


QUIET_OBSERVER = "@hookimpl\ndef hir_progress(progress):\n    pass\n"
BROKEN_PLUGINS = {
    "is_loaded": "@hookimpl\ndef hir_register_regularizer():\n    return []\n",
    "is_made_for_this_interface": "hir_api = 0\n",
    "names_are_free": "@hookimpl\ndef hir_register_presets():\n    return {'fast': 'fast.toml'}\n",
    "registers_something": "def hir_register_regularizers():\n    return []\n",
    "plugin_imports_light": f"import torch\n{QUIET_OBSERVER}",
    "plugin_imports_quickly": f"import time; time.sleep(2.5)\n{QUIET_OBSERVER}",
    "presets_are_settings": (
        "from pathlib import Path\nPRESET = Path(__file__).with_suffix('.toml')\nPRESET.write_text('exports = []')\n"
        "@hookimpl\ndef hir_register_presets():\n    return {'quick': PRESET}\n"
    ),
    "observer_options_are_sound": (
        "from dataclasses import dataclass\n@dataclass(frozen=True)\nclass Options:\n    every: int = 1\n"
        "@hookimpl\ndef hir_register_observers():\n    return {'watcher': Options}\n"
    ),
    "observer_raises_nothing": "@hookimpl\ndef hir_progress(progress):\n    progress.scalars['loss']\n",
    "observer_is_off_without_its_table": (
        "from dataclasses import dataclass\n@dataclass(frozen=True)\nclass Options:\n    every: int = 1\n    'Steps.'\n"
        "@hookimpl\ndef hir_register_observers():\n    return {'watcher': Options}\n"
        "@hookimpl\ndef hir_run_started(run_folder):\n    (run_folder / 'notes.txt').write_text('begun')\n"
    ),
    "observer_stays_in_its_run": "@hookimpl\ndef hir_stage_finished(report):\n    report.clear()\n",
    "commands_have_help": (
        "import click\n@hookimpl\ndef hir_register_commands(cli):\n"
        "    cli.add_command(click.Command('silent', callback=print))\n"
    ),
    "commands_refuse_what_is_missing": (
        "import click\n@click.command('sizes')\n@click.argument('folder', type=click.Path())\ndef sizes(folder):\n"
        "    'Lists the sizes of files.'\n    import os\n    print(os.listdir(folder))\n"
        "@hookimpl\ndef hir_register_commands(cli):\n    cli.add_command(sizes)\n"
    ),
}
"""Code of a plugin that breaks the contract of plugins as a whole, and no other."""


@pytest.mark.parametrize(
    "check",
    [
        pytest.param(check, marks=[pytest.mark.slow] if check == "plugin_imports_quickly" else [])
        for check in BROKEN_PLUGINS
    ],
)
def test_plugin_breaks_its_contract_and_no_other(check: str, tmp_path: Path) -> None:
    path = tmp_path / f"broken_{check}.py"
    path.write_text(f"from hir_core.plugins import hookimpl\n{BROKEN_PLUGINS[check]}")
    subject = whole_plugin(str(path), PluginManager.discover((str(path),), strict=False))
    assert subject is not None
    results = check_whole_plugin(subject, raises=False)
    assert failed(results) == [check], [r.detail for r in results if r.outcome == "failed"]


@pytest.mark.parametrize(
    ("code", "advice"),
    [
        ("", "registers nothing; write @hookimpl above a function whose name begins with hir_register_"),
        ("def hir_register_commands(cli):\n    pass\n", "hir does not call hir_register_commands; write @hookimpl"),
        ("@hookimpl\ndef hir_register_commands(cli):\n    pass\n", "hir_register_commands must return, or add"),
        ("@hookimpl\ndef hir_register_exporters():\n    return []\n", "hir_register_exporters must return, or add"),
        (f"{QUIET_OBSERVER}def hir_register_observers():\n    return {{}}\n", "does not call hir_register_observers;"),
    ],
    ids=["no hook", "not marked", "adds nothing", "returns nothing", "one of two not marked"],
)
@pytest.mark.parametrize("is_installed", [False, True], ids=["file", "installed"])
def test_a_plugin_that_registers_nothing_fails(code: str, advice: str, is_installed: bool, tmp_path: Path) -> None:
    path = tmp_path / "idle.py"
    path.write_text(f"from hir_core.plugins import hookimpl\n{code}")
    if is_installed:
        plugins, name = PluginManager(), "hir-idle"
        plugins.register(module_from_file(path), distribution=name, version="1.0")
    else:
        plugins, name = PluginManager.discover((str(path),), strict=False), str(path)
    subject = whole_plugin(name, plugins)
    assert subject is not None
    results = check_whole_plugin(subject, raises=False)
    assert failed(results) == ["registers_something"]
    (message,) = [r.detail for r in results if r.outcome == "failed"]
    assert advice in message and "docs/writing_plugins/index.md" in message


@pytest.mark.slow
def test_the_built_in_plugins_break_none(plugins: PluginManager) -> None:
    subject = whole_plugin("hir", plugins)
    assert subject is not None
    skipped = [r.check for r in check_whole_plugin(subject) if r.outcome == "skipped"]
    assert skipped == []


@pytest.mark.parametrize(
    ("found", "advice"),
    [
        (2.0014, "2.0 times too bright: look for a missing division or a factor π"),
        (0.318, "3.1 times too dark: look for a division too many or a missing factor π"),
        (1.02, ""),
        (0.0, ""),
    ],
)
def test_a_wrong_factor_of_a_renderer_is_named(found: float, advice: str) -> None:
    assert _factor(found, 0.99, 1.01) == (f"; it is {advice}" if advice else "")


def test_an_extra_that_is_none_is_found(plugins: PluginManager) -> None:
    component = broken_regularizers.made(extra="reconstuct")
    registered = Registered("regularizer", component, "hir", "1.0", "tests")
    results = check_component(registered, plugins=plugins, raises=False)
    assert failed(results) == ["missing_extra_is_named"]
    (message,) = [r.detail for r in results if r.outcome == "failed"]
    assert "'reconstuct' is no extra of hir" in message and "reconstruct" in message


def test_a_failure_names_contract_what_was_seen_and_section(plugins: PluginManager) -> None:
    component = as_registered("regularizer", broken_regularizers.BROKEN["gradient_is_that_of_the_value"])
    with pytest.raises(ContractError) as caught:
        check_component(component, plugins=plugins)
    message = str(caught.value)
    assert "regularizer 'spread' breaks the contract 'gradient_is_that_of_the_value'" in message
    assert "contract: In float64 the gradient agrees with central differences" in message
    assert "positions the gradient says" in message
    assert "see:      docs/writing_plugins/contracts.md#gradient_is_that_of_the_value" in message
