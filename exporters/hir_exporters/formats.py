"""The file formats by their name on the command line."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Final

from hir_exporters.errors import ExportError
from hir_exporters.format_options import (
    CubemapConfig,
    EnvironmentConfig,
    GltfConfig,
    HarmonicsConfig,
    ObjConfig,
    UsdConfig,
    UsdzConfig,
)

if TYPE_CHECKING:
    from hir_exporters.exporter import Exporter


@dataclass(frozen=True)
class Format:
    """The exporter of a format and the type of its options."""

    target: str
    """`module:Class`, imported when it is first used."""
    config: type
    summary: str


FORMATS: Final[dict[str, Format]] = {
    "glb": Format("hir_exporters.gltf.gltf_exporter:GlbExporter", GltfConfig, "glTF 2.0 in one binary file."),
    "gltf": Format("hir_exporters.gltf.gltf_exporter:GltfExporter", GltfConfig, "glTF 2.0 with textures as files."),
    "usda": Format("hir_exporters.usd.usd_exporter:UsdExporter", UsdConfig, "USD as text, with textures as files."),
    "usdc": Format("hir_exporters.usd.usd_exporter:UsdExporter", UsdConfig, "USD in binary, with textures as files."),
    "usdz": Format("hir_exporters.usd.usd_exporter:UsdzExporter", UsdzConfig, "USD in one package, for AR Quick Look."),
    "obj": Format(
        "hir_exporters.obj.obj_exporter:ObjExporter", ObjConfig, "Wavefront OBJ with an MTL in its PBR dialect."
    ),
    "hdr": Format(
        "hir_exporters.environment_files.environment_exporters:HdrExporter",
        EnvironmentConfig,
        "The light, Radiance RGBE.",
    ),
    "exr": Format(
        "hir_exporters.environment_files.environment_exporters:ExrExporter",
        EnvironmentConfig,
        "The light, OpenEXR float32.",
    ),
    "ktx": Format(
        "hir_exporters.environment_files.environment_exporters:KtxExporter",
        CubemapConfig,
        "The light, prefiltered, for Filament.",
    ),
    "sh.json": Format(
        "hir_exporters.environment_files.environment_exporters:HarmonicsExporter",
        HarmonicsConfig,
        "The light, 9 spherical harmonics.",
    ),
}


def create_exporter(name: str, config: object = None) -> Exporter:
    """The exporter of a format. `config` is an instance of the format's options; None: its defaults.

    Raises `ExportError` for an unknown format, and for options that are those of another one.
    """
    if name not in FORMATS:
        raise ExportError(f"unknown format {name!r}; known formats are {', '.join(FORMATS)}")
    options = FORMATS[name].config
    if config is not None and not isinstance(config, options):
        found = config.__name__ if isinstance(config, type) else type(config).__name__
        raise ExportError(f"format {name!r} takes an instance of hir_exporters.{options.__name__}; this is {found}")
    from hir_exporters.exporter import Exporter  # imports numpy, which listing the formats does not need

    module, _, attribute = FORMATS[name].target.partition(":")
    exporter = getattr(import_module(module), attribute)(options() if config is None else config)
    assert isinstance(exporter, Exporter)
    return exporter
