"""The suites of `hir bench` by name, each loaded when it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Final

from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.results.bench_result import Row

SUITES: Final = {
    "geometry": "hir_plugins.commands.bench.suites.geometry_suite:geometry",
    "initializers": "hir_plugins.commands.bench.suites.initializers_suite:initializers",
    "reflectance": "hir_plugins.commands.bench.suites.reflectance_suite:reflectance",
    "regularizers": "hir_plugins.commands.bench.suites.regularizers_suite:regularizers",
    "export": "hir_plugins.commands.bench.suites.export_suite:export",
    "end-to-end": "hir_plugins.commands.bench.suites.end_to_end_suite:end_to_end",
}

NEEDS_CAPTURES: Final = frozenset({"initializers", "end-to-end"})
"""Suites that measure nothing without a capture."""


def rows_of(suite: str, plan: Plan) -> Iterator[Row]:
    """The rows of a suite, each as soon as it is measured."""
    module, _, name = SUITES[suite].partition(":")
    run: Callable[[Plan], Iterator[Row]] = getattr(import_module(module), name)
    return run(plan)
