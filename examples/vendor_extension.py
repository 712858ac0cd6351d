"""A vendor's own data in exported files: the last step before their bytes.

    hir export RUN -f glb -f usdz -o out/ --plugin examples/vendor_extension.py

A hook gets the finished document, a `pygltflib.GLTF2` or a `pxr.Usd.Stage`, and changes it in place. Extensions are
named in `extensionsUsed` and never required, so that readers which do not know them still show the asset.
"""

from __future__ import annotations

from typing import Any

from hir_exporters import Asset

from hir_core.plugins import hookimpl

EXTENSION = "ACME_catalogue"


@hookimpl
def hir_gltf_document(document: Any, asset: Asset) -> None:
    """An extension on the node, and a root property that any viewer shows."""
    document.asset.copyright = "ACME, 2026"
    document.extensionsUsed.append(EXTENSION)
    for node in document.nodes:
        entry = {"article": asset.name, "triangles": len(asset.mesh.faces)}
        node.extensions = {**(node.extensions or {}), EXTENSION: entry}


@hookimpl
def hir_usd_stage(stage: Any, asset: Asset) -> None:
    """Custom data on the default prim, and the name that asset managers read."""
    from pxr import Usd

    prim = stage.GetDefaultPrim()
    prim.SetCustomDataByKey("acme:article", asset.name)
    Usd.ModelAPI(prim).SetAssetName(asset.name)
