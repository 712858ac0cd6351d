"""Reads an exported file with other libraries: trimesh and pygltflib for glTF, pxr for USD, Pillow for images.

No code is shared with the exporters. `hir_exporters.reading.file_verification` compares the result with the asset.
"""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hir_exporters.collision_names import is_collision_name
from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import HirError, InputError
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.reading.gltf_decompression import DECODED_EXTENSIONS, decompressed_glb
from hir_exporters.reading.mesh_references import check_references, contained_file, load_mesh_scene
from hir_exporters.reading.usd_containment import check_inside, check_layers
from hir_exporters.textures.pillow_images import open_image

if TYPE_CHECKING:
    import trimesh
    from pxr import UsdShade
    from pygltflib import GLTF2

Pixels = NDArray[Any]
"""(H, W, C) codes of 8 bits, or float32 in [0, 1]."""


@dataclass(frozen=True)
class ReadBack:
    """Triangle corners and material of a file."""

    corner_positions: NDArray[np.float64]
    """(F, 3, 3)."""
    corner_normals: NDArray[np.float64]
    """(F, 3, 3)."""
    corner_uvs: NDArray[np.float64]
    """(F, 3, 2), origin top-left."""
    surface: MetallicSurface
    """With the extensions that the exporters write; for USD the inputs of the metallic workflow."""
    specular_surface: SpecularSurface | None
    """Specular-glossiness or UsdPreviewSurface's specular workflow, where the file has it."""
    normal: NDArray[np.float32] | None
    """(H, W, 3) decoded tangent space normals."""


def read_gltf(path: Path) -> ReadBack:
    """A .glb or .gltf with one mesh and one material. Raises `InputError` where the file cannot be read."""
    from pygltflib import GLTF2

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist")
    try:
        check_references(path)
        document = GLTF2().load(str(path))
        scene = gltf_scene(path, document)
        # meshes of coarser levels (MSFT_lod) belong to nodes outside of the scene
        placed = [scene.graph[node] for node in scene.graph.nodes_geometry]
        if len(placed) != 1:
            raise InputError(f"{path} contains {len(placed)} meshes; an exported file has one")
        to_world, geometry = placed[0]
        mesh = scene.geometry[geometry]
        faces = np.asarray(mesh.faces)
        positions = mesh.vertices[faces] @ to_world[:3, :3].T + to_world[:3, 3]
        normals = mesh.vertex_normals[faces] @ np.linalg.inv(to_world[:3, :3])
        uvs = np.asarray(mesh.visual.uv) * [1, -1] + [0, 1]  # trimesh flips v
        surface, specular_surface, normal = _gltf_material(document, path)
        return ReadBack(positions, normals, uvs[faces], surface, specular_surface, normal)
    except HirError:
        raise
    except Exception as error:  # both libraries raise many types of errors for broken files
        raise InputError(f"{path} cannot be read back as glTF ({type(error).__name__}: {error})") from error


def gltf_scene(path: Path, document: GLTF2) -> trimesh.Scene:
    """The scene of a .glb or .gltf without collision shapes; extensions that trimesh does not read are decoded."""
    plain = None
    if not DECODED_EXTENSIONS.isdisjoint(document.extensionsRequired or []):
        plain = io.BytesIO(decompressed_glb(document, lambda i: _gltf_buffer(document, i, path)))
    scene = load_mesh_scene(path, plain, "" if plain is None else "glb", process=False)
    scene.delete_geometry([scene.graph[node][1] for node in scene.graph.nodes_geometry if is_collision_name(node)])
    return scene


def read_gltf_surface(
    path: Path,
) -> tuple[MetallicSurface, SpecularSurface | None, NDArray[np.float32] | None]:
    """The material of a .glb or .gltf that has only one: surface, specular workflow, decoded normal map."""
    from pygltflib import GLTF2

    try:
        check_references(path)
        document = GLTF2().load(str(path))
        if len(document.materials) != 1:
            raise InputError(f"{path} has {len(document.materials)} materials; an asset has one: merge them first")
        return _gltf_material(document, Path(path))
    except InputError:
        raise
    except Exception as error:  # pygltflib raises many types of errors for broken files
        raise InputError(f"{path} cannot be read as glTF ({type(error).__name__}: {error})") from error


def read_usd(path: Path) -> ReadBack:
    """A .usda, .usdc or .usdz with one mesh and one UsdPreviewSurface. Raises `InputError` naming the file."""
    from pxr import Usd, UsdGeom, UsdPhysics, UsdShade

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist")
    try:
        check_layers(path)
        stage = Usd.Stage.Open(str(path))
        shapes = UsdPhysics.CollisionAPI
        meshes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh) and not prim.HasAPI(shapes)]
        if len(meshes) != 1:
            raise InputError(f"{path} contains {len(meshes)} meshes; an exported file has one")
        mesh = UsdGeom.Mesh(meshes[0])
        faces = np.asarray(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        st = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
        uvs = _by_corner(st.ComputeFlattened(), st.GetInterpolation(), faces) * [1, -1] + [0, 1]
        material, _ = UsdShade.MaterialBindingAPI(mesh).ComputeBoundMaterial()
        shader, *_ = material.ComputeSurfaceSource()
        surface, specular_surface, normal = _usd_material(UsdShade.Shader(shader), path)
        positions = _by_corner(mesh.GetPointsAttr().Get(), "vertex", faces)
        normals = _by_corner(mesh.GetNormalsAttr().Get(), mesh.GetNormalsInterpolation(), faces)
        return ReadBack(positions, normals, uvs, surface, specular_surface, normal)
    except InputError:
        raise
    except Exception as error:  # OpenUSD's errors, and those of decoding broken text
        raise InputError(f"{path} cannot be read back as USD ({_one_line(error)})") from error


def _by_corner(values: ArrayLike, interpolation: str, faces: NDArray[np.int32]) -> NDArray[np.float64]:
    """Values (F, 3, C) of corners from values of points or of corners."""
    array = np.asarray(values, np.float64)
    return array.reshape(*faces.shape, -1) if interpolation == "faceVarying" else array[faces]


def _one_line(error: Exception) -> str:
    """Type and message on one line. OpenUSD quotes content of broken files that may not be valid text."""
    try:
        return f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
    except UnicodeDecodeError:
        return type(error).__name__


def _gltf_material(
    document: GLTF2, path: Path
) -> tuple[MetallicSurface, SpecularSurface | None, NDArray[np.float32] | None]:
    material = document.materials[0]
    core, extensions = material.pbrMetallicRoughness, material.extensions or {}
    specular = extensions.get("KHR_materials_specular", {})

    def pixels(reference: Any) -> Pixels | None:
        if reference is None:
            return None
        index = reference["index"] if isinstance(reference, dict) else reference.index
        texture = document.textures[index]
        webp = (texture.extensions or {}).get("EXT_texture_webp", {})
        return _decoded(_gltf_image(document, webp.get("source", texture.source), path))

    packed = pixels(core.metallicRoughnessTexture)
    weight, color = pixels(specular.get("specularTexture")), pixels(specular.get("specularColorTexture"))
    surface = MetallicSurface(
        base_color=_times_color(core.baseColorFactor[:3], pixels(core.baseColorTexture)),
        metallic=_times(core.metallicFactor, None if packed is None else packed[..., 2]),
        roughness=_times(core.roughnessFactor, None if packed is None else packed[..., 1]),
        specular_weight=_times(specular.get("specularFactor", 1.0), None if weight is None else weight[..., 3]),
        specular_color=_times_color(specular.get("specularColorFactor", [1.0] * 3), color),
        ior=_index_of_refraction(extensions.get("KHR_materials_ior", {}).get("ior", 1.5), path),
        residual=0.0,
    )
    specular_surface = None
    if "KHR_materials_pbrSpecularGlossiness" in extensions:
        old = extensions["KHR_materials_pbrSpecularGlossiness"]
        image = pixels(old.get("specularGlossinessTexture"))
        gloss = _times(old.get("glossinessFactor", 1.0), None if image is None else image[..., 3])
        specular_surface = SpecularSurface(
            _times_color(old["diffuseFactor"][:3], pixels(old.get("diffuseTexture"))),
            _times_color(old["specularFactor"], image),
            1 - gloss,
            residual=0.0,
        )
    normal = pixels(material.normalTexture)
    return surface, specular_surface, None if normal is None else _unit(normal[..., :3]) * 2 - 1


def _index_of_refraction(value: object, path: Path) -> float:
    """0 (which KHR_materials_ior defines as no Fresnel effect) or at least 1; anything else raises `InputError`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or not (value == 0 or 1 <= value < 1e6):
        raise InputError(f"{path}: the index of refraction is {str(value)[:40]}; it is 0 or at least 1")
    return float(value)


def _usd_material(
    shader: UsdShade.Shader, path: Path
) -> tuple[MetallicSurface, SpecularSurface | None, NDArray[np.float32] | None]:
    def value(name: str, default: ArrayLike) -> NDArray[np.floating]:
        source = shader.GetInput(name)
        if not source:
            return np.asarray(default, np.float32)
        if not source.HasConnectedSource():
            return np.asarray(source.Get(), np.float32)
        connection, channel, _ = source.GetConnectedSource()
        return _usd_texture(connection, str(channel), path)

    white, black = [1.0] * 3, [0.0] * 3
    roughness = value("roughness", 0.5)
    surface = MetallicSurface(
        value("diffuseColor", [0.18] * 3),
        value("metallic", 0.0),
        roughness,
        np.ones((), np.float32),
        np.asarray(white, np.float32),
        _index_of_refraction(float(value("ior", 1.5)), path),
        residual=0.0,
    )
    specular_surface = None
    if int(value("useSpecularWorkflow", 0)):
        specular_surface = SpecularSurface(surface.base_color, value("specularColor", black), roughness, residual=0.0)
    normal = value("normal", [0.0, 0.0, 1.0])
    return surface, specular_surface, normal.astype(np.float32) if normal.ndim == 3 else None


def _usd_texture(connection: UsdShade.ConnectableAPI, channel: str, path: Path) -> NDArray[np.floating]:
    from pxr import Ar, UsdShade

    node = UsdShade.Shader(connection.GetPrim())
    file = node.GetInput("file").Get()
    check_inside(path, file.resolvedPath, file.path)
    asset = Ar.GetResolver().OpenAsset(Ar.ResolvedPath(file.resolvedPath))
    image = _decoded(bytes(asset.GetBuffer()))
    chosen = slice(0, 3) if channel == "rgb" else slice("rgba".index(channel), "rgba".index(channel) + 1)
    scale, bias = node.GetInput("scale"), node.GetInput("bias")
    values = (
        _linear(image[..., chosen]) if node.GetInput("sourceColorSpace").Get() == "sRGB" else _unit(image[..., chosen])
    )
    if scale:
        values = values * np.asarray(scale.Get(), np.float32)[chosen] + np.asarray(bias.Get(), np.float32)[chosen]
    return np.asarray(values if channel == "rgb" else values[..., 0])


def _gltf_image(document: GLTF2, source: int, path: Path) -> bytes:
    image = document.images[source]
    if image.uri is not None:
        return _beside(path, image.uri)
    view = document.bufferViews[image.bufferView]
    start = view.byteOffset or 0
    return _gltf_buffer(document, view.buffer, path)[start : start + view.byteLength]


def _gltf_buffer(document: GLTF2, index: int, path: Path) -> bytes:
    uri = document.buffers[index].uri
    if uri is None:
        return bytes(document.binary_blob())
    if uri.startswith("data:"):
        return base64.b64decode(uri.partition(",")[2])
    return _beside(path, uri)


def _beside(path: Path, uri: str) -> bytes:
    """The content of a file in the same folder, also after links are resolved."""
    file = contained_file(path, uri, percent_encoded=True)
    if not file.is_file():
        raise InputError(f"{path} names {uri!r}, which is not in its folder")
    return file.read_bytes()


def _decoded(data: bytes) -> Pixels:
    """Pixels (H, W, C): 8-bit codes unchanged, 16-bit codes as floats in [0, 1]."""
    with open_image(data) as image:
        pixels = np.asarray(image)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    return pixels if pixels.dtype == np.uint8 else pixels.astype(np.float32) / np.float32(65535)


def _unit(pixels: Pixels) -> NDArray[np.float32]:
    return pixels.astype(np.float32) / np.float32(255) if pixels.dtype == np.uint8 else pixels.astype(np.float32)


def _linear(pixels: Pixels) -> NDArray[np.floating]:
    """Linear colour (H, W, 3) of sRGB pixels."""
    if pixels.dtype != np.uint8:
        return srgb_to_linear(pixels[..., :3])
    return srgb_to_linear(np.arange(256, dtype=np.float32) / np.float32(255))[pixels[..., :3]]


def _times_color(factor: ArrayLike, pixels: Pixels | None) -> NDArray[np.floating]:
    """A linear factor times an sRGB texture, if there is one."""
    return _times(factor, None if pixels is None else _linear(pixels))


def _times(factor: ArrayLike, texture: Pixels | None) -> NDArray[np.floating]:
    constant = np.asarray(factor, np.float32)
    return constant if texture is None else _unit(texture) * constant
