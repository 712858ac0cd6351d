"""Exports an asset in every variant, opens it with every reader, and stores the results: `python -m readers`.

`--scene RUN|SCENE|MESH` tries another asset and prints its table, without changing the stored results.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from hir_exporters.asset import Asset
from hir_exporters.reading.mesh_import import load_mesh_asset
from hir_exporters.scene_format import load_scene

from readers.comparison import TOLERANCE, expected, verdict
from readers.page import PAGE, RESULTS, page
from readers.programs import READERS, Description, NotRunError, Reader
from readers.variants import TEXTURE_SIDE, Variant, export_variant, made_asset, variants


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code is 0 where the table was made, whatever it says."""
    parser = argparse.ArgumentParser(prog="readers", description=__doc__)
    parser.add_argument("--scene", type=Path, metavar="RUN|SCENE|MESH")
    scene = parser.parse_args(arguments).scene
    document = results(made_asset() if scene is None else _loaded(scene), READERS, list(variants()))
    if scene is None:
        RESULTS.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
        PAGE.write_text(page(document), encoding="utf-8")
        print(PAGE)
    else:
        print(page(document))
    return 0


def results(asset: Asset, readers: Sequence[Reader], chosen: Sequence[Variant]) -> dict[str, Any]:
    """The stored document. A reader that cannot be run is in it with the reason, and all its cells are `not run`."""
    document: dict[str, Any] = {
        "triangles": len(asset.mesh.faces),
        "texture_side": expected(asset).textures.get("color", TEXTURE_SIDE),
        "tolerance": TOLERANCE,
        "readers": {},
        "results": {variant.name: {} for variant in chosen},
    }
    with tempfile.TemporaryDirectory() as folder:
        files = {variant: export_variant(variant, asset, Path(folder)) for variant in chosen}
        for reader in readers:
            mine = [variant for variant in chosen if variant.kind in reader.kinds]
            entry = {"version": "", "install": reader.install, "not_run": ""}
            document["readers"][reader.name] = entry
            found: list[Any] = [None] * len(mine)
            try:
                entry["version"] = reader.version()
                found = list(reader.read([files[variant] for variant in mine]))
            except NotRunError as error:
                entry["not_run"] = str(error)
            described = dict(zip(mine, found, strict=True))
            for variant in chosen:
                cell = "—"
                if variant in described:
                    cell = verdict(_without_folder(described[variant], folder), expected(asset, variant.hulls))
                document["results"][variant.name][reader.name] = cell
    return document


def _without_folder(found: Description | None, folder: str) -> Description | None:
    """The reader's message without the temporary folder."""
    if found is None or "error" not in found:
        return found
    return {**found, "error": str(found["error"]).replace(f"{folder}/", "")}


def _loaded(source: Path) -> Asset:
    if source.is_file():
        return load_mesh_asset(source)
    return load_scene(source if (source / "scene.json").is_file() else source / "scene")


if __name__ == "__main__":
    sys.exit(main())
