"""Folders that a reader can take in, and module names that say one thing."""

from __future__ import annotations

from collections import defaultdict

from tests.architecture.import_graph import PACKAGES, ROOT, modules

MAX_MODULES = 15
MAX_TOP_MODULES = 6
"""Modules directly in hir_core, `__init__.py` included."""

FOLDERS_OF_LIKE_THINGS = {
    "hir_core/cli": "one command a file",
    "hir_plugins/readers": "one capture format a file",
}
"""Folders that may have more modules, each with the reason."""

ROLES = {
    "plugin": "the hooks of a folder of plugins",
    "options": "the option dataclasses of a plugin folder",
    "renderer": "the renderer that the folder implements",
    "command": "the command that the folder adds",
    "contract_inputs": "inputs of the contract tests for the plugins of the folder",
    "bilinear": "the bilinear lookup of an array library: numpy in hir_exporters, torch in hir_core",
    "errors": "the exceptions of a layer; those of hir_core extend those of hir_exporters",
}
"""Module names that stand for a role: they mean the same in every folder. Each with its meaning."""

LAYERED_FOLDERS = {
    "files": "reading and writing files, per layer",
    "mesh": "meshes without torch in hir_exporters, algorithms of the fit in hir_core",
    "textures": "texture files in hir_exporters, the fit of textures in transport_ggx",
}
"""Folder names that occur in two layers for the same subject. Each with what belongs where."""


def test_no_folder_has_too_many_modules() -> None:
    counts: dict[str, int] = defaultdict(int)
    for file in modules().values():
        if file.name != "__init__.py":
            counts[file.parent.relative_to(ROOT).as_posix()] += 1
    large = {folder: count for folder, count in counts.items() if count > MAX_MODULES}
    assert set(large) <= set(FOLDERS_OF_LIKE_THINGS), large
    assert set(FOLDERS_OF_LIKE_THINGS) <= set(counts), "an exception names a folder that does not exist"


def test_few_modules_at_the_top_of_hir_core() -> None:
    assert len(list(PACKAGES["hir_core"].glob("*.py"))) <= MAX_TOP_MODULES


def test_module_names_are_unique() -> None:
    """A module may be named as its own folder (`capture/capture.py`): it holds what the folder is named for."""
    modules_by_name: dict[str, set[str]] = defaultdict(set)
    for module, file in modules().items():
        folder, _, name = module.rpartition(".")
        is_main_module = file.name != "__init__.py" and folder.rpartition(".")[2] == name
        if folder and not is_main_module and not name.startswith("__"):
            modules_by_name[name].add(module)
    repeated = {name: sorted(found) for name, found in modules_by_name.items() if len(found) > 1}
    assert set(repeated) <= {*ROLES, *LAYERED_FOLDERS}, repeated
    assert {*ROLES, *LAYERED_FOLDERS} <= set(modules_by_name), "an exception names a module that does not exist"
