"""How a component is named for its checks, and what becomes of failures that are expected."""

from __future__ import annotations

import pytest

from hir_core.errors import PluginError
from hir_core.plugins import Component
from hir_core.plugins.manager import PluginManager
from hir_core.testing import ContractError, check_component
from hir_core.testing.running import subject_of
from tests.hir_core.testing import broken_regularizers

PLUGINS = PluginManager.discover()
DESCRIPTION = "descriptor_is_complete"


def test_a_component_is_found_by_name_descriptor_or_as_registered() -> None:
    registered = PLUGINS.find("regularizer", "laplacian")
    for given in ("laplacian", "regularizer:laplacian", registered, registered.component):
        subject = subject_of(given, PLUGINS)
        assert subject.registered == registered and subject.kind == "regularizer"


def test_a_descriptor_that_nobody_registered_tells_its_kind_by_its_class() -> None:
    subject = subject_of(broken_regularizers.SOUND, PLUGINS)
    assert subject.kind == "regularizer" and subject.plugins.find("regularizer", subject.component.name)
    with pytest.raises(PluginError, match="has no known kind: it must be a subclass of one of"):
        subject_of(Component("odd", "pathlib:Path", summary="No component."), PLUGINS)
    with pytest.raises(PluginError, match="component 'gone' cannot be loaded from 'nowhere_at_all:Gone'"):
        subject_of(Component("gone", "nowhere_at_all:Gone", summary="Not there."), PLUGINS)


def test_an_expected_failure_that_passes_is_reported() -> None:
    [*_, result] = check_component(
        "laplacian", only=[DESCRIPTION], expected_failures={DESCRIPTION: "an old fault"}, plugins=PLUGINS, raises=False
    )
    assert (
        result.outcome == "unexpected_pass" and not result.is_ok and "remove it from expected_failures" in result.detail
    )
    with pytest.raises(ContractError, match="an old fault"):
        check_component(
            "laplacian", only=[DESCRIPTION], expected_failures={DESCRIPTION: "an old fault"}, plugins=PLUGINS
        )
