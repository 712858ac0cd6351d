"""What the contract tests of initializers need to know (`Component.testing`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_core.capture import Capture

if TYPE_CHECKING:
    from hir_core.testing.captures import TinyCapture


def object_mesh_file(truth: TinyCapture, given: Capture, folder: Path) -> tuple[Capture, dict[str, Any]]:
    """The true surface as a file, in the axes of the capture's own files."""
    import trimesh

    from hir_core.testing.captures import BALLS

    del truth
    balls = [trimesh.creation.icosphere(3, radius).apply_translation(centre) for centre, radius in BALLS]
    # of two balls that meet, what lies inside of the other one is not surface
    kept = []
    for ball, (centre, radius) in zip(balls, reversed(BALLS), strict=True):
        outside = ((ball.triangles_center - centre) ** 2).sum(axis=1) > radius**2
        kept.append(ball.submesh([outside.nonzero()[0]], append=True))
    trimesh.util.concatenate(kept).export(folder / "object.ply")
    return given, {"path": str(folder / "object.ply"), "axes": "source"}


def without_masks(truth: TinyCapture, given: Capture, folder: Path) -> tuple[Capture, dict[str, Any]]:
    """Photographs, cameras and oriented points alone."""
    del given, folder
    return truth.without_masks(), {}
