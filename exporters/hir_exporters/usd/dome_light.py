"""The environment as a dome light in a separate layer: AR Quick Look allows no lights inside an asset."""

from __future__ import annotations

from pathlib import PurePosixPath

from hir_exporters.light.light_split import LightSplit, rotation_to

_LAYER = """#usda 1.0
(
    doc = "The asset in the light it was seen under."
    defaultPrim = "World"
    metersPerUnit = {meters}
    upAxis = "Y"
)

def Xform "World" (
    kind = "assembly"
)
{{
    def Xform "{name}" (
        kind = "component"
        references = @./{asset}@
    )
    {{
    }}

    def DomeLight "{light}"
    {{
        float inputs:intensity = 1
        asset inputs:texture:file = @./{texture}@
        token inputs:texture:format = "latlong"
    }}
{lights}}}
"""

_DISTANT_LIGHT = """
    def DistantLight "{name}"
    {{
        float inputs:angle = 0.53
        color3f inputs:color = ({color})
        float inputs:intensity = {intensity}
        bool inputs:normalize = 1
        quatf xformOp:orient = ({orientation})
        uniform token[] xformOpOrder = ["xformOp:orient"]
    }}
"""


def light_layer(prim: str, asset_file: str, texture_file: str, meters_per_unit: float, lights: str = "") -> str:
    """Text of a .usda that references the asset and adds a dome light; all files are in one folder.

    `lights` are further prims, those of `distant_lights`. The image is in world axes. UsdLux has the lat-long
    convention of this project (+Z in the centre): no rotation.
    """
    for file in (asset_file, texture_file):
        assert PurePosixPath(file).name == file and "@" not in file
    light = "Environment" if prim != "Environment" else "EnvironmentLight"
    meters = f"{meters_per_unit:.9g}"
    return _LAYER.format(name=prim, meters=meters, asset=asset_file, light=light, texture=texture_file, lights=lights)


def distant_lights(split: LightSplit) -> str:
    """Text of the prims of a split's lights. Normalised: the intensity is the irradiance on a surface that faces it."""
    prims = []
    for index, (toward, irradiance) in enumerate(zip(split.directions, split.irradiance, strict=True)):
        largest = float(irradiance.max())
        x, y, z, w = rotation_to(toward)
        prims.append(
            _DISTANT_LIGHT.format(
                name=f"Light_{index}",
                color=", ".join(f"{value:.9g}" for value in irradiance / largest),
                intensity=f"{largest:.9g}",
                orientation=", ".join(f"{value:.9g}" for value in (w, x, y, z)),
            )
        )
    return "".join(prims)
