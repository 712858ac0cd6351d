"""Pixels that one smooth part of a surface fills: a sphere, a cube and a step, whose outlines are known."""

from __future__ import annotations

import numpy as np
import torch

from hir_core.capture import Camera
from hir_core.scene import Mesh, Topology
from hir_core.testing.scenes import looking_at, smooth_sphere
from hir_plugins.commands.bench.inputs.bench_shapes import make_mesh
from hir_plugins.commands.bench.inputs.uniform_pixels import uniform_pixels
from hir_plugins.commands.bench.suites.shading_suite import radiance_errors

SIZE = 24
FOCAL = 1.5
"""In widths of the image, as `looking_at` has it."""


def test_the_outline_of_a_sphere_is_not_uniform() -> None:
    distance = 4.0
    uniform = uniform_pixels(smooth_sphere(4), looking_at((0.0, 0.0, distance), SIZE)).reshape(SIZE, SIZE)
    row, column = np.indices((SIZE, SIZE)) + 0.5
    outline = FOCAL * SIZE / np.sqrt(distance**2 - 1)
    from_center = np.hypot(row - SIZE / 2, column - SIZE / 2)
    assert not uniform[from_center > outline - 0.5].any() and uniform[from_center < 0.8 * outline].all()


def test_the_edge_of_a_cube_is_not_uniform_and_its_faces_are() -> None:
    corners = np.array([[x, y, z] for x in (-1.0, 1) for y in (-1.0, 1) for z in (-1.0, 1)])
    quads = np.array([[4, 6, 7, 5], [1, 5, 7, 3]])
    cube = make_mesh(corners, np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]))
    # an odd number of pixels: the edge x = z = 1 lies in the middle of the central column
    camera = looking_at((3.0, 0.0, 3.0), SIZE + 1)
    middle = uniform_pixels(cube, camera).reshape(SIZE + 1, SIZE + 1)[SIZE // 2]
    assert not middle[SIZE // 2] and middle[SIZE // 2 - 4 : SIZE // 2].all() and middle[SIZE // 2 + 1 :][:4].all()


def test_a_step_between_parallel_planes_is_not_uniform() -> None:
    near = [[-9, -9, 0], [0, -9, 0], [0, 9, 0], [-9, 9, 0]]
    far = [[0, -9, -1], [9, -9, -1], [9, 9, -1], [0, 9, -1]]
    planes = make_mesh(np.array(near + far, dtype=float), np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]))
    pose = np.diag([1.0, -1.0, -1.0, 1.0])
    pose[:3, 3] = [0.0, 0.0, 5.0]
    camera = Camera(np.array([[9.0, 0, 4.5], [0, 9.0, 4.5], [0, 0, 1]]), pose, 9, 9)
    uniform = uniform_pixels(planes, camera).reshape(9, 9)
    assert not uniform[:, 4].any() and uniform[:, :4].all() and uniform[:, 5:].all()


def test_a_mesh_without_extent_has_no_uniform_pixel() -> None:
    point = Mesh(torch.zeros(3, 3), Topology(torch.tensor([[0, 1, 2]])))
    assert not uniform_pixels(point, looking_at((0.0, 0.0, 4.0), SIZE)).any()


def test_errors_of_outline_and_inside_are_separate() -> None:
    reference = torch.full((4, 3), 2.0)
    reference[3] = 0  # the background
    radiance = torch.tensor([[2.2] * 3, [1.8] * 3, [3.0] * 3, [9.0] * 3])
    errors = radiance_errors(radiance, reference, np.array([True, True, False, False]))
    assert {name: round(value, 6) for name, value in errors.items()} == {
        "mean error": 0.1,
        "bias": 0.0,
        "outline error": 0.5,
    }
