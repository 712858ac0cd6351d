"""The asset inside the report: the page of a viewer plugin, compressed, in a frame of its own."""

from __future__ import annotations

import base64
import gzip

from markupsafe import Markup

from hir_core.plugins.manager import PluginManager
from hir_core.report.page_templates import render
from hir_core.report.tables import notice
from hir_core.run.run_directory import RunDirectory

CHANNELS = ("lit", "albedo", "specular", "roughness", "normals")
"""What the viewer can show; the first is shown at the start."""


def viewer(directory: RunDirectory, plugins: PluginManager) -> Markup:
    """The frame, its buttons and the compressed page; a sentence where there is no finished asset or no viewer."""
    if not (directory.scene / "scene.json").is_file():
        return notice("The asset is not finished.")
    page = plugins.asset_page(directory.path)
    if page is None:
        return notice("No installed plugin provides a viewer page.")
    packed = base64.b64encode(gzip.compress(page.encode(), 6, mtime=0)).decode("ascii")
    return render("viewer.html", channels=CHANNELS, packed=packed)
