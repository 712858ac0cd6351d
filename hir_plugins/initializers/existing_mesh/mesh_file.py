"""Initializer: a mesh that already exists, for runs that estimate only its materials."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import final

import numpy as np
import torch
from hir_exporters.mesh.vertex_welding import weld
from hir_exporters.reading.base_color_texture import read_base_color_texture
from numpy.typing import NDArray

from hir_core.capture import Array, Capture, similarity_scale
from hir_core.errors import CaptureError, ConfigError, HirError
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Mesh, Scene, Topology
from hir_core.scene.scan import UV_TOLERANCE, Scan
from hir_plugins.initializers.existing_mesh.mesh_alignment import align_mesh
from hir_plugins.initializers.existing_mesh.mesh_loading import LoadedMesh, files_of_mesh, load_mesh
from hir_plugins.initializers.existing_mesh.scan_axes import axes_of_gltf, world_from_axes
from hir_plugins.initializers.options import MeshFileOptions
from hir_plugins.initializers.surface.object_bounds import object_bounding_sphere
from hir_plugins.initializers.surface.silhouette_fields import working_downsample
from hir_plugins.initializers.surface.vertex_colors import vertex_colors

_UNTIL_THEN = "until then the report compares with the colours of the photographs at the vertices"


@final
class MeshFile(Initializer):
    """Reads a mesh and transforms it to the capture's world; keeps its texture coordinates and vertex colours.

    Its texture is no part of the scene: `scan` returns it.
    """

    def __init__(self, config: MeshFileOptions) -> None:
        self._config = config
        self._report: dict[str, object] = {}
        self._scan: Scan | None = None

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        """The unchanged capture, and the file's mesh. Unreadable, empty or non-finite meshes raise `CaptureError`."""
        del scene, workspace
        path = self._path(capture)
        loaded = load_mesh(path)
        to_world = self._world_from_file(path, loaded, capture)
        positions: Array = loaded.positions @ to_world[:3, :3].T + to_world[:3, 3]
        corners = loaded.faces
        if np.linalg.det(to_world[:3, :3]) < 0:
            corners = corners[:, ::-1]
        if self._config.align == "points":
            positions = self._aligned(positions, corners, capture)
        # the file has one vertex for each pair of position and UV: seams must not open the surface
        first, group = weld(positions.astype(np.float32))
        faces = group[corners]
        proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
        faces, corners = np.ascontiguousarray(faces[proper]), np.ascontiguousarray(corners[proper])
        if not len(faces):
            raise CaptureError(f"{path} has no triangle with an area; export the mesh again")
        positions = positions[first]
        uvs = loaded.uvs
        colors = loaded.colors
        if colors is not None:
            colors = colors[first]
        elif self._config.vertex_colors and any(view.camera is not None for view in capture.views):
            colors = vertex_colors(positions, faces, capture.views, working_downsample(capture))
        mesh = Mesh(
            positions=torch.from_numpy(positions.astype(np.float32)),
            topology=Topology(torch.from_numpy(faces), None if uvs is None else torch.from_numpy(corners)),
            uvs=None if uvs is None else torch.from_numpy(uvs),
            vertex_colors=None if colors is None else torch.from_numpy(colors),
        )
        self._scan = Scan(path.name, _texture(path, loaded))
        return capture, Scene(mesh=mesh)

    def files(self, capture: Capture) -> list[Path]:
        """The mesh, and the files that it names."""
        return files_of_mesh(self._path(capture))

    def scan(self) -> Scan | None:
        """The file and its texture; a warning says why a texture is left out."""
        return self._scan

    def report(self) -> Mapping[str, object]:
        """The mean distance between the mesh and the points that it was aligned with; the axes of a glTF mesh, where
        photographs decided them."""
        return self._report

    def _aligned(self, positions: Array, faces: NDArray[np.int64], capture: Capture) -> Array:
        points = np.zeros((0, 3)) if capture.points is None else capture.points.positions
        if len(points) and capture.views and all(view.camera is not None for view in capture.views):
            center, radius = object_bounding_sphere(capture)
            points = points[np.linalg.norm(points - center, axis=1) < 1.5 * radius]
        transform, distance = align_mesh(positions, faces, points, self._config.seed)
        self._report = {"aligned_with_points": len(points), "mean_distance": round(distance, 6)}
        moved: Array = positions @ transform[:3, :3].T + transform[:3, 3]
        return moved

    def _path(self, capture: Capture) -> Path:
        if not self._config.path:
            raise ConfigError("initializer 'mesh_file' needs a mesh; add --set initializer.mesh_file.path=FILE")
        folder = capture.path if capture.path.is_dir() else capture.path.parent
        candidates = [folder / self._config.path]
        with suppress(RuntimeError):  # ~NAME of an unknown user
            candidates.insert(0, Path(self._config.path).expanduser())
        for candidate in candidates:
            if candidate.is_file():
                return candidate
        raise ConfigError(
            f"initializer.mesh_file.path: {self._config.path} is neither in the working folder nor in {folder}; give "
            "the path of a mesh file"
        )

    def _world_from_file(self, path: Path, loaded: LoadedMesh, capture: Capture) -> Array:
        transform = np.eye(4)
        if self._config.transform:
            if len(self._config.transform) != 16:
                raise ConfigError(
                    "initializer.mesh_file.transform needs 16 numbers, a 4×4 matrix in rows, not "
                    f"{len(self._config.transform)}"
                )
            transform = np.array(self._config.transform).reshape(4, 4)
            square = transform[:3, :3].T @ transform[:3, :3]
            scale = similarity_scale(transform)
            if (
                not scale > 0
                or np.abs(square - np.eye(3) * scale**2).max() > 1e-4 * scale**2
                or np.abs(transform[3] - [0, 0, 0, 1]).max() > 1e-9
            ):
                raise ConfigError(
                    "initializer.mesh_file.transform is not a similarity (rotation, one scale, translation)"
                )
        axes: str = self._config.axes
        if axes == "auto":
            axes = "source"
            if path.suffix.lower() in (".glb", ".gltf"):
                placed = loaded.positions @ transform[:3, :3].T + transform[:3, 3]
                compared = self._config.align == "none"
                axes = self._axes_of_gltf(placed, loaded.faces, capture) if compared else "world"
        return world_from_axes(axes, capture) @ transform

    def _axes_of_gltf(self, positions: Array, faces: NDArray[np.int64], capture: Capture) -> str:
        comparison = axes_of_gltf(positions, faces, capture)
        if comparison.disagreement:
            self._report = {"axes": comparison.axes, "colour_disagreement": dict(comparison.disagreement)}
        return comparison.axes


def _texture(path: Path, loaded: LoadedMesh) -> NDArray[np.uint8] | None:
    """The texture of the file; None where it has none, or none that can be shown on its texture coordinates."""
    if loaded.uvs is None:
        return None
    try:
        texture = read_base_color_texture(path)
    except HirError as error:
        warnings.warn(f"{error}; {_UNTIL_THEN}", UserWarning, stacklevel=2)
        return None
    if texture is not None and (loaded.uvs.min() < -UV_TOLERANCE or loaded.uvs.max() > 1 + UV_TOLERANCE):
        warnings.warn(
            f"{path}: its texture coordinates leave 0…1; pack them on one square; {_UNTIL_THEN}",
            UserWarning,
            stacklevel=2,
        )
        return None
    return texture
