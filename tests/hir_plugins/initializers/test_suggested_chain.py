"""The chain of initializers that is suggested for a capture."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from hir_core.testing.captures import tiny_capture
from hir_plugins.initializers.plugin import hir_suggest_initializers


@pytest.mark.parametrize(
    ("bare", "chain"),
    [
        ((0,), ["camera_refinement", "visual_hull"]),
        ((0, 1, 2, 3), ["camera_refinement", "visual_hull"]),
        ((3, 4, 5, 6, 7), ["colmap", "visual_hull"]),
    ],
)
def test_the_chain_depends_on_the_masks_of_most_photographs(
    tmp_path: Path, bare: tuple[int, ...], chain: list[str]
) -> None:
    """Photographs without a mask are left out where at least half have one; which these are does not matter."""
    tiny = tiny_capture(tmp_path, views=8, size=32)
    unmasked = tiny.without_masks().views
    views = tuple(unmasked[i] if i in bare else view for i, view in enumerate(tiny.capture.views))
    assert hir_suggest_initializers(replace(tiny.capture, views=views, points=None)) == chain
