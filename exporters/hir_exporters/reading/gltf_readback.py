"""Reads an exported .glb or .gltf with pygltflib; Draco with trimesh."""

from __future__ import annotations

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.collision_names import is_collision_name
from hir_exporters.errors import HirError, InputError
from hir_exporters.materials.surfaces import MetallicSurface, SpecularSurface
from hir_exporters.reading.gltf_geometry.gltf_decompression import DECODED_EXTENSIONS, decompressed_glb
from hir_exporters.reading.gltf_geometry.gltf_mesh import CornerMesh, corner_mesh
from hir_exporters.reading.mesh_references import check_references, contained_file, load_mesh_scene
from hir_exporters.reading.readback import ReadBack, index_of_refraction
from hir_exporters.reading.texture_decoding import Pixels, decoded_pixels, times, times_color, unit_vectors

if TYPE_CHECKING:
    import trimesh
    from pygltflib import GLTF2

_DRACO: Final = "KHR_draco_mesh_compression"

_IMAGE_EXTENSIONS: Final = ("EXT_texture_webp", "KHR_texture_basisu")
"""Extensions of a texture that name an image beside the fallback."""


def read_gltf(path: Path) -> ReadBack:
    """A .glb or .gltf with one mesh and one material. Raises `InputError` where the file cannot be read."""
    from pygltflib import GLTF2

    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist")
    try:
        check_references(path)
        document = GLTF2().load(str(path))
        required = document.extensionsRequired or []
        if _DRACO in required:
            mesh = _draco_corner_mesh(path, document)
        elif DECODED_EXTENSIONS.isdisjoint(required):
            mesh = corner_mesh(document, path, lambda i: _gltf_buffer(document, i, path))
        else:
            plain = GLTF2().load_from_bytes(decompressed_glb(document, lambda i: _gltf_buffer(document, i, path)))
            mesh = corner_mesh(plain, path, lambda i: _gltf_buffer(plain, i, path))
        surface, specular_surface, normal = _gltf_material(document, path)
        return ReadBack(*mesh, surface, specular_surface, normal)
    except HirError:
        raise
    except Exception as error:  # both libraries raise many types of errors for broken files
        raise InputError(f"{path} cannot be read back as glTF ({type(error).__name__}: {error})") from error


def _draco_corner_mesh(path: Path, document: GLTF2) -> CornerMesh:
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
    return CornerMesh(positions, normals, uvs[faces])


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
) -> tuple[MetallicSurface, SpecularSurface | None, NDArray[np.float32] | None] | None:
    """The material of a .glb or .gltf: surface, specular workflow, decoded normal map. None where it has none.

    Raises `InputError` where the file has several or cannot be read.
    """
    from pygltflib import GLTF2

    try:
        check_references(path)
        document = GLTF2().load(str(path))
        if not document.materials:
            return None
        if len(document.materials) > 1:
            raise InputError(f"{path} has {len(document.materials)} materials; an asset has one: merge them first")
        return _gltf_material(document, Path(path))
    except InputError:
        raise
    except Exception as error:  # pygltflib raises many types of errors for broken files
        raise InputError(f"{path} cannot be read as glTF ({type(error).__name__}: {error})") from error


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
        better = [(texture.extensions or {}).get(name, {}).get("source") for name in _IMAGE_EXTENSIONS]
        source = next((source for source in better if source is not None), texture.source)
        return decoded_pixels(_gltf_image(document, source, path))

    packed = pixels(core.metallicRoughnessTexture)
    weight, color = pixels(specular.get("specularTexture")), pixels(specular.get("specularColorTexture"))
    surface = MetallicSurface(
        base_color=times_color(core.baseColorFactor[:3], pixels(core.baseColorTexture)),
        metallic=times(core.metallicFactor, None if packed is None else packed[..., 2]),
        roughness=times(core.roughnessFactor, None if packed is None else packed[..., 1]),
        specular_weight=times(specular.get("specularFactor", 1.0), None if weight is None else weight[..., 3]),
        specular_color=times_color(specular.get("specularColorFactor", [1.0] * 3), color),
        ior=index_of_refraction(extensions.get("KHR_materials_ior", {}).get("ior", 1.5), path),
        residual=0.0,
    )
    specular_surface = None
    if "KHR_materials_pbrSpecularGlossiness" in extensions:
        old = extensions["KHR_materials_pbrSpecularGlossiness"]
        image = pixels(old.get("specularGlossinessTexture"))
        gloss = times(old.get("glossinessFactor", 1.0), None if image is None else image[..., 3])
        specular_surface = SpecularSurface(
            times_color(old["diffuseFactor"][:3], pixels(old.get("diffuseTexture"))),
            times_color(old["specularFactor"], image),
            1 - gloss,
            residual=0.0,
        )
    normal = pixels(material.normalTexture)
    return surface, specular_surface, None if normal is None else unit_vectors(normal)


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
