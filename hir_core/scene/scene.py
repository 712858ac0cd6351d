"""The scene that is fitted, in torch: a mesh, its material, the light. Replaced, never mutated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Literal, TypeVar

import torch
from hir_exporters.metallic_parameters import DEFAULT_DIELECTRIC_F0
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.errors import InputError


@dataclass(frozen=True, eq=False)
class Topology:
    """The connectivity of a mesh; shared by all meshes that differ only in positions."""

    faces: Int[Tensor, "F 3"]
    uv_faces: Int[Tensor, "F 3"] | None = None

    @cached_property
    def edges(self) -> Int[Tensor, "E 2"]:
        """Each edge once, smaller index first; edges between a vertex and itself are left out."""
        return self._edge_table[0]

    @cached_property
    def edge_faces(self) -> tuple[Int[Tensor, "3F"], Int[Tensor, "3F"]]:
        """For each corner edge (3F, degenerate ones left out): index of its edge and of its face."""
        return self._edge_table[1], self._edge_table[2]

    @cached_property
    def face_pairs(self) -> Int[Tensor, "P 2"]:
        """Pairs of faces that share an edge; for an edge of more than two faces, each consecutive pair."""
        edge, face = self.edge_faces
        order = torch.argsort(edge, stable=True)
        edge, face = edge[order], face[order]
        same = edge[1:] == edge[:-1]
        return torch.stack([face[:-1][same], face[1:][same]], dim=1)

    @cached_property
    def _edge_table(self) -> tuple[Tensor, Tensor, Tensor]:
        corners = torch.cat([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        owner = torch.arange(len(self.faces), device=self.faces.device).repeat(3)
        proper = corners[:, 0] != corners[:, 1]
        corners, owner = corners[proper].sort(dim=1).values, owner[proper]
        # one number for each pair, in the same order: sorting rows takes ten times as long
        count = int(corners.max()) + 1 if len(corners) else 1
        keys, inverse = torch.unique(corners[:, 0].long() * count + corners[:, 1], return_inverse=True)
        edges = torch.stack([torch.div(keys, count, rounding_mode="floor"), keys % count], dim=1)
        return edges.to(corners.dtype), inverse, owner


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles in the world. Texture coordinates have their own topology, so that seams do not split vertices."""

    positions: Float[Tensor, "V 3"]
    topology: Topology
    uvs: Float[Tensor, "U 2"] | None = None
    """Origin top-left, as in glTF."""
    vertex_colors: Float[Tensor, "V 3"] | None = None
    """Linear."""

    @property
    def faces(self) -> Int[Tensor, "F 3"]:
        """Vertex indices of each triangle."""
        return self.topology.faces

    @property
    def face_areas_normals(self) -> Float[Tensor, "F 3"]:
        """Normal of each face times twice its area; counter-clockwise is outside."""
        a, b, c = self.positions[self.faces].unbind(1)
        return torch.linalg.cross(b - a, c - a)

    @property
    def normals(self) -> Float[Tensor, "V 3"]:
        """Unit vertex normals, each face weighed by its area; (0, 1, 0) where no face has an area."""
        normals = torch.zeros_like(self.positions).index_add(
            0, self.faces.reshape(-1), self.face_areas_normals.repeat_interleave(3, dim=0)
        )
        length = normals.norm(dim=1, keepdim=True)
        up = torch.tensor([0.0, 1.0, 0.0], dtype=normals.dtype, device=normals.device).expand_as(normals)
        # divide before squaring: the areas of a scene of millimetres, in metres, underflow when squared
        return torch.where(length > 0, normals / length.clamp_min(torch.finfo(normals.dtype).tiny), up)

    def with_positions(self, positions: Float[Tensor, "V 3"]) -> Mesh:
        """The same triangles with other positions."""
        return replace(self, positions=positions)


Texture = Float[Tensor, "H W C"] | Float[Tensor, " C"]
"""A texture (row 0 at v = 0, the top) or one value for the whole surface."""


@dataclass(frozen=True, eq=False)
class Material:
    """A BRDF of docs/conventions.md and its parameters; each parameter is a texture or a constant.

    `metallic` is made with `Material.metallic` from glTF's parameters; its albedos are those of its two lobes, so that
    whatever shades `dielectric` shades it too.
    """

    model: Literal["paper", "dielectric", "metallic"]
    diffuse_albedo: Texture
    specular_albedo: Texture
    roughness: Texture
    """GGX width α (not its square root), C = 1."""
    normal: Float[Tensor, "H W 3"] | None = None
    """Unit vectors in tangent space, +Y up, MikkTSpace."""
    observed: Bool[Tensor, "H W"] | None = None
    """Texels that are observed in at least one view."""
    metalness: Texture | None = None
    """0 to 1, C = 1: 1 for a metal. Only `metallic` has it."""
    dielectric_f0: float = DEFAULT_DIELECTRIC_F0
    """Reflectance at normal incidence where metalness is 0; only `metallic` uses it."""

    def __post_init__(self) -> None:
        if self.model == "metallic" and self.metalness is None:
            raise InputError("a material of the model 'metallic' needs metalness; make it with Material.metallic")
        if self.model != "metallic" and (self.metalness is not None or self.dielectric_f0 != DEFAULT_DIELECTRIC_F0):
            name = "metalness" if self.metalness is not None else "dielectric_f0"
            raise InputError(f"{name} is only for the model 'metallic', not for {self.model!r}; leave it out")

    @classmethod
    def metallic(
        cls,
        base_color: Texture,
        metalness: Texture,
        roughness: Texture,
        normal: Float[Tensor, "H W 3"] | None = None,
        observed: Bool[Tensor, "H W"] | None = None,
        dielectric_f0: float = DEFAULT_DIELECTRIC_F0,
    ) -> Material:
        """The `metallic` model: ρd = (1 − m)·base, ρs = (1 − m)·F0 + m·base (glTF 2.0, appendix B.3.5).

        `base_color` has three channels, `metalness` m one; textures of one size or constants. Differentiable.
        Raises `InputError` for textures of different size.
        """
        if base_color.ndim == 3 and metalness.ndim == 3 and base_color.shape[:2] != metalness.shape[:2]:
            raise InputError(
                f"the base colour has {base_color.shape[0]} rows and {base_color.shape[1]} columns, metalness "
                f"{metalness.shape[0]} and {metalness.shape[1]}; resize one of them to the size of the other"
            )
        share = 1 - metalness
        diffuse, specular = share * base_color, share * dielectric_f0 + metalness * base_color
        return cls("metallic", diffuse, specular, roughness, normal, observed, metalness, dielectric_f0)

    @property
    def base_color(self) -> Texture:
        """glTF's base colour of a `metallic` material, ρd + ρs − (1 − m)·F0; not clamped, differentiable."""
        if self.metalness is None:
            raise InputError(f"a material of the model {self.model!r} has no base colour; only 'metallic' has one")
        return self.diffuse_albedo + (self.specular_albedo - (1 - self.metalness) * self.dielectric_f0)


@dataclass(frozen=True, eq=False)
class CameraLamp:
    """A lamp that each camera carries, such as a flash: its light falls with the square of the distance.

    At a distance r, and at an angle θ from the camera's viewing axis, the irradiance of a point of it on a surface that
    faces it is `intensity · cos(θ)^exponent / r²`. With a `radius` it is the mean of such points on a disc that is
    perpendicular to the viewing axis, such as a softbox: shadows and reflections have soft edges.
    """

    intensity: Float[Tensor, " 3"]
    """Radiant intensity along the viewing axis: radiance times the square of the scene's unit of length."""
    offset: Float[Tensor, " 3"]
    """Place in the camera's axes (docs/conventions.md: x to the right, y down, z forwards), in the scene's unit."""
    exponent: Float[Tensor, ""]
    """Of the emission lobe; 0 for a lamp that shines equally in all directions."""
    radius: Float[Tensor, ""] = field(default_factory=lambda: torch.zeros(()))
    """Of the disc, in the scene's unit; 0 for a point."""


@dataclass(frozen=True, eq=False)
class EnvironmentMap:
    """Distant light as a lat-long image (docs/conventions.md), fixed in the world or to the camera; and a lamp."""

    radiance: Float[Tensor, "H W 3"]
    to_world: Float[Tensor, "3 3"] | None = None
    """Rotation from the map's axes to the world's (or the camera's); None is the identity."""
    frame: Literal["world", "camera"] = "world"
    lamp: CameraLamp | None = None
    """A lamp beside the distant light; None for none."""


@dataclass(frozen=True, eq=False)
class Scene:
    """Mesh, material and light: what a run reconstructs."""

    mesh: Mesh
    material: Material | None = None
    environment: EnvironmentMap | None = None
    """The light; of a capture of several takes that of the first one."""
    take_radiance: Mapping[str, Float[Tensor, "H W 3"]] = field(default_factory=dict)
    """Radiance of the light of each take, by its name; empty where all photographs have one light."""

    def in_take(self, take: str) -> Scene:
        """The scene under the light of a take (`View.take`); a scene of one light without a name stays as it is, and an
        empty name is that of the only take.

        Raises `InputError` for a take whose light is not known.
        """
        if not self.take_radiance or self.environment is None:
            return self
        if not take and len(self.take_radiance) == 1:
            take = next(iter(self.take_radiance))
        if take not in self.take_radiance:
            known = ", ".join(repr(name) for name in self.take_radiance)
            raise InputError(
                f"the light of the take {take!r} is unknown; the photographs of the fit had the takes {known}. "
                "Name one of them for each photograph (docs/captures.md)"
            )
        return replace(self, environment=replace(self.environment, radiance=self.take_radiance[take]), take_radiance={})

    def to(self, device: torch.device | str) -> Scene:
        """The same scene on another device."""
        return _to_device(self, torch.device(device))


Part = TypeVar("Part", bound=Topology | Mesh | Material | CameraLamp | EnvironmentMap | Scene)


def _to_device(part: Part, device: torch.device) -> Part:
    """The same dataclass with all tensors, also of nested dataclasses, on a device."""
    moved: dict[str, Any] = {}
    for each in fields(part):
        value = getattr(part, each.name)
        if isinstance(value, Tensor):
            moved[each.name] = value.to(device)
        elif isinstance(value, Topology | Mesh | Material | CameraLamp | EnvironmentMap):
            moved[each.name] = _to_device(value, device)
        elif isinstance(value, Mapping):
            moved[each.name] = {name: tensor.to(device) for name, tensor in value.items()}
    return replace(part, **moved)
