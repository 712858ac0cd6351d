"""Plugins are found, conflicts and broken plugins are named with the distribution that made them, the rest goes on."""

from __future__ import annotations

import subprocess
import sys
import types
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import click
import pytest
from annotated_types import Interval, Unit

from hir_core.config import RunConfig
from hir_core.errors import ConfigError, MissingExtraError, PluginError
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.manager import KINDS, PluginManager
from hir_core.plugins.options import build_options, device_of_run, options_schema, seed_of_run, with_seed_of_run


@dataclass(frozen=True)
class Options:
    """Options of a component made for tests."""

    strength: float = 1.0


class Thing:
    """What a component builds."""

    def __init__(self, config: Options) -> None:
        self.config = config


def plugin_of(*components: Component, hook: str = "hir_register_regularizers") -> object:
    """A plugin object that registers `components` through one hook."""

    def register() -> list[Component]:
        return list(components)

    return types.SimpleNamespace(__name__="made_here", **{hook: hookimpl(register)})


def component(name: str = "thing", **changes: object) -> Component:
    """A component whose implementation is `Thing`."""
    return Component(**{"name": name, "target": f"{__name__}:Thing", "config": Options} | changes)  # type: ignore[arg-type]


@pytest.fixture(autouse=True)
def importable(monkeypatch: pytest.MonkeyPatch) -> None:
    # importlib mode does not put test modules on sys.path, and components name their classes by import string
    monkeypatch.setitem(sys.modules, __name__, sys.modules.get(__name__, types.ModuleType(__name__)))
    monkeypatch.setattr(sys.modules[__name__], "Thing", Thing, raising=False)


def test_built_ins_load_without_a_problem() -> None:
    manager = PluginManager.discover()
    assert manager.problems == []
    kinds = {registered.kind for registered in manager.components()}
    assert kinds == set(KINDS), "every kind of plugin has a built-in"


def test_create_builds_from_checked_options() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component()), "one", "1.0")
    assert manager.create("regularizer", "thing", {"strength": 2}).config == Options(2.0)
    with pytest.raises(ConfigError, match=r"regularizer 'thing'.*unknown option 'strenght'.*strength"):
        manager.create("regularizer", "thing", {"strenght": 2})
    with pytest.raises(ConfigError, match="strength"):
        manager.create("regularizer", "thing", {"strength": float("nan")})


def test_unknown_name_lists_the_known_ones() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component("a"), component("b")), "one", "1.0")
    with pytest.raises(PluginError, match="no regularizer named 'c'; installed: a, b"):
        manager.find("regularizer", "c")


def test_name_conflict_names_both_distributions_and_keeps_the_first() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component()), "one", "1.0")
    manager.register(plugin_of(component(), component("other")), "two", "2.0")
    assert manager.find("regularizer", "thing").distribution == "one"
    assert manager.find("regularizer", "other").distribution == "two"
    (problem,) = manager.problems
    assert "two" in problem and "one" in problem and "'thing'" in problem


@pytest.mark.parametrize(
    ("plugin", "said"),
    [
        (plugin_of(hook="hir_register_regularizer"), "hir_register_regularizer"),
        (plugin_of(component(api=99)), "interface 99"),
        (plugin_of("laplacian"), "a Component is needed"),  # type: ignore[arg-type]
        (
            types.SimpleNamespace(__name__="raises", hir_register_regularizers=hookimpl(lambda: 1 / 0)),
            "ZeroDivisionError",
        ),
    ],
    ids=["misspelt hook", "wrong interface", "no component", "raises"],
)
def test_broken_plugin_is_reported_and_stops_nothing(plugin: object, said: str) -> None:
    manager = PluginManager()
    manager.register(plugin, "broken", "1.0")
    manager.register(plugin_of(component()), "sound", "1.0")
    (problem,) = manager.problems
    assert "broken" in problem and said in problem
    assert [r.component.name for r in manager.components()] == ["thing"]


def test_missing_extra_names_the_command() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component(requires=("no_such_module",), extra="reconstruct")), "hir", "1.0")
    with pytest.raises(
        MissingExtraError, match=r"needs no_such_module; install it with: pip install 'hir\[reconstruct\]'"
    ):
        manager.create("regularizer", "thing")


def test_observer_that_raises_is_reported_once_and_the_others_are_notified() -> None:
    notified: list[str] = []

    def broken(stage: str) -> None:
        raise RuntimeError("no disk")

    def sound(stage: str) -> None:
        notified.append(stage)

    manager = PluginManager()
    manager.register(types.SimpleNamespace(__name__="sound", hir_stage_finished=hookimpl(sound)), "one", "1")
    manager.register(types.SimpleNamespace(__name__="broken", hir_stage_finished=hookimpl(broken)), "two", "1")
    for stage in ("geometry", "atlas"):
        manager.notify("hir_stage_finished", stage=stage, scene=None, report={})
    assert notified == ["geometry", "atlas"]
    (problem,) = manager.problems
    assert "two:broken" in problem and "no disk" in problem


def test_document_edit_that_raises_is_an_error_naming_the_plugin() -> None:
    def edit(document: object) -> None:
        raise RuntimeError("half done")

    manager = PluginManager()
    manager.register(types.SimpleNamespace(__name__="vendor", hir_gltf_document=hookimpl(edit)), "studio", "1")
    with pytest.raises(PluginError, match="studio:vendor: hir_gltf_document raised RuntimeError: half done"):
        manager.edit("hir_gltf_document", object(), None, "document")


def test_plugin_file_is_loaded_by_path_and_a_broken_one_is_an_error(tmp_path: Path) -> None:
    good = tmp_path / "mine.py"
    good.write_text(
        "from hir_core.plugins import Component, hookimpl\n"
        "@hookimpl\n"
        "def hir_register_regularizers():\n"
        "    return [Component(name='mine', target='hir_plugin_mine:Mine')]\n"
        "class Mine:\n"
        "    def __init__(self, config): pass\n"
    )
    manager = PluginManager.discover((str(good),))
    assert type(manager.create("regularizer", "mine")).__name__ == "Mine"
    (tmp_path / "bad.py").write_text("import no_such_module_at_all\n")
    with pytest.raises(PluginError, match=r"bad\.py.*no_such_module_at_all"):
        PluginManager.discover((str(tmp_path / "bad.py"),))


def test_two_entry_points_of_one_name_are_both_loaded(tmp_path: Path) -> None:
    """pluggy's own loader drops the second silently."""
    for number in (1, 2):
        (tmp_path / f"dist{number}_plugin.py").write_text(
            "from hir_core.plugins import Component, hookimpl\n"
            "@hookimpl\n"
            "def hir_register_regularizers():\n"
            f"    return [Component(name='from_dist{number}', target='dist{number}_plugin:X')]\n"
        )
        info = tmp_path / f"dist{number}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: dist{number}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[hir]\nsame_name = dist{number}_plugin\n")
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from hir_core.plugins.manager import PluginManager\n"
        "m = PluginManager.discover(); assert not m.problems, m.problems\n"
        "print(*[(r.component.name, r.distribution) for r in m.components('regularizer') if 'dist' in r.distribution])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "('from_dist1', 'dist1') ('from_dist2', 'dist2')"


@pytest.mark.parametrize(("api", "advice"), [(0, "upgrade the plugin"), (2, "upgrade hir")])
def test_older_and_newer_plugins_are_refused_with_what_to_upgrade(api: int, advice: str) -> None:
    manager = PluginManager()
    manager.register(plugin_of(component(api=api)), "studio", "1.0")
    manager.register(types.SimpleNamespace(__name__="observer", hir_api=api), "studio", "1.0")
    assert manager.components() == []
    assert [advice in problem and f"interface {api}, this hir has 1" in problem for problem in manager.problems] == [
        True,
        True,
    ]


def test_a_version_that_is_no_number_is_refused() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component(api="1")), "studio", "1.0")
    assert manager.problems == [
        "regularizer 'thing' of studio says api='1', which is no version of the plugin interface; write api=1"
    ]


def test_a_plugin_that_names_no_version_is_taken_for_the_first(monkeypatch: pytest.MonkeyPatch) -> None:
    from hir_core.plugins import manager as module

    monkeypatch.setattr(module, "API_VERSION", 2)
    manager = PluginManager()
    manager.register(plugin_of(component()), "studio", "1.0")
    assert ["is made for plugin interface 1, this hir has 2" in problem for problem in manager.problems] == [True]


def test_commands_of_two_plugins_do_not_replace_each_other_or_ours() -> None:
    def adding(name: str, help_text: str) -> object:
        def register(cli: click.Group) -> None:
            cli.add_command(click.Command(name, help=help_text))

        return types.SimpleNamespace(__name__=f"adds_{name}", hir_register_commands=hookimpl(register))

    manager = PluginManager()
    for distribution, name in (("one", "measure"), ("two", "measure"), ("three", "export"), ("four", "count")):
        manager.register(adding(name, f"Of {distribution}."), distribution, "1.0")
    assert {name: command.help for name, command in manager.commands().items()} == {
        "measure": "Of one.",
        "count": "Of four.",
    }
    assert manager.problems == [
        "command 'measure' of two is ignored: one has one of that name; rename one of the two, or remove it",
        "command 'export' of three is ignored: hir has one of that name; rename one of the two, or remove it",
    ]
    assert manager.commands() and len(manager.problems) == 2, "commands are collected once"


@dataclass(frozen=True)
class Ranged:
    """Options with ranges and units."""

    reach: Annotated[float, Interval(gt=0, le=2), Unit("m")] = 0.1
    """How far."""


def test_a_number_outside_of_its_range_is_named_with_range_and_unit() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component(config=Ranged)), "studio", "1.0")
    with pytest.raises(ConfigError, match=r"option 'reach' is 3; it must be > 0 and ≤ 2 m$"):
        manager.create("regularizer", "thing", {"reach": 3})
    with pytest.raises(ConfigError, match=r"option 'reach' is 'far'; it must be a number \(> 0 and ≤ 2 m\)$"):
        manager.create("regularizer", "thing", {"reach": "far"})
    assert options_schema(Ranged)["properties"]["reach"]["unit"] == "m"


@dataclass(frozen=True)
class Listed:
    """Options that are lists."""

    formats: tuple[str, ...] = ()
    """Names."""
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    """A direction."""


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"formats": "glb"}, """option 'formats' must be a list of text such as ["glb"] (got 'glb')"""),
        ({"formats": "glb, usdz"}, """such as ["glb", "usdz"] (got 'glb, usdz')"""),
        ({"formats": 3}, """option 'formats' must be a list of text such as ["name"] (got 3)"""),
        ({"up": 1.0}, "option 'up' must be a list of 3 numbers such as [1, 2, 3] (got 1.0)"),
    ],
)
def test_a_value_that_is_no_list_is_answered_with_one(values: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        build_options(Listed, values, "settings")
    assert message in str(caught.value) and "tuple" not in str(caught.value)


def test_a_deprecated_argument_is_a_notice_and_still_arrives(monkeypatch: pytest.MonkeyPatch) -> None:
    from hir_core.plugins import hookspecs

    warning = DeprecationWarning("hir_stage_finished: 'report' goes with api 2; read run.json in its place")

    def specification(stage: str, scene: object, report: object) -> None:
        """As it is, with an argument on its way out."""

    marked = hookspecs.hookspec(warn_on_impl_args={"report": warning})(specification)
    marked.__name__ = "hir_stage_finished"
    monkeypatch.setattr(hookspecs, "hir_stage_finished", marked)
    seen: list[object] = []

    def old(report: object) -> None:
        seen.append(report)

    manager = PluginManager()
    manager.register(types.SimpleNamespace(__name__="old", hir_stage_finished=hookimpl(old)), "studio", "1.0")
    manager.register(plugin_of(component()), "modern", "1.0")
    assert manager.problems == []
    assert manager.notices == [f"studio:old: {warning}"]
    manager.notify("hir_stage_finished", stage="atlas", scene=None, report={"charts": 3})
    assert seen == [{"charts": 3}]


def test_observers_have_checked_options(tmp_path: Path) -> None:
    from hir_core.config import load_config

    manager = PluginManager.discover()
    file = tmp_path / "watcher.py"
    file.write_text(
        "from dataclasses import dataclass\n"
        "from hir_core.plugins import hookimpl\n"
        "@dataclass(frozen=True)\n"
        "class Options:\n"
        "    every: int = 1\n"
        "@hookimpl\n"
        "def hir_register_observers():\n"
        "    return {'watcher': Options}\n"
    )
    named = [f'plugins=["{file}"]']  # a plugin that settings name is loaded before its options are checked
    config = load_config(manager, assignments=[*named, "observers.watcher.every=3"])
    assert config.observers == {"watcher": {"every": 3}}
    with pytest.raises(ConfigError, match="unknown option 'evry'; did you mean 'every'"):
        load_config(manager, assignments=[*named, "observers.watcher.evry=3"])
    with pytest.raises(
        ConfigError, match="no observer 'wacher'; installed: previews, progress_file, tensorboard, watcher"
    ):
        load_config(manager, assignments=[*named, "observers.wacher={}"])


def test_a_plugin_from_a_file_names_the_packages_to_install(tmp_path: Path) -> None:
    manager = PluginManager()
    manager.register(plugin_of(component(requires=("no_such_module",), extra="reconstruct")), "my.py", "")
    with pytest.raises(MissingExtraError, match=r"install it with: pip install no_such_module$"):
        manager.create("regularizer", "thing")


def test_a_second_preset_or_observer_of_a_name_is_reported_and_ignored(tmp_path: Path) -> None:
    class Twice:
        @hookimpl
        def hir_register_presets(self) -> dict[str, str]:
            return {"quick": str(tmp_path / "quick.toml")}

        @hookimpl
        def hir_register_observers(self) -> dict[str, object]:
            return {"notes": Options}

    plugins = PluginManager()
    for distribution in ("first", "second"):
        plugins.register(Twice(), distribution, "1")
    assert sorted(plugins.problems) == [
        "observer 'notes' of second is ignored: first has one of that name; rename one of the two, or remove it",
        "preset 'quick' of second is ignored: first has one of that name; rename one of the two, or remove it",
    ]


def test_the_suggestion_of_the_latest_plugin_that_has_one_wins() -> None:
    class Says:
        def __init__(self, words: list[str] | None) -> None:
            self.words = words

        @hookimpl
        def hir_suggest_initializers(self, capture: object) -> list[str] | None:
            return self.words

    plugins = PluginManager()
    assert plugins.suggest_initializers(None) == []
    for number, words in enumerate((["mesh_file"], ["colmap"], None)):
        plugins.register(Says(words), f"plugin{number}", "1")
    plugins.register(plugin_of(component("colmap"), hook="hir_register_initializers"), "names", "1")
    assert plugins.suggest_initializers(None) == ["colmap"]


def test_a_named_plugin_that_is_refused_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "odd.py").write_text(
        "from hir_core.plugins import hookimpl\n@hookimpl\ndef hir_register_something():\n    return []\n"
    )
    with pytest.raises(PluginError, match="hir_register_something"):
        PluginManager().register_named(str(tmp_path / "odd.py"))


@dataclass(frozen=True)
class DrawingOptions:
    """Options of a component that draws random numbers of its own."""

    seed: int = seed_of_run()
    fixed: int = 0


def test_a_component_gets_the_seed_of_the_run_unless_it_is_given_one() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component(config=DrawingOptions)), "made-here", "1")
    assert manager.create("regularizer", "thing").config == DrawingOptions(0, 0)
    assert manager.create("regularizer", "thing", {"fixed": 2}, seed=5).config == DrawingOptions(5, 2)
    assert manager.create("regularizer", "thing", {"seed": 3}, seed=5).config == DrawingOptions(3, 0)
    assert manager.create("regularizer", "thing", {"seed": 0}, seed=5).config == DrawingOptions(0, 0)


@dataclass(frozen=True)
class PlacedOptions:
    """Options of an initializer that computes on a device of its own choice."""

    device: str = device_of_run()


def test_an_initializer_gets_the_device_of_the_run_unless_it_is_given_one() -> None:
    manager = PluginManager()
    manager.register(plugin_of(component(config=PlacedOptions)), "made-here", "1")
    assert manager.create("regularizer", "thing").config == PlacedOptions("auto")
    assert manager.create("regularizer", "thing", device="cpu").config == PlacedOptions("cpu")
    assert manager.create("regularizer", "thing", {"device": "cuda"}, device="cpu").config == PlacedOptions("cuda")


def test_every_seed_of_a_built_in_component_is_by_default_that_of_the_run() -> None:
    found = set()
    for registered in PluginManager.discover().components():
        kind = registered.component.config
        for name in getattr(kind, "__dataclass_fields__", {}):
            if "seed" in name:
                assert with_seed_of_run(kind, {}, 7) == {"seed": 7}, registered.component.name
                found.add(registered.component.name)
    assert found == {
        "camera_refinement",
        "colmap",
        "grabcut",
        "hollows",
        "mesh_file",
        "poisson",
        "sensor_depth",
        "stereo",
        "transport_ggx",
        "visual_hull",
    }


def test_a_check_of_the_options_class_is_said_once() -> None:
    with pytest.raises(ConfigError, match=r"max_texture_size is 0; it must be from 1 to 65536$"):
        PluginManager.discover().create("exporter", "glb", {"max_texture_size": 0})


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"max_texture_size": True}, r"'max_texture_size' is True; it must be a number \(1 … 65536\)"),
        ({"max_texture_size": "x"}, r"'max_texture_size' is 'x'; it must be a whole number \(1 … 65536\)"),
        ({"max_texture_size": None}, r"'max_texture_size' is None; it must be a whole number \(1 … 65536\)"),
        ({"quantize": "maybe"}, "'quantize' is 'maybe'; it must be true or false"),
        ({"tangents": 5}, "'tangents' is 5; it must be 'auto', 'always' or 'never'"),
        ({"lods": ["x"]}, "'lods.0' is 'x'; it must be a whole number"),
    ],
)
def test_a_value_of_a_wrong_type_is_one_sentence(options: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError, match=f"^exporter 'glb': option {said}$"):
        PluginManager.discover().create("exporter", "glb", options)


def test_true_is_no_number_in_a_table_of_settings() -> None:
    with pytest.raises(ConfigError, match=r"option 'geometry.iterations' is True; it must be a number"):
        build_options(RunConfig, {"geometry": {"iterations": True}}, "settings")
