"""The file formats by their name on the command line."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
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
    libraries: tuple[str, ...] = ()
    """Third-party modules that the exporter imports when it writes."""


_GLTF, _USD = ("pygltflib",), ("pxr.Usd", "pxr.UsdGeom", "pxr.UsdShade")

FORMATS: Final[dict[str, Format]] = {
    "glb": Format("hir_exporters.gltf.gltf_exporter:GlbExporter", GltfConfig, "glTF 2.0 in one binary file.", _GLTF),
    "gltf": Format(
        "hir_exporters.gltf.gltf_exporter:GltfExporter", GltfConfig, "glTF 2.0 with textures as files.", _GLTF
    ),
    "usda": Format(
        "hir_exporters.usd.usd_exporter:UsdExporter", UsdConfig, "USD as text, with textures as files.", _USD
    ),
    "usdc": Format(
        "hir_exporters.usd.usd_exporter:UsdExporter", UsdConfig, "USD in binary, with textures as files.", _USD
    ),
    "usdz": Format(
        "hir_exporters.usd.usd_exporter:UsdzExporter", UsdzConfig, "USD in one package, for AR Quick Look.", _USD
    ),
    "obj": Format(
        "hir_exporters.obj.obj_exporter:ObjExporter", ObjConfig, "Wavefront OBJ with an MTL in its PBR dialect."
    ),
    "hdr": Format(
        "hir_exporters.light.environment_exporters:HdrExporter", EnvironmentConfig, "The light, Radiance RGBE."
    ),
    "exr": Format(
        "hir_exporters.light.environment_exporters:ExrExporter", EnvironmentConfig, "The light, OpenEXR float32."
    ),
    "ktx": Format(
        "hir_exporters.light.environment_exporters:KtxExporter", CubemapConfig, "The light, prefiltered, for Filament."
    ),
    "sh.json": Format(
        "hir_exporters.light.environment_exporters:HarmonicsExporter",
        HarmonicsConfig,
        "The light, 9 spherical harmonics.",
    ),
}


def create_exporter(name: str, config: object = None) -> Exporter:
    """The exporter of a format. `config` is an instance of the format's options; None: its defaults.

    Raises `ExportError` for an unknown format.
    """
    if name not in FORMATS:
        raise ExportError(f"unknown format {name!r}; known formats are {', '.join(FORMATS)}")
    from hir_exporters.exporter import Exporter  # imports numpy, which listing the formats does not need

    module, _, attribute = FORMATS[name].target.partition(":")
    exporter = getattr(import_module(module), attribute)(FORMATS[name].config() if config is None else config)
    assert isinstance(exporter, Exporter)
    return exporter


def preload_exporters(names: Iterable[str]) -> None:
    """Imports the modules that writing these formats needs; unknown formats and missing modules are skipped.

    A program can call this while another thread reads the asset: image decoders release the interpreter lock.
    """
    for name in names:
        if name in FORMATS:
            for module in (FORMATS[name].target.partition(":")[0], *FORMATS[name].libraries):
                with suppress(ImportError):
                    import_module(module)
