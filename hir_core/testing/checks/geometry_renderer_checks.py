"""Contracts of geometry renderers, against the closed form of a sphere's outline."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from hir_core.testing.contract import Subject, contract, require
from hir_core.testing.exercise import Exercise

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.capture import Camera
    from hir_core.scene import Mesh
    from hir_core.scene.silhouette_targets import SilhouetteTargets

SIZE = 128
DISTANCE = 4.0
FOCAL = 1.5
TOLERANCE = 0.05
"""Of areas and their derivatives: a soft silhouette is a few percent from the sharp one, by design."""


def exercise(subject: Subject, device: str) -> Exercise:
    """Areas, overlaps, their gradient and coverage of a sphere from two sides."""
    from hir_core.scene import Scene
    from hir_core.testing.scenes import looking_at, smooth_sphere

    cameras = [looking_at((0, 0, DISTANCE), 48), looking_at((3.0, 1.0, 2.0), 48)]
    mesh = Scene(smooth_sphere(2)).to(device).mesh
    targets = _targets(subject, cameras, device)

    def run() -> dict[str, np.ndarray]:
        import torch

        renderer = subject.create()
        positions = mesh.positions.clone().requires_grad_()
        area, overlap = renderer.overlap(mesh.with_positions(positions), targets)
        found = {"area": area, "overlap": overlap, "coverage": renderer.render(mesh, cameras)}
        if area.requires_grad:
            (found["gradient"],) = torch.autograd.grad(area.sum() + overlap.sum(), positions)
        return {name: value.detach().cpu().numpy() for name, value in found.items()}

    return Exercise({"mesh": mesh, "cameras": cameras}, run)


def _targets(
    subject: Subject, cameras: Sequence[Camera], device: str = "cpu", masks: Sequence[np.ndarray] | None = None
) -> SilhouetteTargets:
    """Targets as the core makes them, from views; masks are full where none are given."""
    import torch

    from hir_core.capture import View
    from hir_core.testing.captures import StoredPixels

    masks = masks or [np.ones((c.height, c.width), np.float32) for c in cameras]
    blank = [np.zeros((c.height, c.width, 3), np.float32) for c in cameras]
    views = [View(str(i), c, StoredPixels(blank[i], masks[i].astype(np.float32))) for i, c in enumerate(cameras)]
    targets: SilhouetteTargets = subject.create().prepare(views)
    return targets.to(torch.device(device))


@contract("geometry_renderer")
def coverage_is_in_range(subject: Subject) -> None:
    """`render` gives finite coverage in 0…1 of the shape (views, height, width); empty where nothing is, full inside;
    `overlap` gives an intersection between 0 and the area.
    """
    import torch

    from hir_core.testing.scenes import looking_at, smooth_sphere

    mesh, cameras = smooth_sphere(3), [looking_at((0, 0, DISTANCE), SIZE), looking_at((2, 2, 2.5), SIZE)]
    renderer = subject.create()
    image = renderer.render(mesh, cameras)
    require(tuple(image.shape) == (2, SIZE, SIZE), f"render of 2 views of {SIZE}² has the shape {tuple(image.shape)}")
    require(torch.isfinite(image).all(), "render gives values that are not finite")
    low, high = float(image.min()), float(image.max())
    require(low >= 0 and high <= 1, f"coverage goes from {low:.4g} to {high:.4g}")
    middle, corner = float(image[0, SIZE // 2, SIZE // 2]), float(image[0, 2, 2])
    require(
        middle > 0.95 and corner < 0.05,
        f"a sphere in the middle has coverage {middle:.3g} there, {corner:.3g} in the picture's corner",
    )
    half = np.zeros((SIZE, SIZE), np.float32)
    half[:, : SIZE // 2] = 1
    area, overlap = renderer.overlap(mesh, _targets(subject, cameras, masks=[half, half]))
    sound = (overlap >= -1e-3 * area) & (overlap <= 1.001 * area) & torch.isfinite(area)
    require(sound.all(), f"areas are {area.tolist()}, intersections with half the picture {overlap.tolist()}")


@contract("geometry_renderer")
def area_is_that_of_the_outline(subject: Subject) -> None:
    """The area of a sphere's silhouette is π f² r² / (d² − r²) pixels within 5 %; coverage of `render` sums to it."""
    from hir_core.testing.scenes import looking_at, smooth_sphere

    camera = looking_at((0, 0, DISTANCE), SIZE, FOCAL)
    mesh = smooth_sphere(4)
    renderer = subject.create()
    area, _ = renderer.overlap(mesh, _targets(subject, [camera]))
    expected = _sphere_area(1.0)
    for name, found in (("overlap", float(area[0])), ("render", float(renderer.render(mesh, [camera]).sum()))):
        require(
            abs(found / expected - 1) < TOLERANCE,
            f"by {name} a sphere of radius 1 at distance {DISTANCE:g} covers {found:.1f} pixels, truly {expected:.1f}",
        )


def _sphere_area(radius: float, distance: float = DISTANCE) -> float:
    """Pixels of the outline of a sphere on the optical axis: a circle of radius f r / √(d² − r²)."""
    return float(np.pi * (FOCAL * SIZE) ** 2 * radius**2 / (distance**2 - radius**2))


@contract("geometry_renderer", traits={"differentiable"})
def gradient_is_that_of_the_outline(subject: Subject) -> None:
    """Growing a sphere, moving it away, and moving it across the border of a mask change area and intersection as
    calculus says, within 5 %.
    """
    import torch

    from hir_core.testing.scenes import looking_at, smooth_sphere

    camera = looking_at((0, 0, DISTANCE), SIZE, FOCAL)
    mesh = smooth_sphere(4)
    positions = mesh.positions.clone().requires_grad_()
    half = np.zeros((SIZE, SIZE), np.float32)
    half[:, : SIZE // 2] = 1
    targets = _targets(subject, [camera], masks=[half])
    area, overlap = subject.create().overlap(mesh.with_positions(positions), targets)
    require(area.requires_grad, "the area carries no gradient to the positions, though 'differentiable' is declared")
    by_area = _gradient(area, positions)
    by_overlap = _gradient(overlap, positions)
    focal, d = FOCAL * SIZE, DISTANCE
    # towards the camera is +z; the mask's border runs through the middle, where the outline's chord is 2R and the
    # outline moves by f / (d cos²β) pixels for each unit, sin β = 1/d
    radius = focal / np.sqrt(d**2 - 1)
    right = float(-np.sign(camera.world_to_camera[0, 0]) * 2 * radius * focal / d / (1 - 1 / d**2))
    along_x = torch.tensor([1.0, 0, 0])
    expected = {
        "growing": (float((by_area * mesh.positions).sum()), 2 * np.pi * focal**2 * d**2 / (d**2 - 1) ** 2),
        "moving towards the camera": (float(by_area[:, 2].sum()), 2 * np.pi * focal**2 * d / (d**2 - 1) ** 2),
        "moving across the mask's border": (float((by_overlap * along_x).sum()), right),
    }
    for how, (found, truth) in expected.items():
        require(abs(found / truth - 1) < TOLERANCE, f"{how}, the derivative is {found:.1f}, by calculus {truth:.1f}")
    sideways = float(by_area[:, 0].sum())
    require(
        abs(sideways) < TOLERANCE * abs(expected["growing"][1]),
        f"moving sideways, the area's derivative is {sideways:.1f}, by calculus 0",
    )


def _gradient(value: Tensor, positions: Tensor) -> Tensor:
    import torch

    (found,) = torch.autograd.grad(value.sum(), positions, retain_graph=True)
    return found


@contract("geometry_renderer")
def batch_is_its_singles(subject: Subject) -> None:
    """Several views at once, of different sizes, give what each gives alone (to 1e-4 of its area)."""
    from dataclasses import replace

    import torch

    from hir_core.testing.scenes import looking_at, smooth_sphere

    mesh = smooth_sphere(3)
    wide = replace(looking_at((1, -2, 3), SIZE), width=SIZE - 24)
    cameras = [looking_at((0, 0, DISTANCE), SIZE), looking_at((3, 1, 1), 40), wide]
    renderer = subject.create()
    area, overlap = renderer.overlap(mesh, _targets(subject, cameras))
    together = renderer.render(mesh, cameras)
    for i, camera in enumerate(cameras):
        one_area, one_overlap = renderer.overlap(mesh, _targets(subject, [camera]))
        for name, many, one in (("area", area[i], one_area[0]), ("intersection", overlap[i], one_overlap[0])):
            require(
                abs(float(many - one)) <= 1e-4 * abs(float(one)),
                f"the {name} of view {i} is {float(many):.4f} among three views, {float(one):.4f} alone",
            )
        alone = renderer.render(mesh, [camera])[0]
        part = together[i, : camera.height, : camera.width]
        difference = float((part - alone[: camera.height, : camera.width]).abs().max())
        require(
            difference <= 1e-3,
            f"coverage of view {i} differs by {difference:.3g} between three views at once and it alone",
        )
        outside = together[i].clone()
        outside[: camera.height, : camera.width] = 0
        require(
            not torch.any(outside != 0), f"view {i} is smaller than the largest; beyond its border coverage is not 0"
        )


@contract("geometry_renderer")
def hard_meshes_stay_finite(subject: Subject) -> None:
    """Degenerate and non-manifold meshes, ones behind, around or partly outside of the camera, empty meshes and empty
    batches give finite areas, coverage and gradients.
    """
    import torch

    from hir_core.scene import Mesh, Topology
    from hir_core.testing.scenes import hard_meshes, looking_at, smooth_sphere

    front = looking_at((0, 0, DISTANCE), 48)
    ball = smooth_sphere(2)
    empty = Mesh(torch.zeros(0, 3), Topology(torch.zeros(0, 3, dtype=torch.long)))
    cases = [(name, mesh, front) for name, mesh in hard_meshes()]
    cases += [
        ("a sphere around the camera", ball, looking_at((0, 0, 0.5), 48)),
        ("a sphere behind the camera", ball.with_positions(ball.positions + torch.tensor([0, 0, 9.0])), front),
        (
            "a sphere half outside of the picture",
            ball.with_positions(ball.positions + torch.tensor([1.5, 0, 0])),
            front,
        ),
        ("a mesh without triangles", empty, front),
    ]
    for name, mesh, camera in cases:
        try:
            values = _all_values(subject, mesh, camera)
        except Exception as error:
            require(False, f"on {name} it raises {type(error).__name__}: {error}")
            continue
        for what, value in values.items():
            require(torch.isfinite(value).all(), f"on {name} the {what} is not finite")
    area, overlap = subject.create().overlap(ball, _targets(subject, []))
    require(len(area) == 0 and len(overlap) == 0, f"without views there are {len(area)} areas")


def _all_values(subject: Subject, mesh: Mesh, camera: Camera) -> dict[str, Tensor]:
    import torch

    renderer = subject.create()
    positions = mesh.positions.clone().requires_grad_()
    area, overlap = renderer.overlap(mesh.with_positions(positions), _targets(subject, [camera]))
    values = {"area": area, "intersection": overlap, "coverage": renderer.render(mesh, [camera])}
    if area.requires_grad:
        total = area.sum() + overlap.sum()
        (gradient,) = torch.autograd.grad(total, positions, allow_unused=True)
        if gradient is not None:
            values["gradient"] = gradient
    return values
