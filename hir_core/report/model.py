"""The asset in three.js inside the report: the page of `hir view`, packed, opened in a frame of its own."""

from __future__ import annotations

import base64
import gzip

from hir_core.run_directory import RunDirectory
from hir_core.view import view_page

CHANNELS = {"lit": "lit", "albedo": "albedo", "specular": "specular", "roughness": "roughness", "normals": "normals"}


def viewer(directory: RunDirectory) -> str:
    """The frame, its buttons and the packed page; a sentence where there is no finished asset."""
    if not (directory.scene / "scene.json").is_file():
        return "<p class=quiet>The asset is not finished.</p>"
    packed = base64.b64encode(gzip.compress(view_page(directory.path, photographs=False).encode(), 6, mtime=0))
    buttons = "".join(
        f'<button type=button data-channel="{name}"{" class=chosen" if name == "lit" else ""}>{label}</button>'
        for name, label in CHANNELS.items()
    )
    return (
        '<iframe id=model title="the asset; drag to turn it" loading=eager></iframe>'
        f"<div class=channels>{buttons}<button type=button id=wires>wireframe</button></div>"
        f'<script type="application/octet-stream" id=packed-model>{packed.decode("ascii")}</script>'
    )
