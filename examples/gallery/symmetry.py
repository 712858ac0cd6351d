"""A regularizer: the shape is its own mirror image.

hir reconstruct PHOTOS -o RUN --plugin symmetry.py --set geometry.regularizers.symmetry.weight=100
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal

from annotated_types import Interval

from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import Regularizer


@dataclass(frozen=True)
class Options:
    """Of symmetry."""

    axis: Literal["x", "y", "z"] = "x"
    """Normal of the mirror plane, which goes through the mean of the vertices; y is up."""
    reach: Annotated[float, Interval(gt=0, le=1)] = 0.1
    """Fraction of the object's size within which a mirrored vertex has a partner; the others are left alone."""


class Symmetry(Regularizer):
    """Mean over vertices of `((M p_i − p_j) · n_j)² / s²`: the mirrored vertex lies on the tangent plane of the vertex
    p_j nearest to it. Partners and normals are those of the scene that the stage began with; s is the object's size.
    """

    def __init__(self, config: Options) -> None:
        self._axis, self._reach = "xyz".index(config.axis), config.reach

    def prepare(self, scene):
        import torch
        from scipy.spatial import cKDTree

        def mirrored(positions):
            sign = torch.ones(3, dtype=positions.dtype, device=positions.device)
            sign[self._axis] = -1
            centre = positions.mean(dim=0)
            return (positions - centre) * sign + centre

        start = scene.mesh.positions.detach()
        size = (start - start.mean(dim=0)).norm(dim=1).amax().clamp_min(torch.finfo(start.dtype).tiny)
        points = (start - start.mean(dim=0)) / size
        distance, partner = cKDTree(points.cpu().numpy()).query(mirrored(points).cpu().numpy())
        kept = torch.from_numpy(distance < self._reach).to(start.device)
        partner = torch.from_numpy(partner).to(start.device)[kept]
        normals = scene.mesh.normals.detach()[partner]

        def energy(scene):
            positions = scene.mesh.positions / size
            offsets = mirrored(positions)[kept] - positions[partner]
            return (offsets * normals).sum(dim=1).square().sum() / len(positions)

        return energy


def flat(scene):
    """For the contract tests: a scene that is its own mirror image, flattened onto the plane of the default axis."""
    import torch

    positions = scene.mesh.positions * torch.tensor([0.0, 1.0, 1.0], dtype=scene.mesh.positions.dtype)
    return replace(scene, mesh=scene.mesh.with_positions(positions))


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [
        Component(
            name="symmetry",
            target="hir_plugin_symmetry:Symmetry",
            config=Options,
            summary="Keeps the shape near its mirror image.",
            traits=frozenset({"differentiable", "scale_invariant"}),
            requires=("torch", "jaxtyping", "scipy"),
            testing="hir_plugin_symmetry:flat",
        )
    ]
