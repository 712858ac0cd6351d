"""Converts a material to a UsdPreviewSurface network with its textures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMaterial
from hir_exporters.materials.material_conversion import to_specular_workflow, to_usd_metallic
from hir_exporters.materials.texture_packing import pack_color, pack_normal, pack_surface

if TYPE_CHECKING:
    from pxr import Sdf, Usd, UsdShade

Image8 = NDArray[np.uint8]


@dataclass(frozen=True)
class UsdSurface:
    """Inputs of a UsdPreviewSurface: constants, and the images that replace them."""

    workflow: Literal["metallic", "specular"]
    diffuse: tuple[float, float, float]
    specular: tuple[float, float, float]
    metallic: float
    roughness: float
    ior: float
    images: dict[str, Image8]
    """Those of `base_color`, `specular_color` (both sRGB), `occlusion_roughness_metallic`, `normal` that are used."""
    metallic_textured: bool
    roughness_textured: bool
    residual: float
    warnings: tuple[str, ...]


MIN_SPECULAR_GAIN: Final = 0.005
"""`auto` chooses the specular workflow only if it reduces the relative error on the BRDF slice by more than this.

Some importers, Blender's among them, ignore `useSpecularWorkflow`: a metal in this workflow is black there.
"""


def usd_surface(material: AssetMaterial, workflow: Literal["auto", "metallic", "specular"]) -> UsdSurface:
    """The material in a workflow, with its images packed to 8 bits."""
    images: dict[str, Image8 | None]
    if workflow == "auto":
        gain = to_usd_metallic(material).residual - to_specular_workflow(material).residual
        workflow = "specular" if gain > MIN_SPECULAR_GAIN else "metallic"
    if workflow == "metallic":
        converted = to_usd_metallic(material)
        packed = pack_surface(converted, material.normal)
        images = {
            "base_color": packed.base_color_image,
            "occlusion_roughness_metallic": packed.orm_image,
            "normal": packed.normal_image,
        }
        return UsdSurface(
            workflow,
            packed.base_color,
            (0, 0, 0),
            packed.metallic,
            packed.roughness,
            packed.ior,
            _present(images),
            packed.metallic_textured,
            packed.roughness_textured,
            converted.residual,
            converted.warnings,
        )
    surface = to_specular_workflow(material)
    diffuse, diffuse_image = pack_color(surface.diffuse)
    specular, specular_image = pack_color(surface.specular)
    roughness_image = None
    if surface.roughness.ndim == 2:
        plane = np.rint(np.clip(surface.roughness, 0, 1) * 255).astype(np.uint8)
        roughness_image = np.stack([np.full_like(plane, 255), plane, np.zeros_like(plane)], axis=-1)
    images = {
        "base_color": diffuse_image,
        "specular_color": specular_image,
        "occlusion_roughness_metallic": roughness_image,
        "normal": pack_normal(material.normal),
    }
    roughness = float(surface.roughness) if surface.roughness.ndim == 0 else 1.0
    return UsdSurface(
        workflow,
        diffuse,
        specular,
        0.0,
        roughness,
        1.5,
        _present(images),
        False,
        surface.roughness.ndim == 2,
        surface.residual,
        surface.warnings,
    )


def add_material(
    surface: UsdSurface, stage: Usd.Stage, path: Sdf.Path, textures: Mapping[str, str]
) -> UsdShade.Material:
    """Adds a material whose surface output is a UsdPreviewSurface with constants and textures as inputs."""
    from pxr import Gf, Sdf, UsdShade

    types = Sdf.ValueTypeNames
    material = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path.AppendChild("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    specular = surface.workflow == "specular"
    shader.CreateInput("useSpecularWorkflow", types.Int).Set(int(specular))
    shader.CreateInput("diffuseColor", types.Color3f).Set(Gf.Vec3f(*surface.diffuse))
    shader.CreateInput("roughness", types.Float).Set(surface.roughness)
    shader.CreateInput("ior", types.Float).Set(surface.ior)
    if specular:
        shader.CreateInput("specularColor", types.Color3f).Set(Gf.Vec3f(*surface.specular))
    else:
        shader.CreateInput("metallic", types.Float).Set(surface.metallic)
    output = shader.CreateOutput("surface", types.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)
    if textures:
        _connect_textures(surface, shader, material, textures)
    return material


def _connect_textures(
    surface: UsdSurface, shader: UsdShade.Shader, material: UsdShade.Material, textures: Mapping[str, str]
) -> None:
    from pxr import Gf, Sdf, UsdShade

    types, stage, path = Sdf.ValueTypeNames, material.GetPrim().GetStage(), material.GetPath()
    reader = UsdShade.Shader.Define(stage, path.AppendChild("TextureCoordinates"))
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", types.String).Set("st")
    coordinates = reader.CreateOutput("result", types.Float2)

    def texture(name: str, color_space: str) -> UsdShade.Shader:
        node = UsdShade.Shader.Define(stage, path.AppendChild("".join(part.title() for part in name.split("_"))))
        node.CreateIdAttr("UsdUVTexture")
        node.CreateInput("file", types.Asset).Set(Sdf.AssetPath(textures[name]))
        node.CreateInput("sourceColorSpace", types.Token).Set(color_space)
        node.CreateInput("wrapS", types.Token).Set("repeat")
        node.CreateInput("wrapT", types.Token).Set("repeat")
        node.CreateInput("st", types.Float2).ConnectToSource(coordinates)
        return node

    def connect(name: str, kind: Sdf.ValueTypeName, source: UsdShade.Shader, channel: str) -> None:
        output = source.CreateOutput(channel, types.Float3 if channel == "rgb" else types.Float)
        (shader.GetInput(name) or shader.CreateInput(name, kind)).ConnectToSource(output)

    if "base_color" in textures:
        connect("diffuseColor", types.Color3f, texture("base_color", "sRGB"), "rgb")
    if "specular_color" in textures:
        connect("specularColor", types.Color3f, texture("specular_color", "sRGB"), "rgb")
    if "occlusion_roughness_metallic" in textures:
        packed = texture("occlusion_roughness_metallic", "raw")
        if surface.roughness_textured:
            connect("roughness", types.Float, packed, "g")
        if surface.metallic_textured:
            connect("metallic", types.Float, packed, "b")
    if "normal" in textures:
        normal = texture("normal", "raw")
        # Maps 8-bit codes from 0..1 to -1..1, as the specification of UsdPreviewSurface requires.
        normal.CreateInput("scale", types.Float4).Set(Gf.Vec4f(2, 2, 2, 1))
        normal.CreateInput("bias", types.Float4).Set(Gf.Vec4f(-1, -1, -1, 0))
        connect("normal", types.Normal3f, normal, "rgb")


def _present(images: Mapping[str, Image8 | None]) -> dict[str, Image8]:
    return {name: image for name, image in images.items() if image is not None}
