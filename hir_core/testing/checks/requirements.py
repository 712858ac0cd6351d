"""Contracts of what a component needs beyond the base install: declared, and said clearly when it is missing."""

from __future__ import annotations

import ast
import importlib.util
import sys
from collections.abc import Iterator
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path
from typing import Final

from hir_core.testing.contract import NotApplicable, Subject, contract, require

OURS: Final = ("hir_core", "hir_exporters")


@contract()
def requirements_declared(subject: Subject) -> None:
    """`requires` names every optional package that the implementation imports, so that its absence is said clearly."""
    declared = set(subject.component.requires)
    covered = declared | {name for module in declared for name in _comes_with(module)}
    optional = _optional_packages(subject.registered.distribution) | _optional_packages("hir")
    module = subject.component.target.partition(":")[0]
    for package, where in _imports(module, module.rpartition(".")[0] or module):
        if package in optional and package not in covered:
            require(
                False,
                f"{where} imports {package!r}, an optional package; requires={subject.component.requires!r} "
                "does not name it",
            )


@contract()
def missing_extra_is_named(subject: Subject) -> None:
    """Where its packages are missing, the error names them and a `pip install` command that installs them."""
    component, distribution = subject.component, subject.registered.distribution
    if not component.requires:
        raise NotApplicable("it needs nothing beyond the base install")
    if not subject.registered.version:
        raise NotApplicable("it comes from a file, not from a distribution with extras")
    declared = requires(distribution) or []
    if component.extra:
        offered = {_extra_of(line) for line in declared} - {""}
        require(
            component.extra in offered,
            f"extra={component.extra!r} is no extra of {distribution}, which has: "
            f"{', '.join(sorted(offered)) or 'none'}",
        )
        return
    always = {name for line in declared if not _extra_of(line) for name in _modules_of(_project(line))}
    outside = [name for name in component.requires if name not in always]
    require(
        not outside,
        f"it requires {', '.join(outside)}, names no extra, and {distribution} does not always depend "
        "on it, so that its users would be told to install what brings nothing; name it in an extra of your "
        "distribution, and that "
        "in extra=",
    )


def _imports(module: str, package: str) -> Iterator[tuple[str, str]]:
    """Top-level packages that a module needs, and where: all of the module itself; of its own package's other modules
    what they import on loading and what the functions import that are used; of hir what is imported on loading.
    """
    own = package.partition(".")[0]
    waiting: list[tuple[str, str]] = [(module, "*")]
    seen = set(waiting)
    while waiting:
        current, used = waiting.pop()
        path = _source(current)
        if path is None:
            continue
        body = ast.parse(path.read_text(encoding="utf-8")).body
        inside = current.partition(".")[0] == own and own not in OURS
        entered, used_names = (None, set[str]()) if used == "*" else _reached(body, used if inside else "")
        for name, taken, line in _imported(body, current, entered):
            alias = taken if entered is None or taken in used_names else ""
            top = name.partition(".")[0]
            if top in sys.stdlib_module_names:
                continue
            if top != own and top not in OURS:
                yield top, f"{path.name}:{line}"
            elif (name, alias) not in seen:
                seen.add((name, alias))
                waiting.append((name, alias))


def _reached(body: list[ast.stmt], name: str) -> tuple[set[str], set[str]]:
    """Definitions of a module that one of them leads to, and all words that these use."""
    definitions = {n.name: n for n in body if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)}
    found, used_names, waiting = set[str](), {name}, [name]
    while waiting:
        current = waiting.pop()
        if current in definitions and current not in found:
            found.add(current)
            used = {n.id for n in ast.walk(definitions[current]) if isinstance(n, ast.Name)}
            waiting += sorted(used - used_names)
            used_names |= used
    return found, used_names


def _imported(body: list[ast.stmt], module: str, entered: set[str] | None) -> Iterator[tuple[str, str, int]]:
    """Imported modules, the name taken from each, and the line; of functions those in `entered`, all where None."""
    Definition = ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef

    def walk(body: list[ast.stmt], held: bool = False, inner: bool = False) -> Iterator[tuple[str, str, int]]:
        # `held`: inside of a `try` whose failure is dealt with
        for node in body:
            if isinstance(node, ast.Import) and not held:
                yield from ((alias.name, "", node.lineno) for alias in node.names)
            elif isinstance(node, ast.ImportFrom) and not held:
                base = "." * node.level + (node.module or "")
                absolute = importlib.util.resolve_name(base, module.rpartition(".")[0]) if node.level else base
                for alias in node.names:
                    whole = f"{absolute}.{alias.name}"
                    yield (whole, "", node.lineno) if _source(whole) else (absolute, alias.name, node.lineno)
            elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                yield from walk(node.orelse, held, inner)
            elif isinstance(node, Definition):
                if inner or entered is None or node.name in entered:
                    yield from walk(node.body, held, inner=True)
            elif isinstance(node, ast.Try):
                yield from walk(node.body, True, inner)
                yield from walk([s for h in node.handlers for s in h.body] + node.orelse + node.finalbody, held, inner)
            else:
                for field in ("body", "orelse", "finalbody"):
                    statements = getattr(node, field, None)
                    if isinstance(statements, list):
                        yield from walk(statements, held, inner)

    yield from walk(body)


@cache
def _source(module: str) -> Path | None:
    """The file of a module that is Python source; found without importing it where its parents are loaded."""
    loaded = sys.modules.get(module)
    if loaded is not None:
        file = getattr(loaded, "__file__", None)
        return Path(file) if file and file.endswith(".py") else None
    try:
        spec = importlib.util.find_spec(module)
    except (ImportError, ValueError, AttributeError):
        return None
    return Path(spec.origin) if spec is not None and spec.origin and spec.origin.endswith(".py") else None


@cache
def _optional_packages(distribution: str) -> frozenset[str]:
    """Import names of what a distribution depends on only under an extra."""
    try:
        lines = requires(distribution) or []
    except PackageNotFoundError:
        return frozenset()
    always = {name for line in lines if not _extra_of(line) for name in _modules_of(_project(line))}
    optional = {name for line in lines if _extra_of(line) for name in _modules_of(_project(line))}
    return frozenset(optional - always)


@cache
def _owners() -> dict[str, list[str]]:
    """Import names and the distributions that install them; reads every installed package once."""
    return {module: list(owners) for module, owners in packages_distributions().items()}


@cache
def _comes_with(module: str) -> frozenset[str]:
    """Import names of what the distribution of a module always depends on, and so on."""
    waiting, seen, found = list(_owners().get(module, [])), set[str](), {module}
    while waiting:
        distribution = waiting.pop()
        if distribution in seen:
            continue
        seen.add(distribution)
        found |= _modules_of(distribution)
        try:
            lines = requires(distribution) or []
        except PackageNotFoundError:
            continue
        waiting += [_project(line) for line in lines if not _extra_of(line)]
    return frozenset(found)


@cache
def _modules_of(project: str) -> frozenset[str]:
    """Import names of a distribution; its own name, as Python would write it, where it is not installed."""
    wanted = _normal(project)
    found = {module for module, owners in _owners().items() if wanted in map(_normal, owners)}
    return frozenset(found or {project.replace("-", "_")})


def _project(requirement: str) -> str:
    name = requirement
    for mark in " ;<>=!~[(@":
        name = name.partition(mark)[0]
    return name.strip()


def _extra_of(requirement: str) -> str:
    _, _, after = requirement.partition("extra ==")
    return after.strip().strip("\"'").partition('"')[0].partition("'")[0]


def _normal(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")
