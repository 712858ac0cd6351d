"""The suites of `hir bench` by name; each is imported when it runs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from importlib import import_module
from typing import Final

from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.results.bench_result import Row

SUITES: Final = {
    "geometry": "hir_plugins.commands.bench.suites.geometry_suite:geometry_rows",
    "initializers": "hir_plugins.commands.bench.suites.initializers_suite:initializer_rows",
    "shape": "hir_plugins.commands.bench.suites.shape_suite:shape_rows",
    "atlas": "hir_plugins.commands.bench.suites.atlas_suite:atlas_rows",
    "shading": "hir_plugins.commands.bench.suites.shading_suite:shading_rows",
    "reflectance": "hir_plugins.commands.bench.suites.reflectance_fits:reflectance_rows",
    "regularizers": "hir_plugins.commands.bench.suites.regularizers_suite:regularizer_rows",
    "export": "hir_plugins.commands.bench.suites.export_suite:exporter_rows",
    "materials": "hir_plugins.commands.bench.suites.materials_suite:materials_rows",
    "end-to-end": "hir_plugins.commands.bench.suites.end_to_end_suite:end_to_end_rows",
}

SUITES_WITH_CAPTURES: Final = frozenset({"initializers", "shape", "reflectance", "end-to-end"})
"""Suites that measure nothing without a capture."""
MADE_CAPTURES: Final = "materials"
"""The suite that measures captures with known materials; it needs their folder."""


def suite_rows(suite: str, options: BenchOptions) -> Iterator[Row]:
    """The rows of a suite, each as soon as it is measured."""
    module, _, name = SUITES[suite].partition(":")
    run: Callable[[BenchOptions], Iterator[Row]] = getattr(import_module(module), name)
    return run(options)
