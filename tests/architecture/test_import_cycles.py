"""No import cycle between files or neighbouring folders; short chains of imports between folders."""

from __future__ import annotations

import pytest

from tests.architecture.import_graph import cycles, grouped, longest_chain, module_graph, modules

FILES = modules()
GRAPH = module_graph(FILES)
PACKAGE_NAMES = [name for name, file in FILES.items() if file.name == "__init__.py"]

MAX_CHAIN = 10


def test_files_have_no_import_cycle() -> None:
    assert cycles(GRAPH) == []


@pytest.mark.parametrize("package", PACKAGE_NAMES)
def test_entries_of_a_folder_have_no_import_cycle(package: str) -> None:
    """The entries are the files and folders directly inside; the package itself is no entry."""
    prefix = f"{package}."

    def entry(module: str) -> str | None:
        return module.removeprefix(prefix).partition(".")[0] if module.startswith(prefix) else None

    assert cycles(grouped(GRAPH, entry)) == []


def folder(module: str) -> str | None:
    """hir_core is opened by one level; the other layers are one folder each.

    `hir_core/__init__.py` does not count: it loads `reconstruct` and `load_scene` on first use and nothing else.
    """
    first, *rest = module.split(".")
    if first != "hir_core":
        return first
    return f"{first}.{rest[0]}" if rest else None


def test_chains_of_imports_between_folders_are_short() -> None:
    graph = grouped(GRAPH, folder)
    assert cycles(graph) == []
    chain = longest_chain(graph)
    assert len(chain) <= MAX_CHAIN, " → ".join(chain)


def test_cycles_and_chains_are_found() -> None:
    graph = {"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set(), "e": {"a"}}
    assert cycles(graph) == [["b", "c"]]
    assert longest_chain({"a": {"b", "c"}, "b": {"c"}, "c": set()}) == ["a", "b", "c"]
    assert grouped(graph, lambda node: None if node == "e" else node.upper())["C"] == {"B", "D"}
