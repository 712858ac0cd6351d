"""The asset inside the report: the page that a plugin offers for it, compressed, in a frame of its own."""

from __future__ import annotations

import base64
import gzip

from hir_core.plugins.manager import PluginManager
from hir_core.run.run_directory import RunDirectory

CHANNELS = {"lit": "lit", "albedo": "albedo", "specular": "specular", "roughness": "roughness", "normals": "normals"}


def viewer(directory: RunDirectory, plugins: PluginManager) -> str:
    """The frame, its buttons and the compressed page; a sentence where there is no finished asset or no viewer."""
    if not (directory.scene / "scene.json").is_file():
        return "<p class=quiet>The asset is not finished.</p>"
    page = plugins.asset_page(directory.path)
    if page is None:
        return "<p class=quiet>No installed plugin shows assets in a page.</p>"
    packed = base64.b64encode(gzip.compress(page.encode(), 6, mtime=0))
    buttons = "".join(
        f'<button type=button data-channel="{name}"{" class=chosen" if name == "lit" else ""}>{label}</button>'
        for name, label in CHANNELS.items()
    )
    return (
        '<iframe id=model title="the asset; drag to turn it" loading=eager></iframe>'
        f"<div class=channels>{buttons}<button type=button id=wires>wireframe</button></div>"
        f'<script type="application/octet-stream" id=packed-model>{packed.decode("ascii")}</script>'
    )
