"""Checks what a plugin registers: the containers that its hooks return, and the fields of its descriptors.

Each fault is a sentence with its remedy, so that it is said once, when the plugin is loaded, and stops nothing else.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Final

from hir_core.plugins.component import Component

IMPORT_STRING: Final = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
TEXTS: Final = ("summary", "extra", "testing", "docs")
"""Fields of a descriptor that are text, and may be empty."""


class RegistrationError(Exception):
    """What a plugin registers cannot be used; the message says why, and what to write in its place."""


def components_of(hook: str, returned: object) -> list[object]:
    """What a hook that registers components returned, as a list; None registers nothing."""
    if returned is None:
        return []
    if isinstance(returned, str | bytes | Mapping) or not isinstance(returned, Iterable):
        raise RegistrationError(f"{hook} returned {a_value(returned)}; return a list of Components")
    return list(returned)


def table_of(hook: str, returned: object, entry: str) -> dict[str, object]:
    """What a hook that registers names returned, as a dictionary; None registers nothing."""
    if returned is None:
        return {}
    if not isinstance(returned, Mapping):
        raise RegistrationError(f"{hook} returned {a_value(returned)}; return a dict such as {{{entry}}}")
    unnamed = next((name for name in returned if not isinstance(name, str) or not name), None)
    if unnamed is not None:
        raise RegistrationError(f"{hook} returned a dict with the key {unnamed!r}; a name is text: {{{entry}}}")
    return dict(returned)


def preset_path(name: str, value: object) -> Path:
    """The file of settings of a preset."""
    if not isinstance(value, str | Path):
        raise RegistrationError(f'the preset {name!r} is {a_value(value)}; write Path(__file__).with_name("NAME.toml")')
    return Path(value)


def observer_options(name: str, value: object) -> type:
    """The dataclass of an observer's options."""
    if not inspect.isclass(value):
        raise RegistrationError(f"the options of the observer {name!r} are {a_value(value)}; write the class itself")
    return value


def check_descriptor(component: Component) -> None:
    """Raises `RegistrationError` for the first field of another type than `Component` declares."""
    name, target, config = component.name, component.target, component.config
    if not isinstance(name, str) or not name:
        raise RegistrationError(f'name={name!r} is not text; write name="NAME"')
    if inspect.isclass(target):
        written = f"{target.__module__}:{target.__qualname__}"
        raise RegistrationError(f"target is the class {target.__name__}; write its import path: target={written!r}")
    if not isinstance(target, str) or IMPORT_STRING.fullmatch(target) is None:
        example = _with_colon(target)
        raise RegistrationError(f"target={target!r} is no import path; target is 'module:Class'{example}")
    if not inspect.isclass(config):
        of = type(config).__name__
        advice = f"write config={of}" if hasattr(config, "__dataclass_fields__") else "write the class of its options"
        raise RegistrationError(f"config is {a_value(config)}, not a class; {advice}")
    for field in TEXTS:
        value = getattr(component, field)
        if not isinstance(value, str):
            raise RegistrationError(f'{field} is {a_value(value)}; write text: {field}="…"')
    requires, traits = component.requires, component.traits
    if not isinstance(requires, tuple | list) or not all(isinstance(module, str) for module in requires):
        words = _words(requires)
        example = f"({', '.join(words)}{',' if len(words) == 1 else ''})" if words else '("torch",)'
        raise RegistrationError(f"requires is {a_value(requires)}; write a tuple of modules: requires={example}")
    if not isinstance(traits, frozenset | set) or not all(isinstance(trait, str) for trait in traits):
        example = f"{{{', '.join(_words(traits))}}}" if _words(traits) else '{"differentiable"}'
        raise RegistrationError(f"traits is {a_value(traits)}; write a set: traits=frozenset({example})")


def _words(value: object) -> list[str]:
    """The texts in a value as they are written in code."""
    found = [value] if isinstance(value, str) else value if isinstance(value, Iterable) else []
    return [f'"{word}"' for word in found if isinstance(word, str)]


def _with_colon(target: object) -> str:
    """Where a dot stands for the colon of an import path, that path as it should be written."""
    module, dot, attribute = target.rpartition(".") if isinstance(target, str) else ("", "", "")
    return f": write {module}:{attribute}" if dot and ":" not in module + attribute else ""


def a_value(value: object) -> str:
    """`a list`, `None`, `an Options`: what a value is, in words."""
    if value is None:
        return "None"
    if inspect.isclass(value):
        return f"the class {value.__name__}"
    kind = type(value).__name__
    return f"{'an' if kind[0] in 'aeiouAEIOU' else 'a'} {kind}"
