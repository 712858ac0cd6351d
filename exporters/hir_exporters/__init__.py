"""Asset SDK of `hir`: writes physical assets as glTF, USD, OBJ and environment files. Needs neither torch nor mitsuba.

The public names are imported when they are first used: importing the package alone imports nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from hir_exporters.asset import (
        Asset,
        AssetEnvironment,
        AssetMaterial,
        AssetMesh,
        describe,
        validate_asset,
    )
    from hir_exporters.asset_lamp import AssetLamp
    from hir_exporters.errors import ExportError, HirError, InputError
    from hir_exporters.exporter import Exporter, ExportReport
    from hir_exporters.format_options import (
        CubemapConfig,
        EnvironmentConfig,
        GltfConfig,
        HarmonicsConfig,
        ObjConfig,
        UsdConfig,
        UsdzConfig,
    )
    from hir_exporters.formats import FORMATS, create_exporter
    from hir_exporters.reading.file_verification import verify_file
    from hir_exporters.scene_format import load_scene, save_scene

__all__ = [
    "FORMATS",
    "Asset",
    "AssetEnvironment",
    "AssetLamp",
    "AssetMaterial",
    "AssetMesh",
    "CubemapConfig",
    "EnvironmentConfig",
    "ExportError",
    "ExportReport",
    "Exporter",
    "GltfConfig",
    "HarmonicsConfig",
    "HirError",
    "InputError",
    "ObjConfig",
    "UsdConfig",
    "UsdzConfig",
    "create_exporter",
    "describe",
    "load_scene",
    "save_scene",
    "validate_asset",
    "verify_file",
]

_PUBLIC_NAMES: Final = {
    "asset": ("Asset", "AssetEnvironment", "AssetMaterial", "AssetMesh", "describe", "validate_asset"),
    "errors": ("ExportError", "HirError", "InputError"),
    "exporter": ("Exporter", "ExportReport"),
    "asset_lamp": ("AssetLamp",),
    "format_options": (
        "CubemapConfig",
        "EnvironmentConfig",
        "GltfConfig",
        "HarmonicsConfig",
        "ObjConfig",
        "UsdConfig",
        "UsdzConfig",
    ),
    "formats": ("FORMATS", "create_exporter"),
    "scene_format": ("load_scene", "save_scene"),
    "reading.file_verification": ("verify_file",),
}


def __getattr__(name: str) -> object:
    for module, names in _PUBLIC_NAMES.items():
        if name in names:
            return getattr(import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
