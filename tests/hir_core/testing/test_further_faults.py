"""Contracts that find several faults: each fault has its own sentence."""

from __future__ import annotations

import pytest

from hir_core.plugins import Component
from hir_core.plugins.manager import PluginManager
from hir_core.testing import check_component
from hir_core.testing.running import as_registered
from tests.hir_core.testing import broken_inputs, broken_readers, broken_regularizers


def reader(implementation: type) -> Component:
    return broken_inputs.reader(implementation, module=broken_readers.HERE)


OWN_FORMAT, PIXELS, CAMERAS = "knows_its_own_format", "pixels_are_linear", "cameras_are_where_they_were"
READERS = [
    (reader(broken_readers.NoSaturation), PIXELS, "`saturated` of view 00 is None; it must be an array of bool"),
    (reader(broken_readers.SaturationOfChannels), PIXELS, "`saturated` of view 00 is bool (48, 48, 3); it must be"),
    (reader(broken_readers.AllSaturated), PIXELS, "true for 100 % of a photograph whose brightest value is 0.8"),
    (reader(broken_readers.DoublePrecision), PIXELS, "the colours of view 00: float64, not float32"),
    (reader(broken_readers.OtherSize), PIXELS, "is for 96 × 48 pixels, its picture has 48 × 48"),
    (reader(broken_readers.ListOfViews), OWN_FORMAT, "the capture's views are a list, which could change later"),
    (reader(broken_readers.ReadsNothing), CAMERAS, "read() returns None; return a Capture"),
    (reader(broken_readers.SameSplits), OWN_FORMAT, "the split 'test' has 6 of the photographs of 'train'"),
    (reader(broken_readers.MatchesPictures), OWN_FORMAT, "matches() says yes to a folder of photographs;"),
    (reader(broken_readers.MatchesJson), OWN_FORMAT, "matches() says yes to a capture of the format open_mvg"),
]
FINITE, IDEAL = "term_is_a_finite_scalar", "smallest_on_its_ideal"
made = broken_regularizers.made
REGULARIZERS = [
    (made(broken_regularizers.RootOfZero), IDEAL, "values of the gradient by positions are not finite"),
    (made(testing=f"{broken_regularizers.HERE}:no_scene"), IDEAL, "testing returns None; return the scene"),
    (made(broken_regularizers.PreparesNothing), FINITE, "prepare returns None; return a function of the scene"),
    (made(broken_regularizers.WithoutArgument), FINITE, "cannot be called with the scene alone: too many positional"),
]
CASES = [("capture_reader", *case) for case in READERS] + [("regularizer", *case) for case in REGULARIZERS]


@pytest.fixture(scope="module")
def plugins() -> PluginManager:
    return PluginManager.discover()


@pytest.mark.parametrize(
    ("kind", "component", "check", "said"),
    CASES,
    ids=[f"{case[2]}-{case[1].target.rpartition(':')[2]}-{case[1].testing.rpartition(':')[2]}" for case in CASES],
)
def test_the_fault_is_named(kind: str, component: Component, check: str, said: str, plugins: PluginManager) -> None:
    results = check_component(as_registered(kind, component), plugins=plugins, only=[check], raises=False)
    (detail,) = [result.detail for result in results if result.outcome == "failed"]
    assert f"breaks the contract {check!r}" in detail and said in detail
