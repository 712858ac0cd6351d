"""Extensions that a glTF document requires: a reader that does not know one must not read the file (section 3.12)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from hir_exporters.errors import InputError

_KNOWN: Final = frozenset(
    {
        "EXT_lights_image_based",
        "EXT_meshopt_compression",
        "EXT_texture_webp",
        "KHR_draco_mesh_compression",
        "KHR_lights_punctual",
        "KHR_mesh_quantization",
        "KHR_texture_basisu",
        "KHR_texture_transform",
        "KHR_xmp_json_ld",
        "MSFT_lod",
        "MSFT_screencoverage",
    }
)
_MATERIALS: Final = "KHR_materials_"
"""Extensions of materials that are not read are named in a warning."""


def check_required_extensions(document: Mapping[str, Any], path: Path) -> None:
    """Raises `InputError` naming the first required extension that is not read."""
    for name in document.get("extensionsRequired") or []:
        if name not in _KNOWN and not str(name).startswith(_MATERIALS):
            raise InputError(
                f"{path} requires the glTF extension {str(name)[:80]}, which is not supported; export it without"
            )
