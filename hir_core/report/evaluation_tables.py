"""The results of `hir evaluate` in run.json as tables of the report."""

from __future__ import annotations

from markupsafe import Markup

from hir_core.report.tables import Cell, Row, notice, table
from hir_core.report.value_formatting import Document, number

IMAGE_HEADINGS = (
    "",
    "",
    "PSNR frame",
    "object",
    "scaled frame",
    "object",
    "SSIM",
    "LPIPS",
    "FLIP",
    "mask IoU",
    "ORB PSNR-H",
    "ORB PSNR-L",
)

TRUTH_HEADINGS = (
    "",
    "Chamfer, radii",
    "F at .005",
    "normals",
    "albedo",
    "scaled",
    "light: mirror sphere",
    "silver",
    "diffuse",
)


def evaluations(document: Document) -> Markup:
    """Image metrics of each evaluated split."""
    rows = []
    for split, m in document.get("metrics", {}).items():
        light = m.get("light", {})
        orb = m.get("stanford_orb", {})
        figures = (
            *(number(m[key][part], 2) for key in ("psnr", "psnr_scaled") for part in ("frame", "object")),
            *(number(m.get(key), 4) for key in ("ssim", "lpips", "flip", "iou")),
            *(number(orb.get(key), 2) for key in ("psnr_h", "psnr_l")),
        )
        under = "fitted light" if light.get("fitted") else f"light of {light.get('file')}"
        rows.append(Row(split, (Cell(under), *(Cell(figure, "number") for figure in figures))))
        if "scan_texture" in m:
            rows.append(_scan_texture(m["scan_texture"]))
    if not rows:
        return notice("Not evaluated on unseen photographs yet", "hir evaluate RUN")
    return table("evaluations", IMAGE_HEADINGS, rows)


def _scan_texture(figures: Document) -> Row:
    """The texture that the scan had before the run, in the same views: two figures below those of the asset."""
    scaled = [number(figures["psnr_scaled"][part], 2) for part in ("frame", "object")]
    dashes = ["–"] * (len(IMAGE_HEADINGS) - 6)
    how = "same light" if figures["lit"] else "without a light"
    return Row("", (Cell(f"scan's texture, {how}"), *(Cell(text, "number") for text in ("–", "–", *scaled, *dashes))))


def ground_truth(document: Document) -> Markup:
    """Errors against the true mesh, albedo and light; empty where nothing was compared."""
    rows = []
    for split, m in document.get("metrics", {}).items():
        surface, albedo, light = (m.get(key) or {} for key in ("surface", "albedo", "light_error"))
        if not (surface or albedo or light):
            continue
        visible, spheres = surface.get("seen", {}), light.get("spheres", {})
        figures = (
            number(visible.get("chamfer"), 5),
            number(visible.get("f_score", {}).get("0.005"), 3),
            number(visible.get("normal_error_deg"), 1, "°"),
            number(albedo.get("psnr"), 2, " dB"),
            number(albedo.get("psnr_scaled"), 2, " dB"),
            *(number(spheres.get(name), 3) for name in ("mirror", "silver", "diffuse")),
        )
        rows.append(Row(split, [Cell(figure, "number") for figure in figures]))
    return table("evaluations", TRUTH_HEADINGS, rows) if rows else Markup("")
