"""Makes an asset from mesh files of other programs: a mesh with UVs, its material, and optionally a light.

Formats are .obj, .ply, .glb, .gltf and USD. The material is that of the file, for an .obj that of its .mtl, for a .ply
the texture that it names; `MaterialOverrides` replace its parameters. A warning names what is left out. No file outside
the mesh file's folder is opened unless the caller names it.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.asset import Asset, AssetMaterial, AssetMesh, validate_asset
from hir_exporters.errors import HirError, InputError
from hir_exporters.files.regular_files import check_regular_file
from hir_exporters.materials.material_conversion import collapse_uniform_textures
from hir_exporters.materials.surfaces import default_surface
from hir_exporters.mesh.vertex_normals import angle_weighted_normals
from hir_exporters.reading.asset_decoding import decode_surface, unindexed_mesh
from hir_exporters.reading.base_color_texture import ply_texture
from hir_exporters.reading.environment_import import read_light
from hir_exporters.reading.gltf_json.gltf_surface import SPECULAR_GLOSSINESS, SurfaceOfFile
from hir_exporters.reading.gltf_readback import gltf_scene, read_gltf_surface, read_gltf_uvs
from hir_exporters.reading.material_overrides import MaterialOverrides, load_color, load_normal_map, load_scalar
from hir_exporters.reading.mesh_references import check_references, load_mesh_scene
from hir_exporters.reading.mtl_import import read_mtl
from hir_exporters.reading.usd_reading.usd_import import read_untrusted_usd
from hir_exporters.reading.wavefront.obj_geometry import ObjGeometry, read_obj
from hir_exporters.reading.wavefront.obj_mesh import split_vertices, vertex_normals

Array = NDArray[np.floating]

MESH_SUFFIXES: Final = (".obj", ".ply", ".glb", ".gltf", ".usda", ".usdc", ".usdz", ".usd")


def load_mesh_asset(path: Path, maps: MaterialOverrides | None = None, light: Path | None = None) -> Asset:
    """The mesh of a file with its material and the overrides `maps`; `light` is a lat-long .hdr or .exr.

    Raises `InputError` with the file, the field and the remedy.
    """
    path, maps = Path(path), maps or MaterialOverrides()
    suffix = path.suffix.lower()
    if suffix not in MESH_SUFFIXES:
        raise InputError(f"{path} is not a mesh format that can be read; known are {', '.join(MESH_SUFFIXES)}")
    check_regular_file(path)
    if suffix.startswith(".usd"):
        back = read_untrusted_usd(path)
        mesh = unindexed_mesh(back)
        material = _checked_material(path, maps, (back.surface, back.specular_surface, back.normal))
    elif suffix == ".obj":
        check_references(path)
        geometry = read_obj(path)
        mesh = _obj_mesh(path, geometry)
        material = _checked_material(path, read_mtl(path, geometry, maps))
    elif suffix == ".ply":
        mesh = _trimesh_mesh(path)
        texture = ply_texture(path) if maps.base_color is None else maps.base_color
        material = _checked_material(path, replace(maps, base_color=texture))
    else:
        mesh = _trimesh_mesh(path)
        mesh = replace(mesh, uvs=read_gltf_uvs(path, mesh.uvs))
        material = _checked_material(path, maps, read_gltf_surface(path, mesh))
    material = collapse_uniform_textures(material)
    asset = Asset(mesh, material, None if light is None else read_light(light), {"made_from": path.name}, path.stem)
    try:
        validate_asset(asset)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    return asset


def _obj_mesh(path: Path, geometry: ObjGeometry) -> AssetMesh:
    if not len(geometry.corners):
        raise InputError(f"{path}: mesh.faces contains no triangles")
    without = int((geometry.corners[..., 1] < 0).any(axis=1).sum())
    if without:
        raise InputError(
            f"{path}: mesh.uvs is missing for {without} of {len(geometry.corners)} triangles; unwrap the mesh first"
        )
    mesh = split_vertices(geometry)
    uvs = geometry.uvs[mesh.vertices[:, 1]] * [1, -1] + [0, 1]  # v is upwards there
    with np.errstate(over="ignore"):  # infinite numbers are refused later
        return AssetMesh(
            positions=geometry.positions[mesh.vertices[:, 0]].astype(np.float32),
            normals=vertex_normals(geometry, mesh).astype(np.float32),
            uvs=uvs.astype(np.float32),
            faces=mesh.faces.astype(np.int32),
        )


def _trimesh_mesh(path: Path) -> AssetMesh:
    import trimesh

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # about numbers that are rejected below
            if path.suffix.lower() in (".glb", ".gltf"):
                from pygltflib import GLTF2

                check_references(path)
                loaded = gltf_scene(path, GLTF2().load(str(path)))
            else:
                loaded = load_mesh_scene(path, process=False)
            placed = [loaded.graph[node] for node in loaded.graph.nodes_geometry]
            stored = [(loaded.geometry[name], to_world) for to_world, name in placed]
            stored = [(m, to_world) for m, to_world in stored if isinstance(m, trimesh.Trimesh) and len(m.faces)]
            parts: list[Any] = [mesh.copy().apply_transform(to_world) for mesh, to_world in stored]
    except HirError:
        raise
    except IndexError as error:
        raise InputError(
            f"{path}: mesh.faces, or data that it references, has an index out of range ({error})"
        ) from error
    except Exception as error:  # trimesh raises many types of errors for broken files
        raise InputError(f"{path} cannot be read as a mesh ({type(error).__name__}: {error})") from error
    if not parts:
        raise InputError(f"{path}: mesh.faces contains no triangles")
    for part in parts:
        positions, faces = np.asarray(part.vertices), np.asarray(part.faces)
        if positions.ndim != 2 or positions.shape[1] != 3:
            raise InputError(f"{path}: mesh.positions does not have three numbers for each vertex")
        if faces.min() < 0 or faces.max() >= len(positions):
            raise InputError(f"{path}: mesh.faces has an index out of range (it has {len(positions)} vertices)")
        uvs = getattr(part.visual, "uv", None)
        if uvs is None or len(uvs) != len(part.vertices):
            raise InputError(f"{path}: mesh.uvs is missing; unwrap the mesh first")
    offsets = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
    return AssetMesh(
        positions=np.concatenate([part.vertices for part in parts]),
        normals=np.concatenate([_unit_normals(part, *source) for part, source in zip(parts, stored, strict=True)]),
        uvs=np.concatenate([np.asarray(part.visual.uv) for part in parts]) * [1, -1] + [0, 1],  # v is upwards there
        faces=np.concatenate([np.asarray(p.faces) + offset for p, offset in zip(parts, offsets, strict=True)]),
    )


def _unit_normals(part: Any, stored: Any, to_world: Array) -> Array:
    """Vertex normals of the file, else weighted by the angles of the triangles; +Y for vertices without any.

    `stored` is the mesh before `to_world` (4, 4) made `part` of it, as copies in trimesh have no normals of the file.
    """
    linear = to_world[:3, :3]
    if "vertex_normals" not in stored._cache or not np.linalg.det(linear):
        return angle_weighted_normals(part.vertices, np.asarray(part.faces))
    normals = np.asarray(stored.vertex_normals, np.float64) @ np.linalg.inv(linear)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 1e-12, normals / np.maximum(length, 1e-12), [0.0, 1.0, 0.0])


def _checked_material(path: Path, maps: MaterialOverrides, found: SurfaceOfFile | None = None) -> AssetMaterial:
    """The material `found` in the file, else the default one, with the overrides."""
    try:
        return _material(path, maps, found)
    except HirError:
        raise
    except (ArithmeticError, LookupError, TypeError, ValueError) as error:  # numbers of another type or shape
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
        raise InputError(f"{path}: its material cannot be read ({reason}); export it again") from error


def _material(path: Path, maps: MaterialOverrides, found: SurfaceOfFile | None) -> AssetMaterial:
    surface, specular, normal = found or (default_surface(), None, None)
    given = [value is not None for value in (maps.base_color, maps.roughness, maps.metallic)]
    if specular is not None and any(given):
        if not all(given):
            name = "useSpecularWorkflow" if path.suffix.lower().startswith(".usd") else SPECULAR_GLOSSINESS
            raise InputError(
                f"{path} has a material of the specular workflow ({name}), which has no base colour and no metalness; "
                "give --base-color, --roughness and --metallic, or none"
            )
        specular = None
    surface = replace(
        surface,
        base_color=surface.base_color if maps.base_color is None else load_color(maps.base_color),
        roughness=surface.roughness if maps.roughness is None else load_scalar(maps.roughness, "roughness"),
        metallic=surface.metallic if maps.metallic is None else load_scalar(maps.metallic, "metallic"),
    )
    if maps.normal is not None:
        normal = load_normal_map(maps.normal, maps.normal_scale)
    return decode_surface(surface, specular, normal)[0]
