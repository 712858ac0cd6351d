"""hir_core names no registered component: presets name components, and hir_core reads presets.

A string constant that equals the name of a registered component is refused in hir_core. Some names are also ordinary
words of hir_core, such as `paper` for a BRDF or `gltf` for a trait. These are listed with their other meaning, and are
refused only where a component is named:

- as an argument of a call whose first argument is a kind of component (`plugins.create("exporter", "glb")`), or
- as the value (alone or in a tuple, list or dictionary key) of a variable, field, parameter or keyword argument whose
  name says that it holds components (`renderer: str = "contour"`, `export=("glb", "usdz")`).

Docstrings, messages and dictionary keys of other subjects are free.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

import pytest

from hir_core.plugins.manager import KINDS, PluginManager
from tests.architecture.import_graph import PACKAGES, ROOT

ORDINARY_WORDS = {
    "colmap": "the format of exported cameras",
    "folder": "a directory",
    "gltf": "a trait of exporters",
}
"""Names of components that mean something else in hir_core, each with the other meaning."""

COMPONENT_VARIABLE = re.compile(
    r"(^|_)(reader|mask|initializer|renderer|regularizer|exporter|export|observer|format)s?$"
)
"""Names of variables, fields and parameters that hold names of components."""


def component_names() -> set[str]:
    plugins = PluginManager.discover()
    return {registered.component.name for registered in plugins.components()} | set(plugins.observers())


def strings(node: ast.AST | None) -> Iterator[ast.Constant]:
    """String constants of an expression: alone, in tuples and lists, or as keys of dictionaries."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node
    elif isinstance(node, ast.Tuple | ast.List | ast.Set):
        for element in node.elts:
            yield from strings(element)
    elif isinstance(node, ast.Dict):
        for key in node.keys:
            yield from strings(key)
    elif isinstance(node, ast.Call):  # field(default=…), field(default_factory=lambda: …), frozenset(…)
        for value in (*node.args, *(keyword.value for keyword in node.keywords)):
            yield from strings(value)
    elif isinstance(node, ast.Lambda):
        yield from strings(node.body)


def named_values(node: ast.AST) -> Iterator[tuple[str, ast.expr | None]]:
    """(name, value) of assignments, fields, parameters with defaults, keyword arguments and comparisons."""
    if isinstance(node, ast.Assign):
        yield from ((_name(target), node.value) for target in node.targets)
    elif isinstance(node, ast.AnnAssign):
        yield _name(node.target), node.value
    elif isinstance(node, ast.keyword):
        yield node.arg or "", node.value
    elif isinstance(node, ast.Compare):
        yield from ((_name(node.left), other) for other in node.comparators)
    elif isinstance(node, ast.arguments):
        positional = [*node.posonlyargs, *node.args]
        yield from (
            (a.arg, value) for a, value in zip(positional[::-1], node.defaults[::-1], strict=False) if value is not None
        )
        yield from ((a.arg, value) for a, value in zip(node.kwonlyargs, node.kw_defaults, strict=True))


def _name(node: ast.expr) -> str:
    if isinstance(node, ast.Attribute):
        return node.attr
    return node.id if isinstance(node, ast.Name) else ""


def component_positions(tree: ast.AST) -> set[int]:
    """`id` of the string constants that name a component by their position."""
    found: set[int] = set()
    for node in ast.walk(tree):
        for name, value in named_values(node):
            if COMPONENT_VARIABLE.search(name):
                found |= {id(constant) for constant in strings(value)}
        if isinstance(node, ast.Call) and node.args:
            first, *others = node.args
            if isinstance(first, ast.Constant) and first.value in KINDS:
                found |= {id(constant) for other in others for constant in strings(other)}
    return found


def offences(source: str, names: set[str]) -> list[tuple[int, str]]:
    """Line and name of each forbidden string constant."""
    tree = ast.parse(source)
    positions = component_positions(tree)
    return [
        (node.lineno, node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value in names
        and (node.value not in ORDINARY_WORDS or id(node) in positions)
    ]


def test_core_names_no_registered_component() -> None:
    names = component_names()
    assert len(names) > 30 and set(ORDINARY_WORDS) <= names
    wrong = [
        f"{file.relative_to(ROOT)}:{line}: {name!r}"
        for file in sorted(PACKAGES["hir_core"].rglob("*.py"))
        for line, name in offences(file.read_text(encoding="utf-8"), names)
    ]
    assert wrong == []


@pytest.mark.parametrize(
    "source",
    [
        'class GeometrySettings:\n    renderer: str = "contour"',
        'class Settings:\n    export: tuple[str, ...] = ("glb", "gltf")',
        'class Settings:\n    initializers: tuple[str, ...] = field(default=("colmap",))',
        'class Settings:\n    regularizers: dict = field(default_factory=lambda: {"laplacian": {"weight": 1}})',
        'plugins.create("mask_source", "folder", {})',
        'def run(masks=("folder",)): ...',
        'if config.reader == "folder": ...',
        'probe(renderer, "transport_ggx")',
    ],
)
def test_names_of_components_are_found(source: str) -> None:
    names = {"contour", "gltf", "glb", "colmap", "laplacian", "folder", "transport_ggx"}
    assert offences(source, names)


@pytest.mark.parametrize(
    "source",
    [
        'view = {"folder": directory.report}',
        'EDIT_HOOKS = {"gltf": ("hir_gltf_document", "document")}',
        'if "gltf" in component.traits: ...',
        '"""Settings of the renderer, such as transport_ggx."""',
    ],
)
def test_ordinary_words_are_free(source: str) -> None:
    assert offences(source, {"folder", "gltf", "transport_ggx"}) == []
