"""What a plugin registers is checked when it is loaded: a fault is one sentence, and the other plugins are loaded."""

from __future__ import annotations

import types
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from hir_core.errors import PluginError
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.manager import PluginManager


@dataclass(frozen=True)
class Options:
    """Options of a component made for tests."""

    strength: float = 1.0


class Term:
    """What a component builds."""


def generator() -> object:
    yield Component("sound", "made.here:Term")
    raise RuntimeError("half of them")


SOUND = Component("sound", "made.here:Term")


def plugin_with(hook: str, function: Callable[[], object]) -> object:
    return types.SimpleNamespace(__name__="made_here", **{hook: hookimpl(function)})


def problems_of(hook: str, function: Callable[[], object]) -> list[str]:
    """The problems of a plugin, after a sound one was loaded behind it."""
    manager = PluginManager()
    manager.register(plugin_with(hook, function), "broken", "1.0")
    manager.register(plugin_with("hir_register_exporters", lambda: [SOUND]), "behind", "1.0")
    assert [r.distribution for r in manager.components("exporter")] == ["behind"]
    assert manager.loaded[0].problems and not manager.loaded[1].problems
    assert {problem.fault for problem in manager.loaded[0].problems} == {"is_loaded"}
    return manager.problems


@pytest.mark.parametrize(
    ("hook", "returned", "said"),
    [
        ("hir_register_regularizers", SOUND, "returned a Component; return a list of Components"),
        ("hir_register_regularizers", {"name": SOUND}, "returned a dict; return a list of Components"),
        ("hir_register_regularizers", "laplacian", "returned a str; return a list of Components"),
        ("hir_register_regularizers", 3, "returned an int; return a list of Components"),
        ("hir_register_observers", ["a"], 'returned a list; return a dict such as {"NAME": Options}'),
        ("hir_register_observers", {"a": {}}, "the options of the observer 'a' are a dict; write the class itself"),
        ("hir_register_observers", {3: Options}, 'a dict with the key 3; a name is text: {"NAME": Options}'),
        ("hir_register_presets", [Path("x.toml")], 'returned a list; return a dict such as {"NAME": Path}'),
        ("hir_register_presets", {"a": None}, "the preset 'a' is None; write Path(__file__).with_name(\"NAME.toml\")"),
    ],
)
def test_a_wrong_container_is_a_problem_of_its_plugin(hook: str, returned: object, said: str) -> None:
    (problem,) = problems_of(hook, lambda: returned)
    assert problem.startswith("broken:made_here: ") and said in problem


def test_a_generator_that_raises_is_a_problem_of_its_plugin() -> None:
    (problem,) = problems_of("hir_register_regularizers", generator)
    assert problem == "broken:made_here: hir_register_regularizers raised RuntimeError: half of them"


def test_a_hook_that_ends_the_process_is_a_problem_of_its_plugin() -> None:
    def leave() -> None:
        raise SystemExit(0)

    (problem,) = problems_of("hir_register_regularizers", leave)
    assert problem == "broken:made_here: hir_register_regularizers raised SystemExit: 0"


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"name": 3}, 'name=3 is not text; write name="NAME"'),
        ({"name": ["a"]}, "name=['a'] is not text"),
        ({"target": Term}, f"target is the class Term; write its import path: target='{__name__}:Term'"),
        ({"target": "made.here.Term"}, "target is 'module:Class': write made.here:Term"),
        ({"target": "made.here:"}, "target='made.here:' is no import path; target is 'module:Class'"),
        ({"config": Options()}, "config is an Options, not a class; write config=Options"),
        ({"config": None}, "config is None, not a class; write the class of its options"),
        ({"summary": None}, 'summary is None; write text: summary="…"'),
        ({"testing": print}, 'write text: testing="…"'),
        ({"requires": "torch"}, 'requires is a str; write a tuple of modules: requires=("torch",)'),
        ({"traits": ["a", "b"]}, 'traits is a list; write a set: traits=frozenset({"a", "b"})'),
        ({"traits": "material"}, 'traits is a str; write a set: traits=frozenset({"material"})'),
    ],
)
def test_a_field_of_another_type_is_named_with_what_to_write(changes: dict[str, object], said: str) -> None:
    fields = {"name": "thing", "target": "made.here:Term", **changes}
    component = Component(**fields)  # type: ignore[arg-type]
    (problem,) = problems_of("hir_register_regularizers", lambda: [component])
    assert "the regularizer" in problem and "is not registered" in problem and said in problem


def test_the_sound_components_beside_a_broken_one_are_registered() -> None:
    manager = PluginManager()
    broken = Component("broken", "made.here.Term")
    manager.register(plugin_with("hir_register_regularizers", lambda: [broken, SOUND]), "one", "1.0")
    assert [r.component.name for r in manager.components()] == ["sound"] and len(manager.problems) == 1


def test_an_import_that_ends_the_process_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "leaves.py").write_text("import sys\nsys.exit(0)\n")
    with pytest.raises(PluginError, match=r"leaves\.py' cannot be imported \(SystemExit: 0\)"):
        PluginManager.discover((str(tmp_path / "leaves.py"),))
