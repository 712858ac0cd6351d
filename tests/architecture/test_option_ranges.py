"""Every number among the settings and the options of built-in components has a range, so that a value without a meaning
is refused with a sentence that names it and not in the middle of a run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import pytest
from annotated_types import Interval
from hir_exporters.format_options import CheckedOptions

from hir_core.config import RunConfig, TermWeight
from hir_core.errors import ConfigError
from hir_core.plugins.manager import PluginManager
from hir_core.plugins.options import SEED_OF_RUN, build_options


def components() -> Iterator[tuple[str, type]]:
    """Name and options of each built-in component and observer, and the settings of a run."""
    manager = PluginManager.discover()
    for registered in manager.components():
        yield f"{registered.kind} {registered.component.name}", registered.component.config
    for name, observer in manager.observers().items():
        yield f"observer {name}", observer
    yield from (("settings", RunConfig), ("regularizer", TermWeight))


def is_number(hint: Any) -> bool:
    """Does the type allow a number without a range?"""
    if get_origin(hint) is Annotated:
        return is_number(get_args(hint)[0]) and not any(isinstance(one, Interval) for one in get_args(hint)[1:])
    return hint in (int, float) or (get_origin(hint) is not tuple and any(map(is_number, get_args(hint))))


def unlimited(kind: type) -> list[str]:
    """The numbers without a range, also those of the tables inside."""
    hints, found = get_type_hints(kind, include_extras=True), []
    for option in fields(kind) if is_dataclass(kind) else ():
        hint = hints[option.name]
        if isinstance(hint, type) and is_dataclass(hint):
            found += [f"{option.name}.{name}" for name in unlimited(hint)]
        limited = "range" in option.metadata if issubclass(kind, CheckedOptions) else SEED_OF_RUN in option.metadata
        if is_number(hint) and not limited:
            found.append(option.name)
    return found


def test_every_number_has_a_range() -> None:
    found = {name: names for name, kind in components() if (names := unlimited(kind))}
    assert not found, f"annotate them with Interval: {found}"


def values_below(kind: type) -> Iterator[tuple[str, float]]:
    """Options with a value just below their range."""
    for option in fields(kind) if is_dataclass(kind) else ():
        hint = get_type_hints(kind, include_extras=True)[option.name]
        if SEED_OF_RUN in option.metadata:
            yield option.name, -1
        for limits in getattr(hint, "__metadata__", ()):
            if isinstance(limits, Interval) and isinstance(limits.gt, int | float):
                yield option.name, limits.gt
            elif isinstance(limits, Interval) and isinstance(limits.ge, int | float):
                whole = get_args(hint)[0] is int
                yield option.name, limits.ge - 1 if whole else math.nextafter(limits.ge, -math.inf)


def test_a_value_below_its_range_is_named() -> None:
    named = set()
    for owner, kind in components():
        for name, value in values_below(kind):
            with pytest.raises(ConfigError, match=f"^{owner}: option '{name}' is .*; it must be "):
                build_options(kind, {name: value}, owner)
            named.add((owner, name))
    assert {("initializer visual_hull", "seed"), ("settings", "seed"), ("mask_source grabcut", "iterations")} <= named
