"""Cameras and their files: no depth, no angle, quaternions without length one, mirrored and sign-flipped matrices."""

from __future__ import annotations

import numpy as np

from hir_core.capture import Camera, similarity_scale
from hir_core.capture.lens import Lens
from hir_core.capture.rotations import rotation_from_quaternion
from hir_core.testing.captures import similarity_between
from hir_plugins.initializers.existing_mesh.mesh_alignment import _unit_from_points
from hir_plugins.readers.parsing.camera_axes import rigid_inverse, rigid_transform
from hir_plugins.readers.parsing.pose_files import decompose_projection
from hir_plugins.readers.parsing.upright import upright_rotation
from tests.stability.case import Case

_PINHOLE = (100.0, 100.0, 50.0, 50.0)


def _lenses() -> list[Case]:
    cases = []
    for r in (0.0, 1e-200):
        lens = Lens(_PINHOLE, (0.1, 0.01, 0.0, 0.0), "fisheye", (1.0, 1.0, 0.0, 0.0))
        cases.append(
            Case(
                "initialization",
                "hir_core.capture.lens.Lens.distort",
                f"fisheye, {r:g} off the axis",
                "θ/r is 1 on the axis",
                lambda r=r, lens=lens: lens.distort(np.array([[r, 0.0]]))[0, 0] - 50.0,
                "atan2(r, 1) * (1 + 0.1 * atan2(r, 1)**2) / r * r * 100",
                "r * 100",
                {"r": r},
            )
        )
    for depth in (0.0, 1e-300):
        camera = Camera(np.diag([100.0, 100.0, 1.0]), np.eye(4), 10, 10)
        cases.append(
            Case(
                "geometry",
                "hir_core.capture.Camera.project",
                f"a point at depth {depth:g}",
                "0 values that are not finite",
                lambda c=camera, z=depth: float((~np.isfinite(c.project(np.array([[1.0, 1.0, z]]))[0])).sum()),
                lambda z=depth: float((~np.isfinite(np.float32(100) / np.float32(z))).sum()),
                0.0,
                formula="f·x/z",
            )
        )
    return cases


def _rotations() -> list[Case]:
    cases = []
    for q in ((1.8, 0.2, -0.8, 0.4), (1e-6, 2e-6, 0, 0), (3.0, 1.0, -2.0, 0.5), (1e8, 1e8, 0, 0)):
        cases.append(
            Case(
                "initialization",
                "hir_core.capture.rotations.rotation_from_quaternion",
                f"a quaternion of length {np.linalg.norm(q):.3g}",
                "a rotation: RᵀR = 1",
                lambda q=q: np.abs((r := rotation_from_quaternion(np.array(q))).T @ r - np.eye(3)).max(),
                lambda q=q: np.abs((r := _plain_quaternion(*q)).T @ r - np.eye(3)).max(),
                0.0,
                tolerance=1e-12,
                formula="1 − 2(y² + z²), … of the numbers as they are",
            )
        )
    turn = rotation_from_quaternion(np.array([0.9, 0.1, -0.4, 0.2]))
    for scale in (1e-3, 1.0001, 50.0):
        matrix = np.eye(4)
        matrix[:3, :3] = (turn * scale).astype(np.float32)
        cases.append(
            Case(
                "initialization",
                "hir_plugins.readers.parsing.camera_axes.rigid_transform",
                f"axes of length {scale:g} in float32",
                "a rotation to 1e-12: RᵀR = 1",
                lambda m=matrix: np.abs((r := rigid_transform(m, "it")[:3, :3]).T @ r - np.eye(3)).max(),
                lambda m=matrix: np.abs((r := m[:3, :3]).T @ r - np.eye(3)).max(),
                0.0,
                tolerance=1e-12,
                formula="the matrix as it is",
            )
        )
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, [1e7, -2e7, 3e6]
    cases.append(
        Case(
            "initialization",
            "hir_plugins.readers.parsing.camera_axes.rigid_transform_inverse",
            "a camera 2·10⁷ m from the origin",
            "the rotation's transpose, exactly",
            lambda: rigid_inverse(pose)[:3, :3],
            lambda: np.linalg.inv(pose.astype(np.float32))[:3, :3],
            lambda: turn.T,
            tolerance=1e-15,
            formula="inv(pose)",
        )
    )
    intrinsics, p = np.array([[900.0, 0, 320], [0, 910, 240], [0, 0, 1]]), np.eye(4)
    p[:3, :3], p[:3, 3] = turn, [0.1, 0.2, 4.0]
    for factor in (-1.0, -1e-5, 1e5):
        projection = factor * (intrinsics @ p[:3])
        cases.append(
            Case(
                "initialization",
                "hir_plugins.readers.parsing.pose_files.decompose_projection",
                f"a projection times {factor:g}",
                "positive focal lengths, a right-handed camera",
                lambda m=projection: [
                    np.diag(decompose_projection(m, "it")[0]),
                    [np.linalg.det(decompose_projection(m, "it")[1][:3, :3])] * 3,
                ],
                lambda m=projection: _plain_rq(m),
                lambda: [[900.0, 910.0, 1.0], [1.0] * 3],
                tolerance=1e-9,
                formula="RQ decomposition as it comes",
            )
        )
    return cases


def _plain_quaternion(w: float, x: float, y: float, z: float) -> np.ndarray:
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def _plain_rq(projection: np.ndarray) -> list:  # type: ignore[type-arg]
    from scipy.linalg import rq

    k, r = rq(projection[:, :3])
    return [np.diag(k), [np.linalg.det(r)] * 3]


def _similarities() -> list[Case]:
    cases = []
    for scale in (2.0, 0.01):
        mirror = np.diag([-scale, scale, scale, 1.0])
        cases.append(
            Case(
                "initialization",
                "hir_core.capture.similarity_scale",
                f"a mirrored similarity of scale {scale:g}",
                "the scale",
                lambda m=mirror: similarity_scale(m),
                lambda m=mirror: np.linalg.det(m[:3, :3]) ** (1 / 3),
                scale,
                tolerance=1e-12,
                formula="det(A) ** (1/3)",
            )
        )
    random = np.random.default_rng(0)
    for name, shape in (("in a plane", [1.0, 1.0, 0.0]), ("on a line", [1.0, 0.0, 0.0])):
        points = random.normal(size=(40, 3)) * shape
        flipped = points * [-1.0, 1.0, 1.0]
        cases.append(
            Case(
                "initialization",
                "hir_core.testing.captures.similarity_between",
                f"points {name} and their mirror image",
                "a rotation, no reflection: det R = 1",
                lambda a=points, b=flipped: np.linalg.det(_rotation_of(similarity_between(a, b)[0])),
                lambda a=points, b=flipped: np.linalg.det(_kabsch(a, b)),
                1.0,
                tolerance=1e-9,
                formula="R = U Vᵀ",
            )
        )
    same = np.ones((50, 3))
    cases.append(
        Case(
            "initialization",
            "hir_plugins.initializers.existing_mesh.mesh_alignment._unit_from_points",
            "all points equal",
            "their position, at scale 1",
            lambda: _unit_from_points(same),
            lambda: np.eye(4)[:3] / np.median(np.linalg.norm(same - same.mean(0), axis=1)),
            lambda: np.array([[1.0, 0, 0, -1], [0, 1, 0, -1], [0, 0, 1, -1], [0, 0, 0, 1]]),
            formula="A / spread",
        )
    )
    opposite = [np.eye(4), np.diag([1.0, -1.0, -1.0, 1.0])]
    down, level = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, -1, 0, 0], [0, 0, 0, 1]]), np.diag([1.0, -1, -1, 1])
    upside = np.diag([-1.0, -1, 1, 1]) @ down
    for name, poses in (
        ("one upright and one on its head", opposite),
        ("of which the first looks straight down", [down, upside, level]),
    ):
        cases.append(
            Case(
                "initialization",
                "hir_plugins.readers.parsing.upright.upright_rotation",
                f"cameras {name}",
                "a rotation: RᵀR = 1",
                lambda p=poses: np.abs((r := upright_rotation(p)[:3, :3]).T @ r - np.eye(3)).max(),
                lambda p=poses: np.abs((r := _plain_upright(p)).T @ r - np.eye(3)).max(),
                0.0,
                tolerance=1e-9,
                formula="up = normalize(Σ ups); z = normalize(back − (back·up) up)",
            )
        )
    return cases


def _rotation_of(similarity: np.ndarray) -> np.ndarray:
    return similarity[:3, :3] / similarity_scale(similarity)


def _kabsch(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    u, _, vt = np.linalg.svd((b - b.mean(0)).T @ (a - a.mean(0)))
    rotation = u @ vt
    # which sign a vanishing singular value's vector gets is the library's whim: take the one that reflects
    return rotation if np.linalg.det(rotation) < 0 else u @ np.diag([1.0, 1.0, -1.0]) @ vt


def _plain_upright(poses: list[np.ndarray]) -> np.ndarray:
    up = np.mean([-p[1, :3] for p in poses], axis=0)
    up = up / np.linalg.norm(up)
    back = -poses[0][2, :3]
    z = back - (back @ up) * up
    z = z / np.linalg.norm(z)
    return np.stack([np.cross(up, z), up, z])


CASES = [*_lenses(), *_rotations(), *_similarities()]
