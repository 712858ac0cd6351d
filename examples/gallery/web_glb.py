"""An exporter: a small .glb that every viewer opens, without Draco: fewer triangles, smaller JPEG textures.

hir export RUN -f web.glb -o files/ --plugin web_glb.py
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from annotated_types import Interval, Unit
from hir_exporters.exporter import Edit, Exporter, ExportReport
from hir_exporters.format_options import GltfConfig

from hir_core.plugins import Component, hookimpl

if TYPE_CHECKING:
    from hir_exporters.asset import Asset


@dataclass(frozen=True)
class Options:
    """Of web.glb."""

    texture_size: Annotated[int, Interval(ge=16, le=8192), Unit("pixels")] = 1024
    """Larger textures are reduced to this many pixels a side."""
    jpeg_quality: Annotated[int, Interval(ge=1, le=95)] = 85
    """Quality of the colour textures."""
    warn_above: Annotated[float, Interval(gt=0), Unit("MB")] = 5.0
    """The report warns where the file is larger."""


class WebGlb(Exporter):
    """glTF 2.0 with the limits of the web, no compression of geometry, no light beside it."""

    def __init__(self, config: Options) -> None:
        self._config = config

    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        from dataclasses import replace

        from hir_exporters.gltf.gltf_exporter import GlbExporter

        settings = GltfConfig(
            budget="web",
            max_texture_size=self._config.texture_size,
            image_format="jpeg",
            jpeg_quality=self._config.jpeg_quality,
            environment=False,
        )
        report = GlbExporter(settings).write(asset, destination, edit)
        megabytes = destination.stat().st_size / 1e6
        if megabytes <= self._config.warn_above:
            return report
        said = f"{destination.name} has {megabytes:.1f} MB, more than {self._config.warn_above:g}; reduce texture_size"
        return replace(report, warnings=(*report.warnings, said))


@hookimpl
def hir_register_exporters() -> list[Component]:
    return [
        Component(
            name="web.glb",
            target="hir_plugin_web_glb:WebGlb",
            config=Options,
            summary="glTF for web pages: small, and without extensions that a viewer may lack.",
            traits=frozenset({"gltf"}),
        )
    ]
