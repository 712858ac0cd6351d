"""A scene of zero energy for each regularizer, for the contract tests (`Component.testing`)."""

from __future__ import annotations

from dataclasses import replace

import torch

from hir_core.scene import Scene


def single_point(scene: Scene) -> Scene:
    """All vertices at one point: no edge has a length, each vertex is the mean of its neighbours."""
    return replace(scene, mesh=scene.mesh.with_positions(torch.zeros_like(scene.mesh.positions)))


def flat_sheet(scene: Scene) -> Scene:
    """A grid in a plane, all triangles facing up."""
    from hir_core.testing.scenes import plane

    sheet = plane(1.0, 6)
    return replace(scene, mesh=sheet.with_positions(sheet.positions.to(scene.mesh.positions)))


def constant_specular(scene: Scene) -> Scene:
    """A specular albedo texture of one value."""
    assert scene.material is not None
    flat = torch.full_like(scene.material.specular_albedo, 0.04)
    return replace(scene, material=replace(scene.material, specular_albedo=flat))


def constant_textures(scene: Scene) -> Scene:
    """Every texture of one value, under light of one colour from everywhere."""
    assert scene.material is not None and scene.environment is not None
    material = replace(
        scene.material,
        diffuse_albedo=torch.full_like(scene.material.diffuse_albedo, 0.5),
        specular_albedo=torch.full_like(scene.material.specular_albedo, 0.04),
        roughness=torch.full_like(scene.material.roughness, 0.3),
    )
    light = replace(scene.environment, radiance=torch.ones_like(scene.environment.radiance))
    return replace(scene, material=material, environment=light)
