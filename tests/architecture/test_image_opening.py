"""Images are opened in one place, with the formats that hir reads; mesh files too, with a check of what they name."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = [ROOT / "exporters" / "hir_exporters", ROOT / "hir_core", ROOT / "hir_plugins"]
ALLOWED = {
    "Image.open": {"exporters/hir_exporters/textures/pillow_images.py"},
    "trimesh.load": {
        "exporters/hir_exporters/reading/mesh_references.py",
        "hir_core/testing/mesh_files.py",
    },
}
"""Where a function may be called; the contract tests read files that an exporter has just written."""


def calls(file: Path) -> Iterator[str]:
    """`Image.open` and `trimesh.load`, whatever name they were imported with."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    names = {"Image": "Image", "PIL.Image": "Image", "trimesh": "trimesh"}
    for node in ast.walk(tree):
        for alias in node.names if isinstance(node, ast.Import | ast.ImportFrom) else ():
            module = alias.name if isinstance(node, ast.Import) else f"{node.module}.{alias.name}"
            if alias.asname and module in ("PIL.Image", "trimesh"):
                names[alias.asname] = names[module]
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").partition(".")[0] in ("PIL", "trimesh"):
            for alias in node.names:
                if (node.module, alias.name) == ("PIL.Image", "open"):
                    yield "Image.open"
                if node.module == "trimesh" and alias.name.startswith("load"):
                    yield "trimesh.load"
        elif isinstance(node, ast.Attribute) and node.attr.startswith(("open", "load")):
            owner = names.get(ast.unparse(node.value))
            if owner == "Image" and node.attr == "open":
                yield "Image.open"
            elif owner == "trimesh" and node.attr.startswith("load"):
                yield "trimesh.load"


@pytest.mark.parametrize(
    ("code", "found"),
    [
        ("from PIL import Image as I\nI.open(f)", ["Image.open"]),
        ("import PIL.Image as P\nP.open(f)", ["Image.open"]),
        ("from PIL.Image import open as o", ["Image.open"]),
        ("import trimesh as t\nt.load_scene(f)", ["trimesh.load"]),
        ("from trimesh import load_mesh", ["trimesh.load"]),
        ("import PIL.Image\nPIL.Image.new()", []),
    ],
)
def test_other_names_are_found(code: str, found: list[str], tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text(code)
    assert list(calls(tmp_path / "a.py")) == found


def test_untrusted_files_are_opened_in_one_place() -> None:
    files = [file for folder in FOLDERS for file in sorted(folder.rglob("*.py"))]
    found: dict[str, set[str]] = {name: set() for name in ALLOWED}
    for file in files:
        for name in calls(file):
            found[name].add(file.relative_to(ROOT).as_posix())
    assert found == ALLOWED
