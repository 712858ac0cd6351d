"""What `hir plugins NAME` prints of a component, an observer, a preset, or a whole plugin."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from hir_core.errors import PluginError
from hir_core.plugins.loading import docs_page
from hir_core.plugins.manager import PluginManager, Registered
from hir_core.plugins.options import options_schema, range_and_unit
from hir_core.plugins.traits import TRAITS


def details(name: str, plugins: PluginManager, with_docs: bool = False) -> str:
    """All that is known by a name: components, observers, presets, commands, or those of a distribution or file."""
    found = [*_components(name, plugins, with_docs), *_others(name, plugins)]
    if not found:
        raise PluginError(f"nothing has the name {name!r}; `hir plugins` lists components, presets and observers")
    return "\n\n".join(found)


def _components(name: str, plugins: PluginManager, with_docs: bool) -> Iterator[str]:
    kind, _, plain = name.partition(":")
    for registered in plugins.components():
        if name in (registered.component.name, registered.distribution) or (
            (kind, plain) == (registered.kind, registered.component.name)
        ):
            yield _component(registered, with_docs)


def _component(registered: Registered, with_docs: bool) -> str:
    component = registered.component
    lines = [f"{registered.kind.replace('_', ' ')} {component.name}: {component.summary}"]
    lines.append(f"from {registered.distribution} {registered.version}".rstrip())
    if registered.missing:
        lines.append(f"needs {', '.join(registered.missing)}; install it with: {registered.install_command}")
    lines += [f"trait {trait}: {TRAITS[registered.kind].get(trait, '')}" for trait in sorted(component.traits)]
    lines += _options(component.config)
    if component.docs:
        page = docs_page(component.docs)
        lines.append(f"docs: {page}")
        if with_docs and isinstance(page, Path):
            lines += ["", page.read_text(encoding="utf-8").rstrip()]
    return "\n".join(lines)


def _others(name: str, plugins: PluginManager) -> Iterator[str]:
    plugins.commands()
    for loaded in plugins.loaded:
        whole = name == loaded.distribution
        for observer, options in loaded.observers.items():
            if whole or observer == name:
                said = " ".join((options.__doc__ or "").split())
                yield "\n".join([f"observer {observer}: {said}", f"from {loaded.distribution}", *_options(options)])
        for preset, path in loaded.presets.items():
            if whole or preset == name:
                yield f"preset {preset}: {path}\nfrom {loaded.distribution}"
        for command, implementation in loaded.commands.items():
            if whole or command == name:
                yield f"command {command}: {implementation.get_short_help_str(100)}\nfrom {loaded.distribution}"


def _options(kind: type) -> list[str]:
    """A line for each option: name, type or choices, default, range and unit; then what it means."""
    lines = []
    for name, entry in options_schema(kind).get("properties", {}).items():
        default = json.dumps(entry["default"], ensure_ascii=False) if "default" in entry else "none"
        facts = [_type(entry), f"default {default}"]
        facts += [range_and_unit(entry)] if range_and_unit(entry) else []
        lines.append(f"  {name}  ({', '.join(facts)})")
        if entry.get("description"):
            lines.append(f"      {' '.join(entry['description'].split())}")
    return ["options:", *lines] if lines else ["no options"]


def _type(entry: Mapping[str, Any]) -> str:
    if "enum" in entry:
        return " or ".join(json.dumps(value) for value in entry["enum"])
    if "anyOf" in entry:
        return " or ".join(_type(choice) for choice in entry["anyOf"])
    names = {"string": "text", "boolean": "true or false", "object": "table", "array": "list"}
    return names.get(str(entry.get("type", "")), str(entry.get("type", "any")))
