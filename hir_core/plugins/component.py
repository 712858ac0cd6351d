"""The hook marker and the component descriptor: all that a light `plugin.py` needs."""

from __future__ import annotations

from dataclasses import dataclass, field

import pluggy

API_VERSION = 1
"""Version of the plugin interface; a component for another version is not loaded, with a message."""

hookimpl = pluggy.HookimplMarker("hir")
"""Marks a function as the implementation of a hook of `hir_core.plugins.hookspecs`."""


@dataclass(frozen=True)
class NoOptions:
    """The options of a component without options."""


@dataclass(frozen=True)
class Component:
    """What a plugin registers: a name, and the import path of its implementation."""

    name: str
    target: str
    """`package.module:Class`, imported on first use; the class is built as `Class(config)`."""
    config: type = NoOptions
    """A frozen dataclass: its fields are the component's options, their docstrings its documentation."""
    summary: str = ""
    requires: tuple[str, ...] = ()
    """Modules that the implementation imports beyond the base install."""
    extra: str = ""
    """The extra of the distribution that installs `requires`."""
    traits: frozenset[str] = field(default_factory=frozenset)
    """Properties that the core relies on and the contract tests check: keys of `hir_core.plugins.traits.TRAITS`."""
    api: int = 1
    """The version of the plugin interface that it was written for (docs/plugin_api.md). It is the first where none is
    given, so that an old plugin is never taken for a new one."""
    testing: str = ""
    """`package.module:function` with further input for the contract tests, such as a scene where a regularizer has its
    minimum, or a capture in a reader's format (docs/writing_plugins lists the input of each kind)."""
    docs: str = ""
    """Its page: an address, or `package:page.md`, a Markdown file in the folder of a package or module. `hir plugins
    NAME` names it, and prints it with `--docs`."""
