"""Draws docs/images/data_flow.svg: the way of a photograph to a .glb, each step with the file that computes it."""

from __future__ import annotations

import html
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "docs" / "images" / "data_flow.svg"


@dataclass(frozen=True)
class Step:
    """One step of the drawing."""

    stage: str
    """Name of the stage, as `--until` and the run's folders have it; empty for a further step of the stage above."""
    action: str
    file: str
    """Path below the repository's root."""
    result: str = ""
    """What the stage passes to the next one, on its last step."""
    plugin: bool = False
    """Whether the step belongs to a plugin that may be replaced."""


TRANSPORT = "hir_plugins/reflectance_renderers/transport_ggx"
STEPS = (
    Step("reader", "recognise the folder's format", "hir_core/intake/reader_lookup.py"),
    Step("", "read cameras and file names", "hir_plugins/readers/transforms_json.py", plugin=True),
    Step("", "decode to linear colour, mark clipped pixels", "hir_core/capture/pixels.py", "Capture"),
    Step("initializer", "choose the chain of initializers", "hir_core/stages/initialization.py"),
    Step("", "masks, where photographs have none", "hir_plugins/masks/grabcut.py", plugin=True),
    Step("", "cameras, where none are known", "hir_plugins/initializers/sfm/colmap.py", plugin=True),
    Step(
        "",
        "first mesh: visual hull",
        "hir_plugins/initializers/hull/visual_hull.py",
        "Capture with cameras and masks, Scene with a mesh",
        plugin=True,
    ),
    Step("geometry", "fit silhouettes to masks", "hir_core/stages/geometry/silhouettes/silhouette_fit.py"),
    Step("", "area of a silhouette, and its gradient", "hir_plugins/geometry_renderers/contour.py", plugin=True),
    Step("", "photo-consistency of the surface", "hir_core/stages/geometry/photo_consistency/photo_refinement.py"),
    Step(
        "",
        "occlusion boundaries",
        "hir_core/stages/geometry/occlusion_boundaries/boundary_refinement.py",
        "Scene with fitted mesh",
    ),
    Step("atlas", "texture coordinates", "hir_core/stages/atlas.py", "Scene with texture coordinates"),
    Step("reflectance", "select the reflectance model", "hir_core/stages/reflectance/selection/model_selection.py"),
    Step("", "trace rays once, store matrices", f"{TRANSPORT}/operator/light_transport.py", plugin=True),
    Step("", "fit light and material at vertices", f"{TRANSPORT}/fit/joint_optimization.py", plugin=True),
    Step("", "solve textures", f"{TRANSPORT}/textures/texture_solve.py", plugin=True),
    Step(
        "",
        "path-traced albedo refinement",
        f"{TRANSPORT}/textures/albedo_refinement.py",
        "Scene with material and light",
        plugin=True,
    ),
    Step("bake", "torch to numpy, into the asset frame", "hir_core/scene/asset_conversion.py", "Asset"),
    Step("export", "write each format", "hir_core/stages/export/asset_export.py"),
    Step("", "the .glb: material, mesh, textures", "exporters/hir_exporters/gltf/gltf_exporter.py", plugin=True),
    Step(
        "",
        "read back from disk, render, compare",
        "hir_core/stages/export/export_verification.py",
        ".glb, .usdz, run.json, report.html",
    ),
)

WIDTH, ROW, TOP = 1080, 26, 46
STAGE_X, ACTION_X, FILE_X = 14, 150, 480
STYLE = """
  text { font: 14px sans-serif; fill: #222 }
  .stage { font-weight: bold; fill: #35527a }
  .file { font: 12.5px monospace; fill: #333 }
  .value { fill: #555; font-style: italic; font-size: 13px }
  .box { fill: #e8eef7; stroke: #35527a; stroke-width: 1.2 }
  .plugin { fill: #fdf1dc }
  .arrow { stroke: #35527a; stroke-width: 1.5; fill: none }
  .note { fill: #777; font-size: 12px }
"""


def picture() -> str:
    """The whole SVG."""
    parts = []
    y = TOP
    first_steps = [i for i, step in enumerate(STEPS) if step.stage]
    for start, end in zip(first_steps, [*first_steps[1:], len(STEPS)], strict=True):
        group = STEPS[start:end]
        parts += _stage(group, y, final=end == len(STEPS))
        y += ROW * len(group) + 34
    height = y + 14
    label = "The way of a photograph to a .glb: stages, their steps, and the file of each step"
    head = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" role="img" aria-label="{label}">',
        f"<style>{STYLE}</style><rect width='{WIDTH}' height='{height}' fill='white'/>",
        '<defs><marker id="tip" markerWidth="8" markerHeight="8" refX="6" refY="4" orient="auto">'
        '<path d="M0 0L8 4L0 8z" fill="#35527a"/></marker></defs>',
        f'<text x="{ACTION_X}" y="18" class="value">a folder of photographs</text>',
        f'<path class="arrow" marker-end="url(#tip)" d="M{ACTION_X - 16} 8V{TOP - 4}"/>',
    ]
    note = (
        f'<text class="note" x="{STAGE_X}" y="{height - 6}">Blue: hir_core. Yellow: a plugin, one of several that '
        "can do this step. Italic: what is passed on and stored in the run's folder.</text>"
    )
    return "\n".join([*head, *parts, note, "</svg>"]) + "\n"


def _stage(group: tuple[Step, ...], y: int, final: bool) -> list[str]:
    """One box with its steps, and the arrow to the next box."""
    bottom = y + ROW * len(group)
    parts = [f'<rect class="box" x="6" y="{y}" width="{WIDTH - 12}" height="{bottom - y}" rx="6"/>']
    for row, step in enumerate(group):
        baseline = y + ROW * row + 18
        if step.plugin:
            parts.append(
                f'<rect class="plugin" x="{ACTION_X - 8}" y="{y + ROW * row + 2}" '
                f'width="{WIDTH - ACTION_X - 4}" height="{ROW - 4}" rx="4"/>'
            )
        if step.stage:
            parts.append(f'<text class="stage" x="{STAGE_X}" y="{baseline}">{step.stage}</text>')
        parts.append(f'<text x="{ACTION_X}" y="{baseline}">{html.escape(step.action)}</text>')
        parts.append(f'<text class="file" x="{FILE_X}" y="{baseline}">{step.file}</text>')
    if not final:
        parts.append(f'<path class="arrow" marker-end="url(#tip)" d="M{ACTION_X - 16} {bottom}V{bottom + 30}"/>')
    parts.append(f'<text class="value" x="{ACTION_X}" y="{bottom + 21}">{html.escape(group[-1].result)}</text>')
    return parts


if __name__ == "__main__":
    FILE.write_text(picture(), encoding="utf-8")
