"""The suites of `hir bench` by name, each loaded when it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Final

from hir_core.bench.plan import Plan
from hir_core.bench.results import Row

SUITES: Final = {
    "geometry": "hir_core.bench.geometry:geometry",
    "initializers": "hir_core.bench.initializers:initializers",
    "reflectance": "hir_core.bench.reflectance:reflectance",
    "regularizers": "hir_core.bench.regularizers:regularizers",
    "export": "hir_core.bench.export:export",
    "end-to-end": "hir_core.bench.end_to_end:end_to_end",
}

NEEDS_CAPTURES: Final = frozenset({"initializers", "end-to-end"})
"""Suites that measure nothing without a capture."""


def rows_of(suite: str, plan: Plan) -> Iterator[Row]:
    """The rows of a suite, each as soon as it is measured."""
    module, _, name = SUITES[suite].partition(":")
    run: Callable[[Plan], Iterator[Row]] = getattr(import_module(module), name)
    return run(plan)
