"""Contract tests for components, built-in and third-party alike.

`check_component(name)` runs them without pytest, `@parametrize_with_checks([name, …])` with it, and so does
`hir check-plugin`. Importing this package loads nothing heavy; it is no pytest plugin.
"""

from __future__ import annotations

from hir_core.testing.contract import Check, ContractError, Subject
from hir_core.testing.parametrize import parametrize_with_checks
from hir_core.testing.running import Result, all_checks, check_component, checks_for

__all__ = [
    "Check",
    "ContractError",
    "Result",
    "Subject",
    "all_checks",
    "check_component",
    "checks_for",
    "parametrize_with_checks",
]
