"""Reads an exported .glb or .gltf with pygltflib; Draco with trimesh."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import AssetMesh
from hir_exporters.collision_names import is_collision_name
from hir_exporters.errors import HirError, InputError
from hir_exporters.reading.gltf_geometry.gltf_decompression import DECODED_EXTENSIONS, DRACO, decompressed_glb
from hir_exporters.reading.gltf_geometry.gltf_mesh import CornerMesh, corner_mesh
from hir_exporters.reading.gltf_json.gltf_surface import SurfaceOfFile, gltf_surface
from hir_exporters.reading.gltf_json.gltf_textures import GltfTextures
from hir_exporters.reading.gltf_json.omitted_features import warn_of_omitted_features
from hir_exporters.reading.gltf_json.texture_placement import placed_uvs
from hir_exporters.reading.gltf_json.used_material import used_material
from hir_exporters.reading.mesh_references import check_references, load_mesh_scene, uri_bytes
from hir_exporters.reading.readback import ReadBack

if TYPE_CHECKING:
    import trimesh
    from pygltflib import GLTF2


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
        if DRACO in required:
            mesh = _draco_corner_mesh(path, document)
        elif DECODED_EXTENSIONS.isdisjoint(required):
            mesh = corner_mesh(document, path, lambda i: _gltf_buffer(document, i, path))
        else:
            plain = GLTF2().load_from_bytes(decompressed_glb(document, lambda i: _gltf_buffer(document, i, path)))
            mesh = corner_mesh(plain, path, lambda i: _gltf_buffer(plain, i, path))
        textures = GltfTextures.of_file(path)
        material = used_material(textures.document, path) or {}
        mesh = mesh._replace(uvs=placed_uvs(mesh.uvs, material, textures))
        return ReadBack(*mesh, *gltf_surface(material, textures))
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


def read_gltf_surface(path: Path, mesh: AssetMesh) -> SurfaceOfFile | None:
    """The material of the triangles of a .glb or .gltf of any program. None where they have none.

    One warning names what an asset cannot represent. Raises `InputError` where they have several or it cannot be read.
    """
    try:
        check_references(path)
        textures = GltfTextures.of_file(path)
        material = used_material(textures.document, path)
        warn_of_omitted_features(material or {}, textures, mesh)
        return None if material is None else gltf_surface(material, textures)
    except HirError:
        raise
    except Exception as error:  # a document may have any structure
        raise InputError(f"{path} cannot be read as glTF ({type(error).__name__}: {error})") from error


def read_gltf_uvs(path: Path, uvs: NDArray[np.float32]) -> NDArray[np.float32]:
    """The coordinates (N, 2), origin top-left, of a .glb or .gltf of any program as its textures are looked up.

    Raises `InputError` where a texture is not looked up at `uvs` with one offset and scale for all textures.
    """
    try:
        textures = GltfTextures.of_file(path)
        material = used_material(textures.document, path)
        return placed_uvs(uvs, material or {}, textures).astype(np.float32)
    except HirError:
        raise
    except Exception as error:  # a document may have any structure
        raise InputError(f"{path} cannot be read as glTF ({type(error).__name__}: {error})") from error


def _gltf_buffer(document: GLTF2, index: int, path: Path) -> bytes:
    uri = document.buffers[index].uri
    found = bytes(document.binary_blob()) if uri is None else uri_bytes(path, uri)
    if found is None:
        raise InputError(f"{path} names {uri[:80]!r}, which is not in its folder; put it beside the file")
    return found
