"""`hir view`: one HTML file that displays an asset in three.js and loads nothing from the network."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np
from hir_exporters.light.environment_map import resample_latlong
from hir_exporters.textures.rgbe import encode_rgbe
from jinja2 import Environment, StrictUndefined
from markupsafe import Markup

from hir_plugins.commands.viewer.displayed_asset import Radiance, load_displayed_asset, read_light
from hir_plugins.commands.viewer.run_photographs import PagePhotograph, first_camera_direction, run_photographs
from hir_plugins.commands.viewer.three_modules import (
    MODULES,
    module_source,
    page_folder,
    three_licence,
    three_version,
)

MAX_LIGHT_ROWS: Final = 256
"""Larger environment maps are downsampled: three.js prefilters the light at a lower resolution anyway."""


def view_page(source: Path, light: Path | None = None, photographs: bool = True) -> str:
    """The page for a run directory, a scene folder or an exported file.

    `light` is a lat-long .hdr or .exr file that replaces the asset's own light. With `photographs`, the page of a run
    contains the run's photographs for comparison. Raises `InputError` if the source cannot be displayed.
    """
    asset = load_displayed_asset(source, other_light=light is not None)
    radiance = asset.radiance if light is None else read_light(light)
    pictures = run_photographs(source) if photographs else []
    embedded = {module.name: module_source(module) for module in MODULES} | {"asset.glb": asset.glb}
    if radiance is not None:
        embedded["light.hdr"] = _encoded_light(radiance)
    embedded |= {f"photograph {number}": picture.png for number, picture in enumerate(pictures)}
    settings = {
        "title": asset.title,
        "photographs": [_photograph_settings(number, picture) for number, picture in enumerate(pictures)],
        "initialDirection": first_camera_direction(source),
        "modules": [{"name": module.name, "imports": dict(module.imports)} for module in MODULES],
    }
    return _render(asset.title, settings, embedded)


def _render(title: str, settings: Mapping[str, object], embedded: Mapping[str, bytes]) -> str:
    # only our own files are marked as safe; the title, the settings and the names are escaped
    def own(name: str) -> Markup:
        return Markup((page_folder() / name).read_text(encoding="utf-8"))

    template = Environment(autoescape=True, undefined=StrictUndefined).from_string(own("page.html"))
    return template.render(
        title=title,
        css=own("page.css"),
        boot=own("boot.js"),
        settings=Markup(json.dumps(settings).replace("<", "\\u003c")),
        three_version=three_version(),
        three_licence=Markup(three_licence()),
        embedded={name: _packed(content) for name, content in embedded.items()},
    )


def _photograph_settings(number: int, photograph: PagePhotograph) -> dict[str, object]:
    return {
        "name": photograph.name,
        "part": f"photograph {number}",
        "width": photograph.width,
        "height": photograph.height,
        "fovYDeg": photograph.fov_y_deg,
        "offset": photograph.offset,
        "cameraToWorld": photograph.camera_to_world,
    }


def _encoded_light(radiance: Radiance) -> bytes:
    if radiance.shape[0] > MAX_LIGHT_ROWS:
        radiance = resample_latlong(radiance, MAX_LIGHT_ROWS, 2 * MAX_LIGHT_ROWS)
    return encode_rgbe(np.asarray(radiance, np.float32))


def _packed(content: bytes) -> str:
    return base64.b64encode(gzip.compress(content, 9, mtime=0)).decode("ascii")
