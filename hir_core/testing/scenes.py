"""Small scenes, all by formula: what regularizers and renderers are tried on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal

import numpy as np
import torch
from hir_exporters.conventions import latlong_directions
from torch import Tensor

from hir_core.capture import Camera
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology

TEXELS = 12
LIGHT_ROWS = 8


def sphere(rings: int = 8, segments: int = 12, radius: float = 1.0, dtype: torch.dtype = torch.float32) -> Mesh:
    """A closed sphere about the origin, outward, with texture coordinates that have a seam and two poles."""
    v, u = np.meshgrid(np.linspace(0, 1, rings + 1), np.linspace(0, 1, segments + 1), indexing="ij")
    polar, azimuth = v * np.pi, u * 2 * np.pi
    points = np.stack([np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1)
    uv_index = np.arange((rings + 1) * (segments + 1)).reshape(rings + 1, segments + 1)
    # one vertex at each pole, and none twice where u wraps
    index = 1 + (np.arange(rings + 1)[:, None] - 1) * segments + np.arange(segments + 1)[None] % segments
    index[0], index[-1] = 0, 1 + (rings - 1) * segments
    positions = np.zeros((int(index.max()) + 1, 3))
    positions[index] = points
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    rows, columns = np.arange(rings), np.arange(segments)
    a, b, c, d = ((rows[:, None] + i, columns[None] + j) for i, j in corners)
    faces = np.concatenate([np.stack([index[p].ravel() for p in t], 1) for t in ((a, b, c), (a, c, d))])
    uv_faces = np.concatenate([np.stack([uv_index[p].ravel() for p in t], 1) for t in ((a, b, c), (a, c, d))])
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    topology = Topology(torch.from_numpy(faces[proper]), torch.from_numpy(uv_faces[proper]))
    uvs = torch.from_numpy(np.stack([u, v], -1).reshape(-1, 2)).to(dtype)
    return Mesh(torch.from_numpy(positions * radius).to(dtype), topology, uvs)


def smooth_sphere(subdivisions: int = 4, radius: float = 1.0) -> Mesh:
    """A sphere of 20·4ⁿ nearly equal triangles, without texture coordinates."""
    import trimesh

    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    faces = torch.from_numpy(np.asarray(made.faces, dtype=np.int64))
    return Mesh(torch.from_numpy(np.asarray(made.vertices, dtype=np.float32)), Topology(faces))


def two_spheres(subdivisions: int = 4) -> Mesh:
    """A large sphere, and a small one that shadows it."""
    large, small = smooth_sphere(subdivisions), smooth_sphere(subdivisions - 1, 0.45)
    positions = torch.cat([large.positions, small.positions + torch.tensor([0.3, 1.2, 0.9])])
    return Mesh(positions, Topology(torch.cat([large.faces, small.faces + len(large.positions)])))


def plane(half: float = 1.0, cells: int = 1) -> Mesh:
    """A square in the plane y = 0 that faces up, with texture coordinates."""
    ticks = torch.linspace(-half, half, cells + 1)
    z, x = torch.meshgrid(ticks, ticks, indexing="ij")
    positions = torch.stack([x, torch.zeros_like(x), z], -1).reshape(-1, 3)
    index = torch.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    a, b, c, d = (i.reshape(-1) for i in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    faces = torch.cat([torch.stack([a, b, c], 1), torch.stack([a, c, d], 1)])
    uvs = (positions[:, [0, 2]] / half + 1) / 2
    return Mesh(positions, Topology(faces, faces), uvs)


def bumpy_scene(dtype: torch.dtype = torch.float32, seed: int = 0) -> Scene:
    """A sphere with bumps, four textures of noise and an uneven light: nothing in it is flat, equal or aligned."""
    random = np.random.default_rng(seed)
    mesh = sphere(dtype=dtype)
    push = torch.from_numpy(random.normal(scale=0.06, size=tuple(mesh.positions.shape))).to(dtype)
    mesh = mesh.with_positions(mesh.positions + push)

    def noise(low: float, high: float, channels: int) -> Tensor:
        return torch.from_numpy(random.uniform(low, high, size=(TEXELS, TEXELS, channels))).to(dtype)

    material = Material("dielectric", noise(0.1, 0.8, 3), noise(0.02, 0.3, 3), noise(0.15, 0.7, 1))
    radiance = torch.from_numpy(random.uniform(0.2, 2.0, size=(LIGHT_ROWS, 2 * LIGHT_ROWS, 3))).to(dtype)
    return Scene(mesh, material, EnvironmentMap(radiance))


def constant_material(model: Literal["paper", "dielectric"], diffuse: float, specular: float, alpha: float) -> Material:
    """One value for the whole surface."""
    return Material(model, torch.full((3,), diffuse), torch.full((3,), specular), torch.full((1,), alpha))


def uneven_light(rows: int = 32) -> EnvironmentMap:
    """Smooth and different in every direction."""
    d = torch.from_numpy(latlong_directions(rows, 2 * rows)).float()
    value = 0.6 + 0.5 * d[..., 1:2] + 0.3 * torch.sin(2 * d[..., :1] + d[..., 2:])
    return EnvironmentMap(value.clamp_min(0.05) * torch.tensor([1.0, 0.8, 0.6]))


def looking_at(eye: tuple[float, float, float], size: int = 32, focal: float = 1.5) -> Camera:
    """A camera at `eye` that looks at the origin; `focal` in image widths."""
    position = np.array(eye, dtype=np.float64)
    forward = -position / np.linalg.norm(position)
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ position
    return Camera(np.array([[focal * size, 0, size / 2], [0, focal * size, size / 2], [0, 0, 1.0]]), pose, size, size)


def hard_meshes() -> Iterator[tuple[str, Mesh]]:
    """Meshes that fits meet on bad days, with texture coordinates, each with a name that explains itself."""
    ball = sphere()
    yield "a sphere of a millimetre", ball.with_positions(ball.positions * 1e-3)
    yield "a sphere of a kilometre", ball.with_positions(ball.positions * 1e3)
    yield "a sphere far from the origin", ball.with_positions(ball.positions + 1e3)
    flat = ball.positions * torch.tensor([1.0, 0.0, 1.0])
    yield "a sphere pressed flat", ball.with_positions(flat)
    yield "all vertices in one place", ball.with_positions(torch.zeros_like(ball.positions))
    yield "one triangle", _triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    yield "a needle", _triangles([[0, 0, 0], [1, 0, 0], [1, 1e-7, 0]], [[0, 1, 2]])
    yield "a triangle with a corner twice", _triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 0, 1], [0, 1, 2]])
    fan: list[list[float]] = [[0, 0, 0], [0, 0, 1], [1, 0, 0], [-1, 0, 0.5], [0, 1, 0.5]]
    yield "an edge with three triangles", _triangles(fan, [[0, 1, 2], [0, 1, 3], [0, 1, 4]])
    yield "a vertex that nothing uses", _triangles([[0, 0, 0], [1, 0, 0], [0, 1, 0], [9, 9, 9]], [[0, 1, 2]])


def _triangles(corners: list[list[float]], faces: list[list[int]]) -> Mesh:
    positions = torch.tensor(corners, dtype=torch.float32)
    index = torch.tensor(faces)
    uvs = torch.rand(len(corners), 2, generator=torch.Generator().manual_seed(0))
    return Mesh(positions, Topology(index, index), uvs)


def hard_scenes() -> Iterator[tuple[str, Scene]]:
    """Hard meshes under an ordinary material, then an ordinary mesh under hard materials and lights."""
    plain = bumpy_scene()
    assert plain.material is not None and plain.environment is not None
    for name, mesh in hard_meshes():
        yield name, replace(plain, mesh=mesh)
    for name, value in (("black textures", 0.0), ("white textures", 1.0)):
        flat = {field: torch.full_like(getattr(plain.material, field), value) for field in TEXTURES[:2]}
        yield name, replace(plain, material=replace(plain.material, **flat))  # type: ignore[arg-type]
    yield "constant textures", replace(plain, material=_constant_textures(plain.material))
    one = {field: getattr(plain.material, field)[:1, :1].contiguous() for field in TEXTURES}
    yield "textures of one texel", replace(plain, material=replace(plain.material, **one))  # type: ignore[arg-type]
    yield "constants in place of textures", replace(plain, material=constant_material("paper", 0.5, 0.1, 0.3))
    yield "no light at all", replace(plain, environment=EnvironmentMap(torch.zeros(LIGHT_ROWS, 2 * LIGHT_ROWS, 3)))
    sun = plain.environment.radiance.clone()
    sun[2, 3] = 1e5
    yield "a sun in one texel", replace(plain, environment=EnvironmentMap(sun))


def _constant_textures(material: Material) -> Material:
    """Textures of the same size, each of one value."""
    values = zip(TEXTURES, (0.5, 0.1, 0.3), strict=True)
    flat = {field: torch.full_like(getattr(material, field), value) for field, value in values}
    return replace(material, **flat)  # type: ignore[arg-type]


def constants_at_vertices() -> Scene:
    """A sphere whose maps (V, C) have the same value at every vertex."""
    mesh = smooth_sphere(2)
    count = len(mesh.positions)
    diffuse, specular = torch.full((count, 3), 0.5), torch.full((count, 3), 0.1)
    material = Material("dielectric", diffuse, specular, torch.full((count, 1), 0.3))
    return Scene(mesh, material, uneven_light(LIGHT_ROWS))


def metallic(scene: Scene) -> Scene:
    """The scene with a metallic material, whose metalness varies between 0.2 and 0.8."""
    assert scene.material is not None
    base, roughness = scene.material.diffuse_albedo, scene.material.roughness
    metalness = 0.2 + 0.6 * (roughness - roughness.min()) / (roughness.max() - roughness.min())
    return replace(scene, material=Material.metallic(base, metalness, roughness))


TEXTURES = ("diffuse_albedo", "specular_albedo", "roughness")
"""Parameters of a material that a fit moves."""


def leaves(scene: Scene) -> dict[str, Tensor]:
    """What a fit may move, by name: positions, textures, light."""
    found = {"positions": scene.mesh.positions}
    if scene.material is not None:
        found |= {name: getattr(scene.material, name) for name in TEXTURES}
    if scene.environment is not None:
        found["radiance"] = scene.environment.radiance
    return found


def with_leaves(scene: Scene, values: dict[str, Tensor]) -> Scene:
    """The scene with other values of what `leaves` names."""
    mesh = scene.mesh.with_positions(values["positions"])
    material, environment = scene.material, scene.environment
    if material is not None:
        material = replace(material, **{name: values[name] for name in TEXTURES})  # type: ignore[arg-type]
    if environment is not None:
        environment = replace(environment, radiance=values["radiance"])
    return replace(scene, mesh=mesh, material=material, environment=environment)
