"""Writes docs/engines/readers.md from the stored results."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

FOLDER: Final = Path(__file__).resolve().parents[2] / "docs" / "engines"
RESULTS: Final = FOLDER / "readers.json"
PAGE: Final = FOLDER / "readers.md"

_INTRODUCTION = """# Third-party readers

Which readers read which exported file. Written by `make readers` from `readers.json`; do not edit it. The asset is made
by `tools/readers/variants.py`: {triangles} triangles, textures of {side}² pixels for base colour, roughness with
metalness, and normals.

A cell says `read` if the reader found one mesh with the number of triangles and, within {tolerance:g} of its diagonal,
the bounding box of the asset, and a texture of the right size for base colour, roughness and normals. assimp's Python
package gives no pixels: only the names of its textures were checked. gltfpack packs the file, and glTF-Transform reads
the result. For files with collision shapes, the names of the meshes and the textures were checked. `refused` is the
reader's own message, `differs` says what was found instead, `—` is a format that the reader does not have, and
`not run` a reader that was not installed.
"""


def page(document: Mapping[str, Any]) -> str:
    """The page of stored results."""
    readers, notes = document["readers"], []
    text = _INTRODUCTION.format(
        triangles=document["triangles"], side=document["texture_side"], tolerance=document["tolerance"]
    )
    rows = ["| file | " + " | ".join(f"{name} {entry['version']}".strip() for name, entry in readers.items()) + " |"]
    rows.append("|---|" + "---|" * len(readers))
    for variant, cells in document["results"].items():
        shown = []
        for name in readers:
            cell = cells[name]
            if cell not in ("read", "not run", "—"):
                notes.append(f"- `{variant}`, {name}: {cell}")
                cell = f"{cell.partition(':')[0].partition(',')[0]}*"
            shown.append(cell)
        rows.append(f"| `{variant}` | " + " | ".join(shown) + " |")
    for name, entry in readers.items():
        if entry["not_run"]:
            notes.append(f"- {name} was not run: {entry['not_run']}. To run it: `{entry['install']}`.")
    return f"{text}\n" + "\n".join(rows) + "\n\n## Notes (*)\n" + "\n".join(notes) + "\n"
