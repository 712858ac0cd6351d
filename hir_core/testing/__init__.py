"""Contract tests for plugins and their components, built-in and third-party alike.

`check_component(name)` and `check_whole_plugin(subject)` run them without pytest,
`@parametrize_with_checks([name, …])` with it, and so does `hir check-plugin`. Importing this package loads nothing
heavy; it is no pytest plugin.
"""

from __future__ import annotations

from hir_core.testing.contract import Check, ContractError, PluginSubject, Subject
from hir_core.testing.parametrize import parametrize_with_checks
from hir_core.testing.running import Result, all_checks, check_component, check_whole_plugin, checks_for, whole_plugin

__all__ = [
    "Check",
    "ContractError",
    "PluginSubject",
    "Result",
    "Subject",
    "all_checks",
    "check_component",
    "check_whole_plugin",
    "checks_for",
    "parametrize_with_checks",
    "whole_plugin",
]
