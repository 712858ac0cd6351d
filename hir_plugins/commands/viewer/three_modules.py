"""The JavaScript modules of the viewer's page: three.js, minified by tools/copy_three.py, and the viewer's own."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from importlib.resources.abc import Traversable
from typing import Final


@dataclass(frozen=True)
class PageModule:
    """One module and what its import statements name: specifier → name of a module before it in `MODULES`."""

    name: str
    imports: Mapping[str, str] = field(default_factory=dict)

    @property
    def path(self) -> str:
        """Where it lies in the page's folder."""
        return self.name if self.name == "viewer.js" else f"three/{self.name}"


_THREE: Final = {"three": "three.module.min.js"}

MODULES: Final = (
    PageModule("three.core.min.js"),
    PageModule("three.module.min.js", {"./three.core.js": "three.core.min.js"}),
    PageModule("BufferGeometryUtils.min.js", _THREE),
    PageModule("SkeletonUtils.min.js", _THREE),
    PageModule(
        "GLTFLoader.min.js",
        {
            **_THREE,
            "../utils/BufferGeometryUtils.js": "BufferGeometryUtils.min.js",
            "../utils/SkeletonUtils.js": "SkeletonUtils.min.js",
        },
    ),
    PageModule("HDRLoader.min.js", _THREE),
    PageModule("OrbitControls.min.js", _THREE),
    PageModule(
        "viewer.js",
        {
            **_THREE,
            "GLTFLoader": "GLTFLoader.min.js",
            "HDRLoader": "HDRLoader.min.js",
            "OrbitControls": "OrbitControls.min.js",
        },
    ),
)
"""A module stands after the modules that it imports."""


def page_folder() -> Traversable:
    """The folder of the page's template, style sheet and scripts."""
    return files("hir_plugins.commands.viewer") / "page"


def module_source(module: PageModule) -> bytes:
    """The text of a module, UTF-8."""
    return (page_folder() / module.path).read_bytes()


def three_version() -> str:
    """The release of three.js that the page contains."""
    manifest = json.loads((page_folder() / "three" / "manifest.json").read_text(encoding="utf-8"))
    return str(manifest["three"])


def three_licence() -> str:
    """The licence of three.js, which has to stand in every copy."""
    return (page_folder() / "three" / "LICENSE").read_text(encoding="utf-8")
