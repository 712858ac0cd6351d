"""KHR_xmp_json_ld: the asset's provenance in the words of Dublin Core and XMP, for asset management."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any, Final

from hir_exporters.asset import Asset

if TYPE_CHECKING:
    from pygltflib import GLTF2

NAME: Final = "KHR_xmp_json_ld"

CONTEXT: Final = {
    "dc": "http://purl.org/dc/elements/1.1/",
    "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
    "xmp": "http://ns.adobe.com/xap/1.0/",
}


def add_provenance(document: GLTF2, asset: Asset, residual: float) -> None:
    """Adds one packet to the document, and a reference to it to the document's asset.

    `residual` is the relative error of the material's conversion (`ExportReport.residuals`).
    """
    document.extensions = {**(document.extensions or {}), NAME: {"packets": [packet(asset, residual)]}}
    document.asset.extensions = {**(document.asset.extensions or {}), NAME: {"packet": 0}}
    document.extensionsUsed.append(NAME)


def packet(asset: Asset, residual: float) -> dict[str, Any]:
    """The packet: title, program, capture, and what is known of the material. It has no date: equal assets give equal
    bytes.
    """
    known = asset.provenance
    found = {
        "@context": CONTEXT,
        "dc:title": {"@type": "rdf:Alt", "rdf:_1": {"@language": "x-default", "@value": asset.name}},
        "dc:description": {"@type": "rdf:Alt", "rdf:_1": {"@language": "x-default", "@value": _facts(asset, residual)}},
        "dc:type": {"@type": "rdf:Bag", "rdf:_1": "3D model"},
        "xmp:CreatorTool": str(known.get("generator") or _program()),
    }
    if "capture" in known:
        found["dc:source"] = str(known["capture"])
    if "fingerprint" in known:
        found["dc:identifier"] = str(known["fingerprint"])
    return found


def _facts(asset: Asset, residual: float) -> str:
    parts = [
        f"{len(asset.mesh.faces)} triangles",
        f"material model {asset.material.model}",
        f"error of the material's conversion {residual:.1%} on the BRDF slice",
    ]
    if asset.material.observed is not None:
        parts.append(f"{asset.material.observed.mean():.1%} of the texels were seen in a photograph")
    return "; ".join(parts)


def _program() -> str:
    try:
        return f"hir {version('hir')}"
    except PackageNotFoundError:  # the package is used from its folder
        return "hir"
