"""The imports between the modules of the packages, as a graph, and its cycles and longest chains.

Imports inside functions and under `TYPE_CHECKING` count: whoever reads the code follows them too.
"""

from __future__ import annotations

import ast
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {
    "hir_exporters": ROOT / "exporters" / "hir_exporters",
    "hir_core": ROOT / "hir_core",
    "hir_plugins": ROOT / "hir_plugins",
}
"""Import name and folder of each layer, lowest first."""

Graph = Mapping[str, set[str]]
"""Node → nodes that it imports."""


def modules() -> dict[str, Path]:
    """Dotted name → file of every module; a package is its `__init__.py`."""
    found = {}
    for package, folder in PACKAGES.items():
        for file in sorted(folder.rglob("*.py")):
            parts = file.relative_to(folder).with_suffix("").parts
            found[".".join((package, *parts)).removesuffix(".__init__")] = file
    return found


def module_graph(files: Mapping[str, Path]) -> dict[str, set[str]]:
    """Module → modules that it imports."""
    return {module: imported_modules(file, files.keys()) - {module} for module, file in files.items()}


def imported_modules(file: Path, known: Iterable[str]) -> set[str]:
    """Modules of `known` that a file imports. `from a import b` is an import of a.b where that is a module."""
    known, found = set(known), set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= {name if name in known else node.module for name in names}
    return found & known


def grouped(graph: Graph, group_of: Callable[[str], str | None]) -> dict[str, set[str]]:
    """The graph between groups of nodes; nodes of the group None are left out."""
    result: dict[str, set[str]] = defaultdict(set)
    for node, targets in graph.items():
        group = group_of(node)
        if group is None:
            continue
        others = {other for target in targets if (other := group_of(target)) is not None}
        result[group] |= others - {group}
    return dict(result)


def cycles(graph: Graph) -> list[list[str]]:
    """Sets of two or more nodes that reach each other (Tarjan's strongly connected components)."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    stack: list[str] = []
    found: list[list[str]] = []

    def visit(node: str) -> None:
        index[node] = low[node] = len(index)
        stack.append(node)
        for target in sorted(graph.get(node, ())):
            if target not in index:
                visit(target)
                low[node] = min(low[node], low[target])
            elif target in stack:
                low[node] = min(low[node], index[target])
        if low[node] == index[node]:
            position = stack.index(node)
            component, stack[position:] = stack[position:], []
            if len(component) > 1:
                found.append(sorted(component))

    for node in sorted(graph):
        if node not in index:
            visit(node)
    return found


def longest_chain(graph: Graph) -> list[str]:
    """The longest path of a graph without cycles."""
    chains: dict[str, list[str]] = {}

    def chain_from(node: str) -> list[str]:
        if node not in chains:
            chains[node] = [
                node,
                *max((chain_from(target) for target in sorted(graph.get(node, ()))), key=len, default=[]),
            ]
        return chains[node]

    return max((chain_from(node) for node in sorted(graph)), key=len, default=[])
