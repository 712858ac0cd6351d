"""Turns tables of settings into the frozen dataclasses of components; a typo is an error that names the key.

An option has a range and a unit where its type says so, by the metadata of `annotated_types`, which pydantic and others
share: `Annotated[float, Interval(ge=0, le=1), Unit("m")]`. The schema, `hir plugins NAME` and errors show both.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import field, is_dataclass
from difflib import get_close_matches
from functools import cache
from typing import Any, Literal, TypeVar, get_type_hints

from hir_exporters.format_options import RANGE

from hir_core.errors import ConfigError

Options = TypeVar("Options")


Default = TypeVar("Default")
SEED_OF_RUN, DEVICE_OF_RUN = "seed_of_run", "device_of_run"
"""Keys of a field's metadata."""
MAX_SEED = (1 << 31) - 1
"""Of a run and of a component; the smallest is 0."""
Condition = Literal["solver", "fitted light"]
"""What an option of a reflectance renderer needs to take effect: the fit by its solver, or a light that is fitted."""


def takes_effect_with(default: Default, *conditions: Condition) -> Default:
    """A dataclass field with a default, for an option that has no effect unless all `conditions` are met.

    A run in which a user sets such an option without effect ends with an error that names the condition.
    """
    return field(default=default, metadata={"takes_effect_with": conditions})


def seed_of_run() -> int:
    """A dataclass field `seed: int` of options: the run's seed (`--seed`), where the user gives the component no other.

    Outside of a run it is 0; a negative one is refused. A component that draws from generators of its own declares it,
    and seeds them from it; the generators of `random`, numpy and torch are seeded before each stage.
    """
    return field(default=0, metadata={SEED_OF_RUN: True})


def device_of_run() -> Literal["auto"]:
    """A dataclass field `device: Literal["auto", "cpu", "cuda"]` of an initializer's options: the run's device
    (`--device`), where the user gives the component no other. Outside of a run it is `auto`.
    """
    return field(default="auto", metadata={DEVICE_OF_RUN: True})


def with_seed_of_run(kind: type, values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
    """`values`, with the run's seed for each field of `seed_of_run` that they do not set."""
    return {**dict.fromkeys(_fields_with(kind, SEED_OF_RUN), seed), **values} if seed else values


def with_device_of_run(kind: type, values: Mapping[str, Any], device: str) -> Mapping[str, Any]:
    """`values`, with the run's device for each field of `device_of_run` that they do not set."""
    return {**dict.fromkeys(_fields_with(kind, DEVICE_OF_RUN), device), **values} if device else values


def _fields_with(kind: type, key: str) -> list[str]:
    declared = getattr(kind, "__dataclass_fields__", {})
    return [name for name, option in declared.items() if key in option.metadata]


def build_options(kind: type[Options], values: Mapping[str, Any], owner: str, beside: tuple[str, ...] = ()) -> Options:
    """Builds `kind` from `values`; unknown keys, wrong types and non-finite numbers raise `ConfigError`.

    `beside` names what else the table of these options may hold: errors list it, too.
    """
    if not values:
        with suppress(TypeError, ValueError):  # pydantic says below which option has no default
            return kind()
    from pydantic import ValidationError

    if (truth := _truth_for_number(kind, values)) is not None:  # pydantic takes True for 1
        raise ConfigError(f"{owner}: {_type_sentence(kind, *truth, _NEEDED['float_type'])}")
    try:
        checked = _validator(kind)(**values)  # type: ignore[arg-type] # classes are hashable
    except ValidationError as error:
        raise ConfigError(f"{owner}: {_sentence(error, kind, beside)}") from None
    except TypeError as error:
        raise ConfigError(f"{owner}: {error}") from None
    for name in _fields_with(kind, SEED_OF_RUN):
        if not 0 <= getattr(checked, name) <= MAX_SEED:
            raise ConfigError(f"{owner}: option {name!r} is {getattr(checked, name)}; it must be 0 … {MAX_SEED}")
    # the checked object belongs to a subclass made by pydantic: components get the plain dataclass they declared
    return kind(**{name: getattr(checked, name) for name in getattr(kind, "__dataclass_fields__", {})})


def options_schema(kind: type) -> dict[str, Any]:
    """JSON schema of a configuration dataclass, with its attribute docstrings as descriptions."""
    from pydantic import ConfigDict, TypeAdapter

    schema = TypeAdapter(_validator(kind)).json_schema()
    # the checked class is a subclass without a body, so it has lost the docstrings of the first level; options that a
    # class inherits, or gives another default, are described where they were first written
    for written in reversed(kind.__mro__[:-1]):
        several = TypeAdapter(list[written], config=ConfigDict(use_attribute_docstrings=True))  # type: ignore[valid-type]
        described = several.json_schema()["$defs"][written.__name__]
        for name, described_option in described.get("properties", {}).items():
            if "description" in described_option:
                schema["properties"][name]["description"] = described_option["description"]
    for name in _fields_with(kind, SEED_OF_RUN):
        schema["properties"][name] |= {"minimum": 0, "maximum": MAX_SEED}
    for name in _fields_with(kind, RANGE):
        entry = schema["properties"][name]
        low, high = kind.__dataclass_fields__[name].metadata[RANGE]  # type: ignore[attr-defined] # a dataclass
        entry.get("items", entry).update(minimum=low, maximum=high)
    _add_units(kind, schema, schema)
    return schema


def range_and_unit(entry: Mapping[str, Any]) -> str:
    """The range and unit of an option's schema as text, such as `0 … 1 m`, `> 0`, `m`; "" where it has neither."""
    low, high = entry.get("minimum"), entry.get("maximum")
    above, below = entry.get("exclusiveMinimum"), entry.get("exclusiveMaximum")
    if low is not None and high is not None:
        limits = f"{low:.10g} … {high:.10g}"
    else:
        bounds = [("≥", low), (">", above), ("≤", high), ("<", below)]
        limits = " and ".join(f"{sign} {value:.10g}" for sign, value in bounds if value is not None)
    return f"{limits} {entry.get('unit', '')}".strip()


def _add_units(kind: type, entry: dict[str, Any], schema: Mapping[str, Any]) -> None:
    """Adds the units of the fields of `kind`, and of the dataclasses inside of it, to their schemas."""
    from annotated_types import Unit

    for name, hint in get_type_hints(kind, include_extras=True).items():
        if name not in entry.get("properties", {}):
            continue
        for metadata in getattr(hint, "__metadata__", ()):
            if isinstance(metadata, Unit):
                entry["properties"][name]["unit"] = metadata.unit
        if isinstance(hint, type) and is_dataclass(hint):
            _add_units(hint, schema.get("$defs", {}).get(hint.__name__, {}), schema)


@cache
def _validator(kind: type) -> Any:
    from pydantic import ConfigDict
    from pydantic.dataclasses import dataclass

    settings = ConfigDict(extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
    return dataclass(kind, config=settings, frozen=True)


def _fields_at(kind: type, place: tuple[Any, ...]) -> list[str]:
    """Option names of the table at `place` inside a configuration."""
    for name in place:
        inner = get_type_hints(kind).get(str(name))
        kind = inner if isinstance(inner, type) else type(None)
    return list(getattr(kind, "__dataclass_fields__", {}))


RANGE_ERRORS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal")
"""Types of pydantic's errors for a number outside of its range."""


LIST_ERRORS = ("tuple_type", "list_type")
"""Types of pydantic's errors for a value that is no list."""


def _list_needed(entry: Mapping[str, Any], given: Any) -> str:
    """What an option that is a list may be, with an example; of text, the example holds the names that were given."""
    items = entry.get("prefixItems") or [entry.get("items", {})]
    kinds = {item.get("type") for item in items}
    length = f"{len(items)} " if "prefixItems" in entry else ""
    if kinds == {"string"}:
        names = [name.strip(" []'\"") for name in given.split(",")] if isinstance(given, str) else []
        return f"a list of {length}text such as {json.dumps([name for name in names if name] or ['name'])}"
    if kinds <= {"number", "integer"}:
        return f"a list of {length}numbers such as {list(range(1, len(items) + 1)) if length else [1, 2]}"
    return "a list"


def _entry_at(kind: type, place: tuple[Any, ...]) -> Mapping[str, Any]:
    """The schema of the option at `place` inside a configuration; empty where there is none."""
    schema = options_schema(kind)
    entry: Mapping[str, Any] = schema
    for name in place:
        entry = entry.get("properties", {}).get(str(name), {})
        if "$ref" in entry:
            entry = schema["$defs"][entry["$ref"].rpartition("/")[2]]
    return entry


_NEEDED = {
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float"), "a whole number"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    "finite_number": "a finite number",
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    "string_type": "text",
}
"""What an option must be, by the type of pydantic's error for a value of another type."""


def _type_sentence(kind: type, place: tuple[Any, ...], given: Any, needed: str) -> str:
    """One sentence for a value of a wrong type at `place` inside a configuration."""
    allowed = range_and_unit(_entry_at(kind, place))
    return f"option {'.'.join(map(str, place))!r} is {given!r}; it must be {needed}{f' ({allowed})' if allowed else ''}"


def _truth_for_number(
    kind: type, values: Mapping[str, Any], place: tuple[Any, ...] = ()
) -> tuple[tuple[Any, ...], bool] | None:
    """The first True or False for an option that is a number, with its place; None where there is none."""
    hints = get_type_hints(kind) if is_dataclass(kind) else {}
    for name, value in values.items():
        hint, inside = hints.get(name), (*place, name)
        if isinstance(value, bool) and hint in (int, float):
            return inside, value
        if isinstance(value, Mapping) and isinstance(hint, type):
            found = _truth_for_number(hint, value, inside)
            if found is not None:
                return found
    return None


def _sentence(error: Any, kind: type, beside: tuple[str, ...] = ()) -> str:
    parts = []
    unions: dict[str, list[str]] = {}
    for problem in error.errors():
        if alternative := _alternative(problem["loc"], kind):
            unions.setdefault(alternative[0], []).append(alternative[1])
            continue
        key = ".".join(str(p) for p in problem["loc"])
        if (
            not key and problem["type"] == "value_error"
        ):  # raised by the class itself about several or all of its options
            parts.append(str(problem["ctx"]["error"]))
            continue
        if problem["type"] == "unexpected_keyword_argument":
            inside = problem["loc"][:-1]
            known = [*(() if inside else beside), *_fields_at(kind, inside)]
            near = get_close_matches(str(problem["loc"][-1]), known, 1)
            advice = f"did you mean {near[0]!r}? " if near else ""
            parts.append(f"unknown option {key!r}; {advice}the options are: {', '.join(known) or 'none'}")
            continue
        if problem["type"] in LIST_ERRORS:
            list_needed = _list_needed(_entry_at(kind, problem["loc"]), problem["input"])
            parts.append(f"option {key!r} must be {list_needed} (got {problem['input']!r})")
            continue
        allowed = range_and_unit(_entry_at(kind, problem["loc"]))
        if problem["type"] in RANGE_ERRORS and allowed:
            parts.append(f"option {key!r} is {problem['input']!r}; it must be {allowed}")
        elif problem["type"] == "literal_error":
            parts.append(f"option {key!r} is {problem['input']!r}; it must be {problem['ctx']['expected']}")
        elif problem["type"] in _NEEDED:
            parts.append(_type_sentence(kind, problem["loc"], problem["input"], _NEEDED[problem["type"]]))
        else:
            needed = f"; it is a number {allowed}" if allowed else ""
            said = f"{problem['msg'][0].lower()}{problem['msg'][1:]}"
            parts.append(f"option {key!r}: {said} (got {problem['input']!r}){needed}")
    parts += [f"option {key!r} must be {' or '.join(dict.fromkeys(kinds))}" for key, kinds in unions.items()]
    return "; ".join(parts)


def _alternative(place: tuple[Any, ...], config: type) -> tuple[str, str] | None:
    """The option and one of the kinds of value it may have, where an error is about one alternative of several.

    Pydantic names the alternative in the place of the error: `("masks", "literal['auto']")`.
    """
    kinds = ("literal[", "tuple[", "list[", "constrained-float")
    index = next((i for i, name in enumerate(place) if isinstance(name, str) and name.startswith(kinds)), None)
    if index is None:
        return None
    kind, _, values = place[index].partition("[")
    if kind == "constrained-float":
        numbers = [one for one in _entry_at(config, place[:index]).get("anyOf", ()) if one.get("type") == "number"]
        allowed = f"a number {range_and_unit(numbers[0]) if numbers else ''}".rstrip()
    else:
        allowed = values.rstrip("]") if kind == "literal" else 'a list such as ["name"]'
    return ".".join(str(name) for name in place[:index]), allowed
