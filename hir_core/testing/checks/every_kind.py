"""Contracts of every component: its descriptor, its class, its options, what importing it costs."""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields, is_dataclass
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Any, Final

from hir_core.errors import PluginError
from hir_core.plugins.loading import docs_page
from hir_core.plugins.options import build_options, options_schema
from hir_core.plugins.traits import TRAITS
from hir_core.testing.contract import INTERFACES, BrokenContract, NotApplicable, Subject, contract, require

HEAVY: Final = ("torch", "mitsuba", "drjit", "open3d", "pycolmap", "xatlas", "cv2", "skimage", "matplotlib", "pxr")
"""Packages that take a good part of a second to import."""
QUICK_S: Final = 0.25
QUICK_RATIO: Final = 2.0
TRIES: Final = 3
CLOCK: Final = """
def clock():
    try:
        with open("/proc/self/schedstat") as file:
            waited = int(file.read().split()[1]) / 1e9
    except OSError:
        waited = 0.0
    return time.perf_counter() - waited
"""
"""How long a module may take to import: seconds, or times what the plugin interface takes, where that is more; the
best of some tries. `CLOCK` does not count, where Linux tells it, how long the process waited for a free processor."""


@contract(first=True)
def implements_its_interface(subject: Subject) -> None:
    """`target` names a class that is a subclass of its kind's base class and implements all of its methods."""
    base = INTERFACES[subject.kind]
    try:
        found = subject.implementation
    except (ImportError, AttributeError) as error:
        raise BrokenContract(
            f"target={subject.component.target!r} cannot be imported: {error}; target is 'module:Class'"
        ) from error
    require(inspect.isclass(found), f"{subject.component.target!r} is {found!r}, not a class")
    require(issubclass(found, base), f"{found.__name__} is not a subclass of {base.__module__}.{base.__name__}")
    missing = sorted(getattr(found, "__abstractmethods__", ()))
    require(not missing, f"{found.__name__} does not implement {', '.join(missing)}")


@contract(first=True)
def default_options_construct(subject: Subject) -> None:
    """The options are a frozen dataclass with a default for each, and the class is built from it: `Class(config)`."""
    config: Any = subject.component.config
    _require_frozen_with_defaults(config)
    try:
        subject.create()
    except TypeError as error:
        raise PluginError(f"{subject.implementation.__name__}({config.__name__}()) raised TypeError: {error}") from None


def _require_frozen_with_defaults(config: Any) -> None:
    require(is_dataclass(config), f"config={config!r} is not a dataclass; write @dataclass(frozen=True) above a class")
    require(
        config.__dataclass_params__.frozen,
        f"{config.__name__} is not frozen, so that its values could change after they were checked; write "
        "@dataclass(frozen=True)",
    )
    without = [f.name for f in fields(config) if f.default is f.default_factory]
    require(not without, f"the option {', '.join(without)} has no default; every component is built without settings")


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
    _require_round_trip(subject.component.config, subject.label)


def _require_round_trip(config: Any, owner: str) -> None:
    import tomli_w

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
        again = build_options(config, table, owner)
        require(again == default, f"after {form} the options are {again}, not {default}")


def require_sound_options(config: Any, owner: str) -> None:
    """Frozen, with defaults that survive JSON and TOML; for options of what is no component."""
    _require_frozen_with_defaults(config)
    _require_round_trip(config, owner)


def _lists(value: object) -> object:
    if isinstance(value, dict):
        return {k: _lists(v) for k, v in value.items()}
    return [_lists(v) for v in value] if isinstance(value, tuple | list) else value


@contract()
def options_documented(subject: Subject) -> None:
    """Every option has a docstring below it, so that a form and the reference can say what it is for."""
    require_documented_options(subject.component.config)


def require_documented_options(config: Any) -> None:
    """Every option has a docstring."""
    properties = options_schema(config).get("properties", {})
    silent = [name for name, entry in properties.items() if not entry.get("description")]
    require(not silent, f"{config.__name__}: {', '.join(silent)} has no docstring below it")


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
def docs_page_is_there(subject: Subject) -> None:
    """`docs`, where it is given, is an address or a Markdown file of the package, which begins with a title and names
    each option.
    """
    if not subject.component.docs:
        raise NotApplicable("it has no page of its own")
    page = docs_page(subject.component.docs)
    if isinstance(page, str):
        return
    require(
        page.suffix == ".md" and page.is_file(), f"docs={subject.component.docs!r}: there is no Markdown file {page}"
    )
    text = page.read_text(encoding="utf-8")
    require(text.startswith("# "), f"{page.name} begins with {text[:20]!r}; the first line is the title: # …")
    unnamed = [f.name for f in fields(subject.component.config) if f"`{f.name}`" not in text]
    require(not unnamed, f"{page.name} does not name the option {', '.join(f'`{name}`' for name in unnamed)}")


@contract()
def traits_are_known(subject: Subject) -> None:
    """Traits are words that the core knows for the kind (`hir_core.plugins.traits`); a misspelt trait would have no
    effect."""
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
    require_light_import(subject.registered.module)


@contract()
def imports_quickly(subject: Subject) -> None:
    """The module that registers the component is imported in a quarter of a second, or in twice what the interface of
    `hir` itself takes where that is more: every `hir` command waits for it.
    """
    require_quick_import(subject.registered.module)


def require_light_import(module: str) -> None:
    """Importing it loads none of the packages that take long."""
    heavy = _heavy(_imported_alone(_source_of(module), tuple(sys.path)))
    require(
        not heavy,
        f"importing {module} loads {', '.join(heavy)}, which every `hir` command would wait for; import them in the "
        "module that `target` names, or inside of the function that needs them",
    )


def require_quick_import(module: str) -> None:
    """Importing it takes little."""
    source = _source_of(module)
    first = _imported_alone(source, tuple(sys.path))
    if _heavy(first):
        raise NotApplicable("it loads heavy packages, which the contract of light imports names")
    tries = [first]
    while len(tries) < TRIES and not _is_quick(tries):
        tries.append(_import_alone(source, tuple(sys.path)))
    require(
        _is_quick(tries),
        f"importing {module} takes {min(t.seconds for t in tries):.1f} s, which every `hir` command would wait for; do "
        "at first use what it does at import, such as reading files or asking a server",
    )


def _is_quick(tries: Sequence[ImportedAlone]) -> bool:
    limit = max(QUICK_S, QUICK_RATIO * min(t.interface_seconds for t in tries))
    return min(t.seconds for t in tries) <= limit


@dataclass(frozen=True)
class ImportedAlone:
    """A module imported by a fresh interpreter."""

    packages: frozenset[str]
    """Top-level modules that are loaded afterwards."""
    seconds: float
    """Without the interface of `hir`, which was imported before."""
    interface_seconds: float
    """What importing the plugin interface of `hir` took."""


def _heavy(imported: ImportedAlone) -> list[str]:
    return [name for name in HEAVY if name in imported.packages]


def _source_of(module: str) -> str:
    """What a fresh interpreter imports: the module's name, or its file where it was loaded by its path."""
    file = getattr(sys.modules.get(module), "__file__", None)
    if not module or file is None:
        raise NotApplicable("no module registers it")
    return file if module.startswith("hir_plugin_") else module


def _import_alone(source: str, path: tuple[str, ...]) -> ImportedAlone:
    load = f"import_module({source!r})"
    if source.endswith(".py"):
        load = f"module_from_file(Path({source!r}))"
    code = (
        f"import sys, time; sys.path[:] = {list(path)!r}\n{CLOCK}"
        "from importlib import import_module; from pathlib import Path; start = clock()\n"
        "import hir_core.plugins.manager, click; interface = clock() - start\n"
        "import hir_core.plugins.interfaces\n"
        "from hir_core.plugins.loading import module_from_file; before = clock()\n"
        f"{load}\n"
        "print('\\n', clock() - before, interface, *{m.partition('.')[0] for m in sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(sys.executable).parent)
    if done.returncode != 0:
        raise PluginError(f"{source} cannot be imported: {done.stderr.strip().splitlines()[-1]}")
    seconds, interface, *packages = done.stdout.splitlines()[-1].split()
    return ImportedAlone(frozenset(packages), float(seconds), float(interface))


_imported_alone = cache(_import_alone)
