"""Draws docs/images/data_flow.svg: the stages of a run, what passes between them, and the plugins that each asks."""

from __future__ import annotations

import html
from pathlib import Path

FILE = Path(__file__).resolve().parent.parent / "docs" / "images" / "data_flow.svg"

STAGES = (
    ("reader", "Capture", "capture readers"),
    ("initializer", "Capture, Scene: mesh", "initializers, mask sources"),
    ("geometry", "Scene: fitted mesh", "geometry renderers, regularizers"),
    ("atlas", "Scene: texture coordinates", ""),
    ("reflectance", "Scene: material, light", "reflectance renderers, regularizers"),
    ("bake", "Asset", ""),
    ("export", "files, run.json, report.html", "exporters"),
)
WIDTH, ROW, TOP = 760, 62, 56
LEFT, BOX = 250, 180
STYLE = """
  text { font: 14px sans-serif; fill: #222 }
  .value { fill: #555; font-style: italic; font-size: 13px }
  .box { fill: #e8eef7; stroke: #35527a; stroke-width: 1.5 }
  .plugin { fill: #fdf1dc; stroke: #b0761a }
  .arrow { stroke: #35527a; stroke-width: 1.5; fill: none }
  .asks { stroke: #b0761a; stroke-dasharray: 4 3; fill: none }
  .watch { fill: none; stroke: #888; stroke-dasharray: 2 4 }
  .band { fill: #888; font-size: 12px }
"""


def picture() -> str:
    """The whole SVG."""
    height = TOP + ROW * len(STAGES) + 40
    label = "From a folder of photographs to files, stage by stage, with the plugins that each stage asks"
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{label}">',
        f"<style>{STYLE}</style><rect width='{WIDTH}' height='{height}' fill='white'/>",
        '<defs><marker id="tip" markerWidth="8" markerHeight="8" refX="6" refY="4" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#35527a"/></marker></defs>',
        f'<text x="{LEFT + BOX / 2}" y="22" text-anchor="middle" class="value">a folder of photographs</text>',
        f'<path class="arrow" marker-end="url(#tip)" d="M{LEFT + BOX / 2} 28V{TOP - 4}"/>',
    ]
    for i, (name, gives, asks) in enumerate(STAGES):
        y = TOP + i * ROW
        middle = LEFT + BOX / 2
        parts.append(f'<rect class="box" x="{LEFT}" y="{y}" width="{BOX}" height="34" rx="6"/>')
        parts.append(f'<text x="{middle}" y="{y + 22}" text-anchor="middle">{name}</text>')
        parts.append(f'<path class="arrow" marker-end="url(#tip)" d="M{middle} {y + 34}V{y + ROW - 4}"/>')
        parts.append(f'<text class="value" x="{middle + 12}" y="{y + 52}">{html.escape(gives)}</text>')
        if asks:
            parts.append(f'<rect class="plugin" x="10" y="{y}" width="215" height="34" rx="6"/>')
            parts.append(f'<text x="117" y="{y + 22}" text-anchor="middle" style="font-size:13px">{asks}</text>')
            parts.append(f'<path class="asks" d="M{LEFT} {y + 17}H225"/>')
    bottom = TOP + ROW * (len(STAGES) - 1) + 34
    x = WIDTH - 130
    parts.append(f'<rect class="plugin" x="{x}" y="{TOP}" width="115" height="{bottom - TOP}" rx="6"/>')
    parts.append(f'<text x="{x + 57}" y="{(TOP + bottom) / 2 - 8}" text-anchor="middle">observers</text>')
    for line, text in enumerate(("hear of each", "stage and of", "progress")):
        y = (TOP + bottom) / 2 + 14 + 16 * line
        parts.append(f'<text class="band" x="{x + 57}" y="{y}" text-anchor="middle">{text}</text>')
    parts.append(
        f'<text class="band" x="10" y="{height - 12}">blue: stages of hir_core; yellow: plugins, '
        "found by entry points; italic: what passes on and is written to the run's folder</text>"
    )
    return "\n".join([*parts, "</svg>"]) + "\n"


if __name__ == "__main__":
    FILE.write_text(picture(), encoding="utf-8")
