"""`hir plugins --json` and `hir config schema` are enough for a program to list components and build forms."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pytest
from click.testing import CliRunner

from hir_core.cli.app import cli
from hir_core.errors import ConfigError
from hir_core.plugins.manager import KINDS, PluginManager

WIDGETS = {
    "boolean": "tick",
    "integer": "number",
    "number": "number",
    "string": "line",
    "array": "list",
    "object": "table",
}


@dataclass(frozen=True)
class Field:
    """One line of a form."""

    label: str
    widget: str
    help: str
    value: Any
    choices: tuple[Any, ...] = ()


def form(schema: Mapping[str, Any], definitions: Mapping[str, Any] | None = None) -> Iterator[Field]:
    """The lines of a form, by the words of JSON schema alone; tables of tables become lines with dots."""
    known = {**(definitions or {}), **schema.get("$defs", {})}
    for name, entry in schema.get("properties", {}).items():
        target = known[entry["$ref"].rpartition("/")[2]] if "$ref" in entry else entry
        if "properties" in target:
            for field in form(target, known):
                yield Field(f"{name}.{field.label}", field.widget, field.help, field.value, field.choices)
            continue
        options = [target, *target.get("anyOf", [])]
        choices = tuple(c for option in options for c in option.get("enum", [option.get("const")]) if c is not None)
        types = [option["type"] for option in options if "type" in option]
        widget = "choice" if "enum" in target else WIDGETS[types[0]]
        described = entry.get("description", target.get("description", ""))
        yield Field(name, widget, described, target.get("default"), choices)


def message(*arguments: str) -> Any:
    done = CliRunner().invoke(cli, list(arguments), catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def listed() -> Any:
    return message("plugins", "--json")


@pytest.fixture(scope="module")
def schema() -> Any:
    return message("config", "schema")


@pytest.mark.slow
def test_every_listed_component_has_a_form(listed: Any, schema: Any) -> None:
    rows = listed["components"]
    assert {row["kind"] for row in rows} == set(KINDS)
    for row in rows:
        fields = list(form(schema["components"][row["kind"]][row["name"]]))
        for field in fields:
            assert field.widget and field.help, (row["name"], field.label)
            assert field.value is not None, (row["name"], field.label)
            assert field.widget != "choice" or field.value in field.choices
    assert set(listed["observers"]) == set(schema["observers"]) >= {"tensorboard", "previews"}
    contour = list(form(schema["components"]["geometry_renderer"]["contour"]))
    shown = [(f.label, f.widget, f.value) for f in contour]
    assert shown == [("lines_per_pixel", "number", 1), ("render_lines", "number", 4)]


def test_the_settings_of_a_run_have_a_form(schema: Any) -> None:
    fields = {field.label: field for field in form(schema["settings"])}
    assert fields["geometry.iterations"].widget == "number" and fields["geometry.iterations"].value == 400
    assert fields["geometry.parameterization"].choices == ("vertices", "large_steps")
    assert fields["reflectance.brdf"].widget == "choice"
    assert fields["deterministic"].widget == "tick"


def test_what_a_form_gives_back_is_taken(listed: Any, schema: Any) -> None:
    """Every form filled with its defaults builds the component's options; a wrong entry is refused by name."""
    plugins = PluginManager.discover()
    for row in listed["components"]:
        values = {f.label: f.value for f in form(schema["components"][row["kind"]][row["name"]])}
        assert plugins.find(row["kind"], row["name"]).component.config(**values) is not None
    with pytest.raises(ConfigError, match="render_lines"):
        plugins.create("geometry_renderer", "contour", {"render_lines": "many"})


def test_what_cannot_run_says_what_to_install(listed: Any) -> None:
    for row in listed["components"]:
        assert bool(row["missing"]) == bool(row["install"])
