"""Contracts of every component: its descriptor, its class, its options, what importing it costs."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
import tomllib
from dataclasses import asdict, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Final

from hir_core.errors import PluginError
from hir_core.plugins.options import build_options, options_schema
from hir_core.plugins.traits import TRAITS
from hir_core.testing.contract import INTERFACES, NotApplicable, Subject, contract, require

HEAVY: Final = ("torch", "mitsuba", "drjit", "open3d", "pycolmap", "xatlas", "cv2", "skimage", "matplotlib", "pxr")
"""Packages that take a good part of a second to import."""


@contract(first=True)
def implements_its_interface(subject: Subject) -> None:
    """`target` names a class that is a subclass of its kind's base class and implements all of its methods."""
    base = INTERFACES[subject.kind]
    found = subject.implementation
    require(inspect.isclass(found), f"{subject.component.target!r} is {found!r}, not a class")
    require(issubclass(found, base), f"{found.__name__} is not a subclass of {base.__module__}.{base.__name__}")
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    require(not missing, f"{found.__name__} does not implement {', '.join(missing)}")


@contract(first=True)
def default_options_construct(subject: Subject) -> None:
    """The options are a frozen dataclass with a default for each, and the class is built from it: `Class(config)`."""
    config: Any = subject.component.config
    require(is_dataclass(config), f"config={config!r} is not a dataclass")
    require(config.__dataclass_params__.frozen, f"{config.__name__} is not frozen: @dataclass(frozen=True)")
    without = [f.name for f in fields(config) if f.default is f.default_factory]
    require(not without, f"the option {', '.join(without)} has no default")
    try:
        subject.create()
    except TypeError as error:
        raise PluginError(f"{subject.implementation.__name__}({config.__name__}()) raised TypeError: {error}") from None


@contract()
def signatures_match(subject: Subject) -> None:
    """Methods have the parameters of the base class, by name; none takes `*args` or `**kwargs`, `__init__` neither."""
    base, found = INTERFACES[subject.kind], subject.implementation
    own = [p for p in inspect.signature(found.__init__).parameters.values() if p.name != "self"]
    _no_loose(found, "__init__", own)
    needed = [p.name for p in own if p.default is p.empty]
    require(
        len(needed) <= 1, f"{found.__name__}.__init__ takes {', '.join(needed)}; it is called with the config alone"
    )
    for name, method in inspect.getmembers(base, inspect.isfunction):
        if name.startswith("_"):
            continue
        wanted = [p.name for p in inspect.signature(method).parameters.values()]
        have = list(inspect.signature(getattr(found, name)).parameters.values())
        _no_loose(found, name, have)
        names = [p.name for p in have]
        require(
            names[: len(wanted)] == wanted,
            f"{found.__name__}.{name} has the parameters {', '.join(names)}; the base class has {', '.join(wanted)}",
        )
        extra = [p.name for p in have[len(wanted) :] if p.default is p.empty]
        require(not extra, f"{found.__name__}.{name} needs {', '.join(extra)}, which the core does not pass")


def _no_loose(found: type, name: str, parameters: list[inspect.Parameter]) -> None:
    loose = [p for p in parameters if p.kind in (p.VAR_KEYWORD, p.VAR_POSITIONAL)]
    stars = ", ".join(("**" if p.kind is p.VAR_KEYWORD else "*") + p.name for p in loose)
    require(not loose, f"{found.__name__}.{name} takes {stars}: a misspelt argument would go unnoticed")


@contract()
def options_round_trip(subject: Subject) -> None:
    """The default options are the same after they were written as JSON and as TOML and read again."""
    import tomli_w

    config: Any = subject.component.config
    default = config()
    plain = asdict(default)
    try:
        written = json.dumps(plain, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise PluginError(f"the defaults {plain} cannot be written as JSON: {error}") from None
    try:
        toml = tomli_w.dumps({name: _lists(value) for name, value in plain.items()})
    except TypeError as error:
        raise PluginError(f"the defaults {plain} cannot be written as TOML: {error}; TOML has no None") from None
    for form, table in (("JSON", json.loads(written)), ("TOML", tomllib.loads(toml))):
        again = build_options(config, table, subject.label)
        require(again == default, f"after {form} the options are {again}, not {default}")


def _lists(value: object) -> object:
    if isinstance(value, dict):
        return {k: _lists(v) for k, v in value.items()}
    return [_lists(v) for v in value] if isinstance(value, tuple | list) else value


@contract()
def options_documented(subject: Subject) -> None:
    """Every option has a docstring below it, so that a form and the reference can say what it is for."""
    properties = options_schema(subject.component.config).get("properties", {})
    silent = [name for name, entry in properties.items() if not entry.get("description")]
    require(not silent, f"{subject.component.config.__name__}: {', '.join(silent)} has no docstring below it")


@contract()
def descriptor_is_complete(subject: Subject) -> None:
    """The name is lower case with underscores, so that it is a TOML key (an exporter's is the file's ending and may
    have dots); the summary is a sentence.
    """
    name, summary = subject.component.name, subject.component.summary
    allowed = r"[a-z][a-z0-9_.]*" if subject.kind == "exporter" else r"[a-z][a-z0-9_]*"
    require(re.fullmatch(allowed, name), f"the name {name!r} is not lower case letters, digits, underscores")
    require(summary.strip().endswith("."), f"the summary is {summary!r}; write a sentence, with its full stop")
    require(
        "\n" not in summary and len(summary) <= 160,
        f"the summary has {len(summary)} characters or several lines; it stands in a table: one line, at most 160",
    )


@contract()
def traits_are_known(subject: Subject) -> None:
    """Traits are words that the core knows for the kind (`hir_core.plugins.traits`); a misspelt promise would do
    nothing."""
    known = TRAITS[subject.kind]
    for trait in sorted(subject.component.traits - set(known)):
        near = get_close_matches(trait, known, 1)
        advice = f"; did you mean {near[0]!r}?" if near else ""
        require(
            False,
            f"the trait {trait!r} is not known for a {subject.kind.replace('_', ' ')}{advice} "
            f"It has: {', '.join(sorted(known)) or 'none'}",
        )


@contract()
def imports_light(subject: Subject) -> None:
    """The module that registers the component loads nothing heavy: every `hir` command imports it."""
    source = subject.registered.module
    file = getattr(sys.modules.get(source), "__file__", None)
    if not source or file is None:
        raise NotApplicable("no module registers it")
    if source.startswith("hir_plugin_"):  # loaded from a file by its path
        source = file
    loaded = _loaded_by(source, tuple(sys.path))
    heavy = [name for name in HEAVY if name in loaded]
    require(not heavy, f"importing {source} loads {', '.join(heavy)}; import them in the module that `target` names")


@cache
def _loaded_by(source: str, path: tuple[str, ...]) -> frozenset[str]:
    """Top-level modules that a fresh interpreter holds after it imported a module, or ran a file."""
    if source.endswith(".py"):
        load = "from pathlib import Path; from hir_core.plugins.manager import module_from_file"
        load += f"\nmodule_from_file(Path({source!r}))"
    else:
        load = f"from importlib import import_module; import_module({source!r})"
    tell = "print('\\n' + ' '.join({m.partition('.')[0] for m in sys.modules}))"
    code = f"import sys; sys.path[:] = {list(path)!r}\n{load}\n{tell}"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(sys.executable).parent)
    if done.returncode != 0:
        raise PluginError(f"{source} cannot be imported: {done.stderr.strip().splitlines()[-1]}")
    return frozenset(done.stdout.splitlines()[-1].split())
