"""Keys of `--set`: names with a dot are quoted, as in TOML."""

from __future__ import annotations

import types
from dataclasses import dataclass
from typing import Any

import pytest

from hir_core.cli.export_command import _options
from hir_core.config import assign, load_config
from hir_core.errors import ConfigError
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.manager import PluginManager


@dataclass(frozen=True)
class Options:
    """Of an exporter with a dot in its name."""

    digits: int = 7
    """Of each number."""


@pytest.fixture
def plugins() -> PluginManager:
    manager = PluginManager.discover()
    register = hookimpl(lambda: [Component("simple.obj", "made.here:Obj", Options)])
    manager.register(types.SimpleNamespace(__name__="made", hir_register_exporters=register), "studio", "1.0")
    return manager


@pytest.mark.parametrize(
    ("assignment", "table"),
    [
        ("exporter.glb.digits=6", {"exporter": {"glb": {"digits": 6}}}),
        ('exporter."simple.obj".digits=6', {"exporter": {"simple.obj": {"digits": 6}}}),
        ("'simple.obj'.digits = 6", {"simple.obj": {"digits": 6}}),
        ('a."b c" . d="x=y"', {"a": {"b c": {"d": "x=y"}}}),
    ],
)
def test_a_quoted_name_is_one_name(assignment: str, table: dict[str, Any]) -> None:
    found: dict[str, Any] = {}
    assign(found, assignment)
    assert found == table


@pytest.mark.parametrize("assignment", ['"simple.obj.digits=6', 'a""b=6', 'a.""".b=6'])
def test_a_key_with_a_quote_too_few_is_refused(assignment: str) -> None:
    with pytest.raises(ConfigError, match="is no key; quote the whole name that contains a dot"):
        assign({}, assignment)


def test_options_of_a_format_with_a_dot_are_set(plugins: PluginManager) -> None:
    config = load_config(plugins, assignments=['exporter."simple.obj".digits=6'])
    assert config.exporter == {"simple.obj": {"digits": 6}}
    assert _options(plugins, ('"simple.obj".digits=6',), ["simple.obj"], {}) == {"simple.obj": {"digits": 6}}


def test_the_quotes_are_in_the_answer_to_a_name_without(plugins: PluginManager) -> None:
    with pytest.raises(ConfigError, match=r"quote a name that contains a dot: --set '\"simple.obj\".OPTION=VALUE'"):
        _options(plugins, ("simple.obj.digits=6",), ["simple.obj"], {})
