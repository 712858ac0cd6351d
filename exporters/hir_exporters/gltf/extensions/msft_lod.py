"""MSFT_lod: levels of detail in one file. Readers without the extension show the finest level."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from pygltflib import GLTF2

NAME: Final = "MSFT_lod"


def add_levels(document: GLTF2, triangles: Sequence[int]) -> None:
    """Makes nodes 1, 2 and so on the levels of node 0; `triangles` are the numbers of all nodes, the finest first.

    A level is used down to the coverage of the screen at which the next one has as many pixels a triangle as the finest
    level has on a full screen; the last one is used down to 0.
    """
    coverage = [round(count / triangles[0], 6) for count in triangles[1:]] + [0.0]
    node = document.nodes[0]
    node.extensions = {**(node.extensions or {}), NAME: {"ids": list(range(1, len(triangles)))}}
    node.extras = {**(node.extras or {}), "MSFT_screencoverage": coverage}
    document.extensionsUsed.append(NAME)
