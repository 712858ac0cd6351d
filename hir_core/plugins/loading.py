"""Finds entry points and imports what plugins name: modules, files, classes."""

from __future__ import annotations

import importlib.util
import inspect
import re
import sys
from importlib import import_module
from importlib.metadata import Distribution, EntryPoint, distributions
from pathlib import Path
from typing import Any

from hir_core.errors import PluginError

GROUP = "hir"
"""The group of entry points."""


def entry_points() -> list[tuple[str, str, EntryPoint]]:
    """Entry points of the group with name and version of their distribution, in the order of loading."""
    # not pluggy's loader, which silently skips a second entry point of the same name
    found: dict[tuple[str, str], tuple[str, str, EntryPoint]] = {}
    for distribution in distributions():
        selected = distribution.entry_points.select(group=GROUP)
        if not selected:
            continue
        name, version = _name_and_version(distribution)
        for entry_point in selected:
            found.setdefault((name, entry_point.name), (name, version, entry_point))
    # ours first, so that a conflict is reported for the other plugin; then by name, independent of the file system
    return [found[key] for key in sorted(found, key=lambda k: (k[0] != "hir", k))]


def _name_and_version(distribution: Distribution) -> tuple[str, str]:
    """From the head of the metadata; Python's own parser of them takes a millisecond for each distribution."""
    head = (distribution.read_text("METADATA") or distribution.read_text("PKG-INFO") or "").partition("\n\n")[0]
    name, version = (re.search(rf"^{field}:[ \t]*(\S+)", head, re.M) for field in ("Name", "Version"))
    if name is None or version is None:
        return distribution.name, distribution.version
    return name[1], version[1]


def module_from_file(path: Path) -> Any:
    """The module in a `.py` file; it can then be imported as `hir_plugin_<stem>`."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    name = f"hir_plugin_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def class_of(target: str, owner: str) -> Any:
    """The class that `package.module:Class` names; `PluginError` says whose target it is."""
    module, _, attribute = target.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise PluginError(f"{owner} cannot be loaded from {target!r}: {error}") from error
    if not inspect.isclass(found):
        raise PluginError(f"{owner} cannot be used: {target!r} is not a class")
    return found


def docs_page(docs: str) -> Path | str:
    """The file, or the address, that `Component.docs` names; a file need not exist."""
    if docs.startswith(("https://", "http://")):
        return docs
    module, _, page = docs.partition(":")
    loaded = sys.modules.get(module)
    try:
        spec = getattr(loaded, "__spec__", None) or importlib.util.find_spec(module)
    except (ImportError, ValueError):
        spec = None
    if spec is None or not spec.origin or not page:
        raise PluginError(f"docs={docs!r} names no page; write an address, or package:page.md")
    return Path(spec.origin).parent / page


def is_installed(module: str) -> bool:
    """Whether a module can be imported; it is not."""
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
