"""A reflectance renderer: matte surfaces under a light of nine spherical harmonics (Ramamoorthi and Hanrahan 2001).

hir reconstruct PHOTOS -o RUN --plugin lambert_sh.py --set reflectance.renderer=lambert_sh

`prepare` returns a `GradientSolver`, so that the core selects the frame of the light, refines the albedo and stores
checkpoints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Interval, Unit

from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer
from hir_core.plugins.options import seed_of_run


@dataclass(frozen=True)
class Options:
    """Of lambert_sh."""

    samples: Annotated[int, Interval(ge=1, le=16), Unit("rays")] = 4
    """Rays along each side of a pixel that give a picture its coverage."""
    steps: Annotated[int, Interval(ge=1)] = 200
    """Gradient steps of a full fit."""
    seed: int = seed_of_run()
    """Seed of the pixels of each step; the run's, unless it is set."""


class LambertHarmonics(ReflectanceRenderer):
    """Radiance ρd/π · E(n): irradiance of an unshadowed light, from its harmonics of degree 0 to 2."""

    def __init__(self, config: Options) -> None:
        self._samples, self._steps, self._seed = config.samples, config.steps, config.seed

    def prepare(self, scene, capture, downsample=1):
        from hir_core.stages.reflectance.gradient_solver import GradientSolver

        prepared = Prepared(scene.mesh, [camera.downsampled(downsample) for camera in capture.cameras])
        fit = {"steps": self._steps, "seed": self._seed}
        return GradientSolver(prepared, scene, capture, downsample, kinds=("diffuse",), **fit)

    def render(self, scene, camera):
        import torch

        side = self._samples
        steps = [(np.arange(n * side) + 0.5) / side for n in (camera.width, camera.height)]
        x, y = (torch.from_numpy(a.ravel()) for a in np.meshgrid(*steps))
        color, hit = Prepared(scene.mesh, [camera]).shade(
            scene.material, scene.environment, torch.zeros(len(x), dtype=torch.long), torch.stack([x, y], dim=1)
        )
        image = torch.cat([color, hit[:, None].to(color)], dim=1)
        return image.reshape(camera.height, side, camera.width, side, 4).mean(dim=(1, 3))


class Prepared(PreparedReflectance):
    """One mesh and the cameras that see it."""

    def __init__(self, mesh, cameras) -> None:
        from hir_core.mesh.ray_casting import MeshQueries

        self._mesh, self._cameras = mesh, cameras
        self._rays = MeshQueries(mesh.positions.detach().cpu().numpy(), mesh.faces.cpu().numpy())

    def radiance(self, material, environment, pixels):
        return self.shade(material, environment, pixels[:, 0], pixels[:, 1:] + 0.5)[0]

    def shade(self, material, environment, view, place):
        """Radiance (B, 3) through positions in pixels (B, 2) of views (B,), and which of them show the object."""
        import torch

        mesh, device = self._mesh, mesh_device(self._mesh)
        origin, direction = np.zeros((len(view), 3)), np.zeros((len(view), 3))
        for i, camera in enumerate(self._cameras):
            chosen = (view == i).cpu().numpy()
            origin[chosen], direction[chosen] = camera.rays(place[torch.from_numpy(chosen)].cpu().numpy())
        face, weight = (torch.from_numpy(a).to(device) for a in self._rays.first_hits(origin, direction))
        hit, face = face >= 0, face.clamp_min(0)
        normal = (mesh.normals[mesh.faces[face]] * weight[..., None]).sum(dim=1)
        normal = normal / normal.norm(dim=1, keepdim=True).clamp_min(1e-12)
        if environment.frame == "camera":
            to_camera = np.stack([camera.world_to_camera[:3, :3] for camera in self._cameras])
            normal = (torch.from_numpy(to_camera).to(normal)[view] @ normal[..., None])[..., 0]
        if environment.to_world is not None:
            normal = normal @ environment.to_world.to(normal)
        color = albedo(material.diffuse_albedo, mesh, face, weight) * irradiance(environment.radiance, normal) / np.pi
        return torch.where(hit[:, None], color, 0.0).clamp_min(0), hit


def mesh_device(mesh):
    """Where the mesh lies."""
    return mesh.positions.device


def albedo(texture, mesh, face, weight):
    """The texture (H, W, 3), or one value (3,), at points of faces: bilinear, with the origin at the top left."""
    import torch

    if texture.ndim == 1:
        return texture.expand(len(face), 3)
    uv = (mesh.uvs[mesh.topology.uv_faces[face]] * weight[..., None]).sum(dim=1)
    image = texture.movedim(-1, 0)[None]
    return torch.nn.functional.grid_sample(image, (2 * uv - 1)[None, None], padding_mode="border", align_corners=False)[
        0, :, 0
    ].T


def irradiance(radiance, normal):
    """Irradiance (B, 3) at unit normals (B, 3) under a lat-long light (H, W, 3): a cosine lobe of degree 2."""
    import torch
    from hir_exporters.conventions import latlong_directions, latlong_solid_angles

    height, width = radiance.shape[:2]
    direction = torch.from_numpy(latlong_directions(height, width).reshape(-1, 3)).to(radiance)
    area = torch.from_numpy(np.broadcast_to(latlong_solid_angles(height, width), (height, width)).ravel().copy())
    light = (harmonics(direction) * area.to(radiance)[:, None]).T @ radiance.reshape(-1, 3)
    cosine = torch.tensor([np.pi, *3 * [2 * np.pi / 3], *5 * [np.pi / 4]]).to(radiance)
    return harmonics(normal) @ (cosine[:, None] * light)


def harmonics(direction):
    """Real spherical harmonics (B, 9) of degree 0 to 2 of unit directions."""
    import torch

    x, y, z = direction.unbind(1)
    bands = [0.282095 * torch.ones_like(x), 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y]
    bands += [1.092548 * y * z, 0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y)]
    return torch.stack(bands, dim=1)


@hookimpl
def hir_register_reflectance_renderers() -> list[Component]:
    return [
        Component(
            name="lambert_sh",
            target="hir_plugin_lambert_sh:LambertHarmonics",
            config=Options,
            summary="Matte surfaces under nine spherical harmonics, without shadows: quick, and blind to gloss.",
            requires=("torch", "jaxtyping", "open3d"),
            extra="reconstruct",
            traits=frozenset({"material", "environment", "lambertian", "solver", "regularizers"}),
        )
    ]
