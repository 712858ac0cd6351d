"""A hook that raises or returns another type during a run is named with its plugin."""

from __future__ import annotations

import types
from collections.abc import Callable
from pathlib import Path

import pytest

from hir_core.errors import PluginError
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.manager import PluginManager

HULL = Component("hull", "made.here:Hull")


def manager_with(hook: str, *functions: Callable[..., object]) -> PluginManager:
    manager = PluginManager()
    for number, function in enumerate(functions):
        plugin = types.SimpleNamespace(__name__=f"made{number}", **{hook: hookimpl(function)})
        manager.register(plugin, "studio", "1.0")
    register = hookimpl(lambda: [HULL])
    manager.register(types.SimpleNamespace(__name__="hull", hir_register_initializers=register), "shapes", "1.0")
    return manager


@pytest.mark.parametrize(
    ("suggestion", "said"),
    [
        (lambda capture: capture.nothing, "raised AttributeError: 'NoneType' object has no attribute 'nothing'; mend"),
        (lambda capture: "hull", "returned 'hull'; return a list of names of initializers"),
        (lambda capture: [3], r"returned \[3\]; return a list of names"),
        (lambda capture: ["hul"], "returned 'hul', which is no initializer; installed: hull"),
    ],
    ids=["raises", "text", "numbers", "unknown"],
)
def test_a_suggestion_that_cannot_be_used_is_an_error(suggestion: Callable[[object], object], said: str) -> None:
    manager = manager_with("hir_suggest_initializers", suggestion)
    with pytest.raises(PluginError, match=f"^studio:made0: hir_suggest_initializers {said}"):
        manager.suggest_initializers(None)  # type: ignore[arg-type]


def test_a_suggestion_may_be_a_tuple() -> None:
    assert manager_with("hir_suggest_initializers", lambda capture: ("hull",)).suggest_initializers(None) == ["hull"]  # type: ignore[arg-type]


def test_a_viewer_page_that_cannot_be_used_is_a_problem_and_the_next_one_is_taken() -> None:
    pages = (lambda run_folder: "<p>a page</p>", lambda run_folder: 3, lambda run_folder: 1 / 0)
    manager = manager_with("hir_asset_page", *pages)
    for _ in range(2):
        assert manager.asset_page(Path("run")) == "<p>a page</p>"
    assert manager.problems == [
        "studio:made2: hir_asset_page raised ZeroDivisionError: division by zero",
        "studio:made1: hir_asset_page returned an int; return a page of HTML as text, or None",
    ]
