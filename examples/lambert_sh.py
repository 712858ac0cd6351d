"""A reflectance renderer in one file: a Lambertian surface under a light of nine spherical harmonics, without shadows.

    hir reconstruct examples/sample_capture -o run --plugin examples/lambert_sh.py --set reflectance.renderer=lambert_sh

The irradiance of a normal is a quadratic polynomial of it (Ramamoorthi & Hanrahan 2001). `prepare` returns a
`GradientSolver`, so that the core selects the frame of the light, refines the albedo and stores checkpoints.
"""

from __future__ import annotations

from dataclasses import dataclass

from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import PreparedReflectance, ReflectanceRenderer
from hir_core.plugins.options import seed_of_run


@dataclass(frozen=True)
class Options:
    """Of lambert_sh."""

    steps: int = 200
    """Gradient steps of a full fit."""
    seed: int = seed_of_run()
    """Seed of the pixels of each step; the run's, unless it is set."""


class LambertSH(ReflectanceRenderer):
    """Radiance ρd·E(n)/π."""

    def __init__(self, config):
        self._config = config

    def prepare(self, scene, capture, downsample=1):
        """Fits diffuse materials, under a light in the world or on the camera."""
        from hir_core.stages.reflectance.gradient_solver import GradientSolver

        views = [view.camera.downsampled(downsample) for view in capture.views]
        prepared = PreparedLambert(scene.mesh, views)
        options = {"steps": self._config.steps, "seed": self._config.seed}
        return GradientSolver(prepared, scene, capture, downsample, kinds=("diffuse",), **options)

    def render(self, scene, camera):
        """One ray through the centre of each pixel."""
        import torch

        y, x = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
        pixels = torch.stack([torch.zeros_like(x), x, y], dim=-1).reshape(-1, 3)
        prepared = PreparedLambert(scene.mesh, [camera])
        color = prepared.radiance(scene.material, scene.environment, pixels)
        covered = torch.as_tensor(prepared.seen(pixels)[0] >= 0, dtype=color.dtype, device=color.device)
        return torch.cat([color, covered[:, None]], dim=1).reshape(camera.height, camera.width, 4)


class PreparedLambert(PreparedReflectance):
    """A mesh with its ray caster, and cameras."""

    def __init__(self, mesh, cameras):
        from hir_core.mesh.ray_casting import MeshQueries

        self._mesh, self._cameras = mesh, cameras
        self._queries = MeshQueries(mesh.positions.detach().cpu().numpy(), mesh.faces.cpu().numpy())

    def seen(self, pixels):
        """The face behind each pixel (view, x, y), -1 for none, and the barycentric weights."""
        import numpy as np

        index = pixels.cpu().numpy()
        origins, directions = np.empty((2, len(index), 3))
        for view in np.unique(index[:, 0]):
            rows = index[:, 0] == view
            origins[rows], directions[rows] = self._cameras[view].rays(index[rows, 1:] + 0.5)
        return self._queries.first_hits(origins, directions)

    def radiance(self, material, environment, pixels):
        """Linear radiance (B, 3); 0 where a pixel misses. Differentiable in albedo and light."""
        import torch

        faces, weights = self.seen(pixels)
        mesh = self._mesh
        hit = torch.as_tensor(faces >= 0, device=mesh.positions.device)
        face = torch.as_tensor(faces, device=mesh.positions.device).clamp_min(0)
        weight = torch.as_tensor(weights).to(mesh.positions)[..., None]
        normal = torch.nn.functional.normalize((mesh.normals[mesh.faces[face]] * weight).sum(1), dim=1)
        irradiance = irradiance_of(self._in_light(normal, environment, pixels), environment.radiance)
        albedo = material.diffuse_albedo
        if albedo.ndim == 3:
            uv = (mesh.uvs[mesh.topology.uv_faces[face]] * weight).sum(1)
            image = albedo.permute(2, 0, 1)[None]
            at = (2 * uv - 1)[None, None].to(albedo)
            albedo = torch.nn.functional.grid_sample(image, at, padding_mode="border", align_corners=False)[0, :, 0].T
        return albedo * irradiance / torch.pi * hit[:, None]

    def _in_light(self, normal, environment, pixels):
        """Normals in the axes of the light's image."""
        import numpy as np
        import torch

        if environment.frame == "camera":
            rotations = np.stack([camera.world_to_camera[:3, :3] for camera in self._cameras])
            rotation = torch.as_tensor(rotations).to(normal)[pixels[:, 0].to(normal.device)]
            normal = (rotation @ normal[..., None])[..., 0]
        return normal if environment.to_world is None else normal @ environment.to_world.to(normal)


def irradiance_of(normal, radiance):
    """Irradiance (N, 3) of unit normals (N, 3) from a lat-long image (H, W, 3), not below 0."""
    import torch
    from hir_exporters.conventions import latlong_directions

    height, width = radiance.shape[:2]
    directions = torch.as_tensor(latlong_directions(height, width)).to(radiance).reshape(-1, 3)
    polar = (torch.arange(height) + 0.5).to(radiance) * torch.pi / height
    angle = (torch.sin(polar) * 2 * torch.pi**2 / (height * width)).repeat_interleave(width)
    light = (harmonics(directions) * angle[:, None]).T @ radiance.reshape(-1, 3)
    band = light.new_tensor([torch.pi] + [2 * torch.pi / 3] * 3 + [torch.pi / 4] * 5)  # of a clamped cosine
    return (harmonics(normal.to(light)) @ (band[:, None] * light)).clamp_min(0)


def harmonics(d):
    """The nine real spherical harmonics of bands 0 to 2 at unit directions (N, 3)."""
    import torch

    x, y, z = d.unbind(-1)
    one = torch.full_like(x, 0.282095)
    first = [0.488603 * y, 0.488603 * z, 0.488603 * x]
    second = [1.092548 * x * y, 1.092548 * y * z, 0.315392 * (3 * z * z - 1), 1.092548 * x * z]
    return torch.stack([one, *first, *second, 0.546274 * (x * x - y * y)], dim=-1)


@hookimpl
def hir_register_reflectance_renderers():
    return [
        Component(
            name="lambert_sh",
            target="hir_plugin_lambert_sh:LambertSH",
            config=Options,
            summary="Lambertian surfaces under nine spherical harmonics, without shadows.",
            requires=("torch", "open3d"),
            extra="reconstruct",
            traits=frozenset({"material", "environment", "solver", "regularizers"}),
        )
    ]
