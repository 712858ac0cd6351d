"""The file formats by the name they have on the command line."""

from __future__ import annotations

from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

from hir_exporters.configs import (
    CubeConfig,
    EnvironmentConfig,
    GltfConfig,
    HarmonicsConfig,
    ObjConfig,
    UsdConfig,
    UsdzConfig,
)
from hir_exporters.errors import ExportError

if TYPE_CHECKING:
    from hir_exporters.exporter import Exporter


@dataclass(frozen=True)
class Format:
    """Where the exporter of a format is found and what it is configured with."""

    target: str
    """`module:Class`, imported when it is used."""
    config: type
    summary: str
    libraries: tuple[str, ...] = ()
    """Modules of others that writing it needs, imported when something is written."""


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
        "hir_exporters.light.environment_exporters:KtxExporter", CubeConfig, "The light, prefiltered, for Filament."
    ),
    "dds": Format(
        "hir_exporters.light.environment_exporters:DdsExporter", CubeConfig, "The light, prefiltered, as a cubemap."
    ),
    "sh.json": Format(
        "hir_exporters.light.environment_exporters:HarmonicsExporter",
        HarmonicsConfig,
        "The light, 9 spherical harmonics.",
    ),
}


def create_exporter(name: str, config: Any = None) -> Exporter:
    """The exporter of a format, with its default options where `config` is None.

    Raises `ExportError` for a format that is not known and names those that are.
    """
    if name not in FORMATS:
        raise ExportError(f"no format is called {name!r}; known are {', '.join(FORMATS)}")
    from hir_exporters.exporter import Exporter  # numpy comes with it: not before something is written

    module, _, attribute = FORMATS[name].target.partition(":")
    exporter = getattr(import_module(module), attribute)(FORMATS[name].config() if config is None else config)
    assert isinstance(exporter, Exporter)
    return exporter


def preload_exporters(names: Iterable[str]) -> None:
    """Imports now what writing these formats will need; what is not installed, or no format of ours, is passed over.

    For programs that read their asset in another thread meanwhile: decoders leave the interpreter to this one.
    """
    for name in names:
        if name in FORMATS:
            for module in (FORMATS[name].target.partition(":")[0], *FORMATS[name].libraries):
                with suppress(ImportError):
                    import_module(module)
