"""All that a light `plugin.py` may import: the hook marker and the descriptor of a component."""

from __future__ import annotations

from dataclasses import dataclass, field

import pluggy

API_VERSION = 1
"""Version of the plugin interface; a component made for another one is refused with a sentence."""

hookimpl = pluggy.HookimplMarker("hir")
"""Marks a function as the implementation of a hook of `hir_core.plugins.hookspecs`."""


@dataclass(frozen=True)
class NoOptions:
    """The configuration of a component that has none."""


@dataclass(frozen=True)
class Component:
    """What a plugin registers: a name, and where its implementation is found once it is needed."""

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
    """Promises that the core relies on and the contract tests check: words of `hir_core.plugins.traits.TRAITS`."""
    api: int = API_VERSION
    """The version of the plugin interface that it was written for (docs/plugin_api.md)."""
    testing: str = ""
    """`package.module:function`: what its contract tests need to know beyond its options, such as a scene that a
    regularizer likes best or a capture in a reader's format (docs/writing_plugins says what each kind asks for)."""
