"""Checks what an initializer of a plugin returned, before a stage works with it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hir_core.capture import Capture
from hir_core.errors import PluginError
from hir_core.plugins.interfaces import Initializer
from hir_core.plugins.registration import a_value
from hir_core.scene import Scene
from hir_core.scene.scan import Scan


def checked_result(returned: object, owner: str) -> tuple[Capture, Scene | None]:
    """Capture and scene that `initialize` returned; `PluginError` names the initializer and what it should return."""
    if not isinstance(returned, tuple) or len(returned) != 2:
        raise PluginError(f"{owner} returned {a_value(returned)} from initialize; return capture, scene")
    capture, scene = returned
    if not isinstance(capture, Capture) or not isinstance(scene, Scene | None):
        raise PluginError(
            f"{owner} returned {a_value(capture)} and {a_value(scene)} from initialize; return a Capture, and a Scene "
            "or None"
        )
    if scene is not None:
        faces, count = scene.mesh.faces, len(scene.mesh.positions)
        if len(faces) and (int(faces.min()) < 0 or int(faces.max()) >= count):
            raise PluginError(
                f"{owner} returned triangles with the vertices {int(faces.min())} … {int(faces.max())} of a mesh that "
                f"has {count}; the first vertex is 0"
            )
    return capture, scene


def checked_report(initializer: Initializer, owner: str) -> dict[str, Any]:
    """The entries of `report()`."""
    report: object = initializer.report()
    if not isinstance(report, Mapping):
        raise PluginError(f"{owner} returned {a_value(report)} from report; return a dict")
    return dict(report)


def checked_scan(initializer: Initializer, owner: str) -> Scan | None:
    """The scan of `scan()`, or None."""
    scan: object = initializer.scan()
    if scan is not None and not isinstance(scan, Scan):
        raise PluginError(f"{owner} returned {a_value(scan)} from scan; return a Scan or None")
    return scan
