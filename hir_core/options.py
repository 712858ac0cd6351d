"""Turns tables of settings into the frozen dataclasses of components; a typo is an error that names the key."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, TypeVar

from hir_core.errors import ConfigError

Options = TypeVar("Options")


def build_options(kind: type[Options], values: Mapping[str, Any], owner: str) -> Options:
    """Builds `kind` from `values`; unknown keys, wrong types and non-finite numbers raise `ConfigError`."""
    from pydantic import ValidationError

    try:
        checked = _validator(kind)(**values)  # type: ignore[arg-type] # classes are hashable
    except ValidationError as error:
        raise ConfigError(f"{owner}: {_sentence(error, kind)}") from None
    except TypeError as error:
        raise ConfigError(f"{owner}: {error}") from None
    # the checked object belongs to a subclass made by pydantic: components get the plain dataclass they declared
    return kind(**{name: getattr(checked, name) for name in getattr(kind, "__dataclass_fields__", {})})


def options_schema(kind: type) -> dict[str, Any]:
    """JSON schema of a configuration dataclass, with its attribute docstrings as descriptions."""
    from pydantic import ConfigDict, TypeAdapter, create_model

    schema = TypeAdapter(_validator(kind)).json_schema()
    # the checked class is a subclass without a body, so it has lost the docstrings of the first level
    holder = create_model("Holder", __config__=ConfigDict(use_attribute_docstrings=True), held=(kind, ...))
    described = holder.model_json_schema()["$defs"][kind.__name__]
    for name, field in described.get("properties", {}).items():
        if "description" in field:
            schema["properties"][name]["description"] = field["description"]
    return schema


@cache
def _validator(kind: type) -> Any:
    from pydantic import ConfigDict
    from pydantic.dataclasses import dataclass

    settings = ConfigDict(extra="forbid", allow_inf_nan=False, use_attribute_docstrings=True)
    return dataclass(kind, config=settings, frozen=True)


def _sentence(error: Any, kind: type) -> str:
    parts = []
    for problem in error.errors():
        key = ".".join(str(p) for p in problem["loc"])
        if problem["type"] == "unexpected_keyword_argument":
            known = ", ".join(getattr(kind, "__dataclass_fields__", {})) or "none"
            parts.append(f"unknown option {key!r}; the options are: {known}")
        else:
            parts.append(f"option {key!r}: {problem['msg'][0].lower()}{problem['msg'][1:]} (got {problem['input']!r})")
    return "; ".join(parts)
