"""What a .glb has that the viewer's page does not show, though it loads the file."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from hir_exporters.reading.mesh_references import gltf_content, uris

from hir_plugins.commands.viewer.three_modules import MODULES, module_source

_LOADER: Final = next(module for module in MODULES if module.name.startswith("GLTFLoader"))
_INVISIBLE: Final = ("KHR_xmp_json_ld", "MSFT_lod", "MSFT_screencoverage")
_LIGHT: Final = "EXT_lights_image_based"


def warn_of_unshown_features(path: Path, with_light: bool) -> None:
    """One warning that names them; `with_light`: the page has another light than that in the file."""
    found = list(dict.fromkeys(_unshown_features(gltf_content(path)[0], with_light)))
    if found:
        warnings.warn(
            f"{path} is shown without {', '.join(found)}, which the page cannot show; bake what should be visible, or "
            "open the file in the program that made it",
            stacklevel=3,
        )


def _unshown_features(document: Mapping[str, Any], with_light: bool) -> Iterator[str]:
    used = document.get("extensionsUsed")
    readable = module_source(_LOADER)
    for name in map(str, used if isinstance(used, list) else ()):
        if name.encode() not in readable and name not in _INVISIBLE and not (name == _LIGHT and with_light):
            yield name[:80]
    if document.get("animations"):
        yield "animations"
    for uri in uris(dict(document)):
        if not uri.startswith("data:"):
            yield f"the file {uri[:80]!r} beside it"
