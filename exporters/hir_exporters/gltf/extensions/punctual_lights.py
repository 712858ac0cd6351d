"""KHR_lights_punctual: the brightest parts of the light as lights in the file (profile `engine`).

Intensities are in the unit of the environment: its radiance is taken for nits, so that irradiance is lux. three.js,
Babylon.js and Filament with an exposure of 1 do so, too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, Literal

import numpy as np

from hir_exporters.asset import AssetMesh
from hir_exporters.light.light_split import LightSplit, rotation_to

if TYPE_CHECKING:
    from pygltflib import GLTF2

NAME: Final = "KHR_lights_punctual"

POINT_DISTANCE: Final = 100.0
"""Distance of point lights from the object's centre, in bounding radii: directions vary by at most 0.6 degrees."""

POINT_RANGE: Final = 10.0
"""`range` of point lights, in their distance. Without a range Filament's loader ends the light near to it; here the
window of the extension's formula takes 0.01 % at the object."""


def add_lights(
    document: GLTF2, split: LightSplit, light_type: Literal["directional", "point"], mesh: AssetMesh
) -> None:
    """Adds one node with a light for each light of the split to the document's scene."""
    from pygltflib import Node

    if not len(split.directions):
        return
    low, high = mesh.positions.min(axis=0).astype(np.float64), mesh.positions.max(axis=0).astype(np.float64)
    distance = POINT_DISTANCE * max(float(np.linalg.norm(high - low)) / 2, 1e-6)
    lights = []
    for index, (toward, irradiance) in enumerate(zip(split.directions, split.irradiance, strict=True)):
        largest, name = float(irradiance.max()), f"light_{index}"
        light: dict[str, object] = {"name": name, "type": light_type, "color": (irradiance / largest).tolist()}
        node = Node(name=name, extensions={NAME: {"light": index}})
        if light_type == "directional":
            light["intensity"] = largest
            node.rotation = rotation_to(toward)
        else:
            light |= {"intensity": largest * distance**2, "range": POINT_RANGE * distance}
            node.translation = ((low + high) / 2 + distance * toward).tolist()
        lights.append(light)
        document.scenes[0].nodes.append(len(document.nodes))
        document.nodes.append(node)
    document.extensions = {**(document.extensions or {}), NAME: {"lights": lights}}
    document.extensionsUsed.append(NAME)
