"""Aliases of array types are evaluated when their module is imported; annotations are not."""

from __future__ import annotations

import ast

from tests.architecture.import_graph import modules

JAXTYPING = {"Float", "Int", "Bool", "UInt8", "Num", "Shaped", "Complex", "Integer"}


def shaped_array_aliases(source: str) -> list[str]:
    """Aliases such as `Corners = Float[NDArray[np.float64], "4 3"]` at the top of a module."""
    found = []
    for node in ast.parse(source).body:
        value = node.value if isinstance(node, ast.Assign | ast.AnnAssign) else None
        if not isinstance(value, ast.Subscript) or not isinstance(value.value, ast.Name):
            continue
        names = {part.id for part in ast.walk(value.slice) if isinstance(part, ast.Name)}
        if value.value.id in JAXTYPING and "NDArray" in names:
            found.append(ast.unparse(node))
    return found


def test_no_alias_gives_ndarray_to_jaxtyping() -> None:
    """From numpy 2.5 on `NDArray[...]` is no class, which jaxtyping asks for."""
    found = {name: shaped_array_aliases(path.read_text(encoding="utf-8")) for name, path in modules().items()}
    assert {name: aliases for name, aliases in found.items() if aliases} == {}


def test_an_alias_is_found() -> None:
    assert shaped_array_aliases('Corners = Float[NDArray[np.float64], "4 3"]\n') != []
    assert shaped_array_aliases("Corners = NDArray[np.float64]\n") == []
