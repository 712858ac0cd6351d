"""The material as OpenPBR 1.1 (MaterialX 1.39) in a separate layer: usd-core knows no `ND_*` shader of MaterialX.

OpenPBR's base, metalness, roughness and ior are those of UsdPreviewSurface's metallic workflow, and it uses the same
textures. Its lobe includes multiple scattering, and its non-metal has the exact Fresnel term instead of Schlick's.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Final

from hir_exporters.usd.preview_surface import UsdSurface

if TYPE_CHECKING:
    from pxr import Sdf, UsdShade

MATERIALX_VERSION: Final = "1.39"

_IMAGES: Final = {"base_color": "color3", "occlusion_roughness_metallic": "color3", "normal": "vector3"}


def openpbr_layer(
    surface: UsdSurface, prim: str, asset_file: str, textures: Mapping[str, str], meters_per_unit: float
) -> Sdf.Layer:
    """A layer that sublayers the asset's file and adds the render context `mtlx` to its material.

    `surface` must have the metallic workflow.
    """
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

    assert surface.workflow == "metallic"
    stage, types = Usd.Stage.CreateInMemory(), Sdf.ValueTypeNames
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    root = stage.OverridePrim(f"/{prim}")
    stage.SetDefaultPrim(root)
    material = UsdShade.Material.Define(stage, root.GetPath().AppendChild("Material"))
    material.GetPrim().CreateAttribute("config:mtlx:version", types.String, custom=True).Set(MATERIALX_VERSION)

    def node(name: str, identifier: str) -> UsdShade.Shader:
        shader = UsdShade.Shader.Define(stage, material.GetPath().AppendChild(f"OpenPBR{name}"))
        shader.CreateIdAttr(identifier)
        return shader

    shader = node("", "ND_open_pbr_surface_surfaceshader")
    shader.CreateInput("base_color", types.Color3f).Set(Gf.Vec3f(*surface.diffuse))
    shader.CreateInput("base_metalness", types.Float).Set(surface.metallic)
    shader.CreateInput("specular_roughness", types.Float).Set(surface.roughness)
    shader.CreateInput("specular_ior", types.Float).Set(surface.ior)
    material.CreateSurfaceOutput("mtlx").ConnectToSource(shader.CreateOutput("out", types.Token))
    if textures:
        coordinates = node("Coordinates", "ND_geompropvalue_vector2")
        coordinates.CreateInput("geomprop", types.String).Set("st")
        uv = coordinates.CreateOutput("out", types.Float2)

    def image(name: str) -> UsdShade.Output:
        kind = _IMAGES[name]
        texture = node("".join(part.title() for part in name.split("_")), f"ND_image_{kind}")
        file = texture.CreateInput("file", types.Asset)
        file.Set(Sdf.AssetPath(textures[name]))
        file.GetAttr().SetColorSpace("srgb_texture" if name == "base_color" else "raw")
        texture.CreateInput("texcoord", types.Float2).ConnectToSource(uv)
        return texture.CreateOutput("out", types.Color3f if kind == "color3" else types.Vector3f)

    if "base_color" in textures:
        shader.GetInput("base_color").ConnectToSource(image("base_color"))
    if "occlusion_roughness_metallic" in textures:
        channels = node("Channels", "ND_separate3_color3")
        channels.CreateInput("in", types.Color3f).ConnectToSource(image("occlusion_roughness_metallic"))
        for name, channel, textured in (
            ("specular_roughness", "outg", surface.roughness_textured),
            ("base_metalness", "outb", surface.metallic_textured),
        ):
            if textured:
                shader.GetInput(name).ConnectToSource(channels.CreateOutput(channel, types.Float))
    if "normal" in textures:
        normal = node("NormalMap", "ND_normalmap_float")
        normal.CreateInput("in", types.Vector3f).ConnectToSource(image("normal"))
        mapped = normal.CreateOutput("out", types.Vector3f)
        shader.CreateInput("geometry_normal", types.Vector3f).ConnectToSource(mapped)
    # An anonymous layer without a stage does not try to open the sublayer, which may not exist yet.
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.TransferContent(stage.GetRootLayer())
    layer.subLayerPaths.append(f"./{asset_file}")
    return layer
