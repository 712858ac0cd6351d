"""Errors of the texture that a scan had before its run, in the views of an evaluation: what the new asset is beside."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.textures.image_files import read_exr, write_exr, write_png
from numpy.typing import NDArray

from hir_core.metrics import OBJECT_COVERAGE, ChannelScale, Image, composite, mean, psnr, unassociate
from hir_core.rendering.photographs import MaskedPhotograph, masked_photograph
from hir_core.rendering.reference_renderer import render_view
from hir_core.rendering.textured_scan import textured_scan
from hir_core.rendering.unlit_renderer import UnlitRenderer

if TYPE_CHECKING:
    from hir_core.capture import Capture
    from hir_core.plugins.interfaces import ReflectanceRenderer
    from hir_core.run.finished_run import FinishedRun
    from hir_core.scene import EnvironmentMap

Exposure = Callable[[Image, MaskedPhotograph, NDArray[np.bool_]], NDArray[np.float64]]
"""From a render, its photograph and the compared pixels to a factor for each channel."""


def scan_texture_figures(
    run: FinishedRun,
    capture: Capture,
    names: list[str],
    folder: Path,
    light: EnvironmentMap | None,
    renderer: ReflectanceRenderer,
    exposure: Exposure | None,
) -> dict[str, Any]:
    """The entry `scan_texture` of the result: PSNR of the views after one factor per channel; empty without a texture.

    Under `light`, with the material of a texture that has no other maps; without a light the texture alone, which holds
    the light of the photographs. `names` are those of the views' files in `folder`. `exposure` is given where each
    view is compared at its own exposure.
    """
    scan = textured_scan(run.directory.stage("initializer"), light, str(run.scene.mesh.positions.device))
    if scan is None:
        return {}
    unlit = UnlitRenderer(scan) if light is None else None
    scale = ChannelScale()
    for view, camera, name in zip(capture.views, capture.cameras, names, strict=True):
        image = render_view(renderer, scan, camera, view.name) if unlit is None else unlit.render(camera)
        photograph = masked_photograph(view)
        inside = (photograph.mask > OBJECT_COVERAGE) & ~photograph.saturated
        if exposure is not None:
            image[..., :3] *= exposure(image, photograph, inside)
        scale.add(unassociate(image)[0][inside], photograph.color_linear[inside])
        write_exr(folder / f"{name}_scan.exr", image)
    pairs: list[tuple[float | None, float | None]] = []
    for view, name in zip(capture.views, names, strict=True):
        photograph = masked_photograph(view)
        color, coverage = unassociate(read_exr(folder / f"{name}_scan.exr"))
        picture = composite((color * scale.value).astype(np.float32), coverage)
        write_png(folder / f"{name}_scan.png", picture)
        on_object = photograph.mask > OBJECT_COVERAGE
        pairs.append((psnr(picture, photograph.picture), psnr(picture, photograph.picture, on_object)))
    frame, on_object_only = zip(*pairs, strict=True)
    return {
        "scan_texture": {
            "lit": light is not None,
            "psnr_scaled": {"frame": mean(list(frame)), "object": mean(list(on_object_only))},
            "scale": scale.value.tolist(),
        }
    }
