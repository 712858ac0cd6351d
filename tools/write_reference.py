"""Writes the reference pages from the code: hooks, settings and options, contracts. A test compares."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from hir_core.config import RunConfig
from hir_core.plugins import hookspecs
from hir_core.plugins.manager import KINDS, PluginManager
from hir_core.plugins.options import options_schema, range_and_unit
from hir_core.plugins.traits import TRAITS
from hir_core.testing import all_checks
from hir_core.testing.contract import PLUGIN

DOCS = Path(__file__).resolve().parent.parent / "docs"
WRITTEN = "Written by `python tools/write_reference.py` from the code itself."
KIND_NAMES = {kind: kind.replace("_", " ") for kind in KINDS}


def hooks_page() -> str:
    """Every hook with its signature and docstring."""
    parts = [f"# Hooks\n\n{WRITTEN}\n"]
    parts.append(
        "Decorate an implementation with `@hookimpl` of `hir_core.plugins`. It receives the arguments that it names.\n"
        "Hooks run at start-up and at stage boundaries; `hir_progress` at most four times a second.\n"
    )
    for name, function in vars(hookspecs).items():
        if not name.startswith("hir_"):
            continue
        first = " The first result that is not None is used." if function.hir_spec["firstresult"] else ""
        signature = str(inspect.signature(function)).replace("'", "")
        parts.append(f"## {name}\n```text\n{name}{signature}\n```\n{inspect.cleandoc(function.__doc__ or '')}{first}\n")
    return "\n".join(parts)


def options_page(plugins: PluginManager) -> str:
    """Settings of a run, then the options of every built-in component and observer."""
    parts = [f"# Settings and options\n\n{WRITTEN} `hir config schema` prints the same as JSON, with your plugins.\n"]
    parts.append("## Settings of a run\n")
    schema = options_schema(RunConfig)
    parts.append(_table(schema, skip=("depth_maps", "geometry", "atlas", "reflectance")))
    for stage in ("depth_maps", "geometry", "atlas", "reflectance"):
        reference = schema["properties"][stage]
        parts += _settings_tables(stage, _resolved(reference, schema))
    for kind, name in KIND_NAMES.items():
        parts.append(f"## {name.capitalize()}s\n\n{_traits(kind)}")
        for registered in plugins.components(kind):
            if registered.distribution == "hir":
                component = registered.component
                traits = ", ".join(f"`{trait}`" for trait in sorted(component.traits))
                promises = f" Traits: {traits}." if traits else ""
                parts.append(f"### {component.name} ({name})\n\n{component.summary}{promises}\n")
                parts.append(_table(options_schema(component.config)))
    parts.append("## Observers\n")
    for observer, options in plugins.observers().items():
        said = inspect.cleandoc(options.__doc__ or "")
        parts.append(f"### {observer} (observer)\n\n{said}\n\n{_table(options_schema(options))}")
    return "\n".join(part.rstrip("\n") + "\n" for part in parts)


def contracts_page() -> str:
    """Every contract with its text."""
    parts = [f"# Contracts\n\n{WRITTEN}\n"]
    parts.append(
        "`hir check-plugin NAME` and `@parametrize_with_checks` run these tests, selected by kind and traits.\n"
        "A failure names the contract, the observed result, and the section below.\n"
    )
    for title, kinds in _groups().items():
        parts.append(f"## {title}\n")
        for check in all_checks().values():
            if check.kinds == kinds:
                conditions = [f"only with `{trait}`" for trait in sorted(check.traits)]
                conditions += [f"not with `{trait}`" for trait in sorted(check.unless)]
                for_whom = f" *({'; '.join(conditions)})*" if conditions else ""
                parts.append(f"### {check.name}\n\n{' '.join(check.contract.split())}{for_whom}\n")
    return "\n".join(parts)


def _groups() -> dict[str, frozenset[str]]:
    """Titles of the sets of kinds that contracts apply to; the plugin as a whole first, then every kind."""
    sets = {check.kinds for check in all_checks().values()} - {frozenset({PLUGIN})}
    ordered = sorted(sets, key=lambda kinds: (-len(kinds), sorted(kinds, key=list(KINDS).index)))
    titles = {"The plugin as a whole": frozenset({PLUGIN})}
    for kinds in ordered:
        named = ", ".join(KIND_NAMES[k] for k in KINDS if k in kinds).capitalize()
        titles["Every kind" if len(kinds) == len(KINDS) else named] = kinds
    return titles


def _traits(kind: str) -> str:
    if not TRAITS[kind]:
        return "No traits.\n"
    rows = "".join(f"| `{trait}` | {meaning} |\n" for trait, meaning in TRAITS[kind].items())
    return f"| trait | property |\n|---|---|\n{rows}"


def _settings_tables(name: str, schema: Mapping[str, Any]) -> list[str]:
    """The table of a settings class, then those of the settings classes inside it."""
    inner = {key: _resolved(field, schema) for key, field in schema.get("properties", {}).items()}
    inner = {key: field for key, field in inner.items() if "properties" in field}
    text = f"{schema['description']}\n\n" if schema.get("description") else ""
    parts = [f"### {name}\n\n{text}{_table(schema, skip=tuple(inner))}"]
    for key, field in inner.items():
        parts += _settings_tables(f"{name}.{key}", field)
    return parts


def _table(schema: Mapping[str, Any], skip: tuple[str, ...] = ()) -> str:
    rows = []
    for name, field in schema.get("properties", {}).items():
        if name not in skip:
            kind = _type(_resolved(field, schema), schema)
            kind += f", {range_and_unit(field)}" if range_and_unit(field) else ""
            rows.append(f"| `{name}` | {kind} | {_default(field)} | {_cell(field.get('description', ''))} |")
    if not rows:
        return "No options.\n"
    return "\n".join(["| option | type | default | |", "|---|---|---|---|", *rows]) + "\n"


def _type(field: Mapping[str, Any], schema: Mapping[str, Any]) -> str:
    if "const" in field:
        return f"`{json.dumps(field['const'])}`"
    if "enum" in field:
        return ", ".join(f"`{value}`" for value in field["enum"])
    if "anyOf" in field:
        return " or ".join(_type(_resolved(choice, schema), schema) for choice in field["anyOf"])
    if field.get("type") == "array":
        return f"list of {_type(_resolved(field.get('items', {}), schema), schema)}" if field.get("items") else "list"
    kind = field.get("type", "any")
    return {"string": "text", "boolean": "true, false", "object": "table"}.get(kind, kind)


def _resolved(field: Mapping[str, Any], schema: Mapping[str, Any]) -> Mapping[str, Any]:
    reference = field.get("$ref", "")
    if not reference:
        return field
    return {**schema["$defs"][reference.rpartition("/")[2]], "$defs": schema["$defs"]}


def _default(field: Mapping[str, Any]) -> str:
    return f"`{json.dumps(field['default'], ensure_ascii=False)}`" if "default" in field else ""


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")


def pages() -> dict[str, str]:
    """Each generated page by its path below docs/."""
    return {
        "reference/hooks.md": hooks_page(),
        "reference/options.md": options_page(PluginManager.discover()),
        "writing_plugins/contracts.md": contracts_page(),
    }


if __name__ == "__main__":
    for path, text in pages().items():
        (DOCS / path).write_text(text, encoding="utf-8")
