"""The contracts of hir, one test for each component and contract."""

from __future__ import annotations

from hir_core.testing import parametrize_with_checks


@parametrize_with_checks(["hir-plugin-example"])
def test_contract(component, check) -> None:
    check(component)
