"""The environment as a dome light in a separate layer: AR Quick Look allows no lights inside an asset."""

from __future__ import annotations

from pathlib import PurePosixPath

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
}}
"""


def light_layer(prim: str, asset_file: str, texture_file: str, meters_per_unit: float) -> str:
    """Text of a .usda that references the asset and adds a dome light; all files are in one folder.

    The image is in world axes. UsdLux has the lat-long convention of this project (+Z in the centre): no rotation.
    """
    for file in (asset_file, texture_file):
        assert PurePosixPath(file).name == file and "@" not in file
    light = "Environment" if prim != "Environment" else "EnvironmentLight"
    meters = f"{meters_per_unit:.9g}"
    return _LAYER.format(name=prim, meters=meters, asset=asset_file, light=light, texture=texture_file)
