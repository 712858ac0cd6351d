"""Hard cases from papers on numerical errors in geometry and rendering; each naive formula fails in float64 too."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import torch
from hir_exporters.light.environment_map import harmonic_basis
from hir_exporters.materials import brdf_numpy
from hir_exporters.mesh.tangent_frames import tangent_frames
from hir_exporters.metallic_parameters import base_color_of, effective_albedos

from hir_core.capture import Pixels
from hir_core.capture.lens import Lens, undistort
from hir_core.capture.rotations import quaternion_from_rotation
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.mesh.remeshing import surface_area
from hir_core.metrics.light_metrics import angular_error_deg, scale_invariant_error
from hir_core.metrics.surface_metrics import angles_deg, f_score
from hir_core.scene import Mesh, Topology
from hir_core.stages.geometry.confirmed_movement import confirmed_share, interpolated
from hir_plugins.reflectance_renderers import brdf_torch
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.fit.smoothness import SmoothnessWeights, smoothness_energy
from tests.stability.case import DIGITS, Case
from tests.stability.cases_brdf import visible_normal_of

_ACOS = "acos(a·b)"


def _angles() -> list[Case]:
    """Kahan 2006, *How Futile are Mindless Assessments of Roundoff in Floating-Point Computation?*, section 12."""
    cases = []
    for name, angle in (("1e-9 rad apart", 1e-9), ("1e-9 rad from opposite", math.pi - 1e-9)):
        a, b = np.array([[1.0, 0, 0]]), np.array([[math.cos(angle), math.sin(angle), 0]])
        with mpmath.workdps(DIGITS):
            truth = float(mpmath.degrees(mpmath.atan2(mpmath.mpf(b[0, 1]), mpmath.mpf(b[0, 0]))))
        cases.append(
            Case(
                "geometry",
                "hir_core.metrics.surface_metrics.angles_deg",
                f"two normals {name}",
                "the angle to 12 digits",
                lambda a=a, b=b: angles_deg(a, b)[0],
                lambda a=a, b=b: math.degrees(math.acos(min(1.0, max(-1.0, float(a[0] @ b[0]))))),
                truth,
                tolerance=1e-12,
                formula=_ACOS,
            )
        )
    first, second = np.array([[0.2, 0.5, 0.8]]), np.array([[0.2, 0.5, 0.8 + 1e-9]])
    with mpmath.workdps(DIGITS):
        u, v = ([mpmath.mpf(float(x)) for x in c[0]] for c in (first, second))
        dot = sum(x * y for x, y in zip(u, v, strict=True))
        lengths = mpmath.sqrt(sum(x * x for x in u) * sum(x * x for x in v))
        between = float(mpmath.degrees(mpmath.acos(dot / lengths)))
    cases.append(
        Case(
            "reflectance",
            "hir_core.metrics.light_metrics.angular_error_deg",
            "two colours that differ by 1e-9",
            "the angle to 6 digits",
            lambda: angular_error_deg(first, second),
            lambda: math.degrees(
                math.acos(min(1.0, float((first @ second.T)[0, 0]) / np.linalg.norm(first) / np.linalg.norm(second)))
            ),
            between,
            tolerance=1e-6,
            formula=_ACOS,
        )
    )
    return cases


def _needles() -> list[Case]:
    """Kahan 2014, *Miscalculating Area and Angles of a Needle-like Triangle*."""
    cases = []
    for name, corners in (
        ("a needle with sides 1, 1 and 1e-10", [[0.0, 0, 0], [1, 0, 0], [1, 1e-10, 0]]),
        ("a flat triangle of height 1e-9", [[0.0, 0, 0], [1, 0, 0], [0.5, 1e-9, 0]]),
    ):
        p = np.array(corners)
        cases.append(
            Case(
                "geometry",
                "hir_core.mesh.remeshing.surface_area",
                name,
                "half of base times height",
                lambda p=p: surface_area(p, np.array([[0, 1, 2]])),
                lambda p=p: _heron(p),
                float(p[2, 1] / 2),
                tolerance=1e-12,
                formula="√(s(s−a)(s−b)(s−c)), s = (a+b+c)/2 (Heron)",
            )
        )
    return cases


def _heron(p: np.ndarray) -> float:
    a, b, c = (float(np.linalg.norm(p[i] - p[j])) for i, j in ((0, 1), (1, 2), (2, 0)))
    s = (a + b + c) / 2
    return math.sqrt(s * (s - a) * (s - b) * (s - c))


def _watertight() -> list[Case]:
    """Woop, Benthin & Wald 2013, *Watertight Ray/Triangle Intersection*."""
    random = np.random.default_rng(0)
    grid = 2.0**-18  # corners, points of the edge, origins and directions are exact in float32
    corners = (
        4
        * grid
        * np.round(np.array([[-1.021, -1.013, 0.07], [1.031, -0.9, 0.3], [1.1, 1.02, 0], [-1, 0.9, 0.3]]) / grid / 4)
    )
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    targets = corners[0] + (corners[2] - corners[0]) * random.integers(1, 4, (20_000, 1)) / 4
    origins = grid * np.round((random.normal(size=(20_000, 3)) * 0.2 + [0, 0, 3]) / grid)
    directions = targets - origins
    return [
        Case(
            "geometry",
            "hir_core.mesh.ray_casting.MeshQueries.first_faces",
            "20,000 rays at the edge that two triangles share",
            "0 rays pass between them",
            lambda: float((MeshQueries(corners, faces).first_faces(origins, directions) < 0).sum()),
            lambda: float((~np.any([_hits(corners[f], origins, directions) for f in faces], axis=0)).sum()),
            0.0,
            formula="u ≥ 0, v ≥ 0, u + v ≤ 1 of each triangle, in float64 (Möller & Trumbore 1997)",
        )
    ]


def _hits(triangle: np.ndarray, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    (a, b, c), o, d = triangle, origins, directions
    p = np.cross(d, c - a)
    scale = 1 / (p @ (b - a))
    u = ((o - a) * p).sum(axis=1) * scale
    q = np.cross(o - a, b - a)
    v = (d * q).sum(axis=1) * scale
    return np.asarray((u >= 0) & (v >= 0) & (u + v <= 1))


def _rotations() -> list[Case]:
    """Shepperd 1978, *Quaternion from Rotation Matrix*."""
    cases = []
    for name, angle in (("half a turn", math.pi), ("1e-9 rad less than half a turn", math.pi - 1e-9)):
        axis = np.array([1.0, 2, 2]) / 3
        cross = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
        rotation = np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross
        cases.append(
            Case(
                "initialization",
                "hir_core.capture.rotations.quaternion_from_rotation",
                f"a rotation by {name}",
                "its axis, up to sign",
                lambda r=rotation: np.abs(quaternion_from_rotation(r)[1:]),
                lambda r=rotation: np.abs(_from_trace(r)),
                lambda a=axis: a,
                tolerance=1e-12,
                formula="w = √(1 + tr R)/2; (x, y, z) = (R₃₂ − R₂₃, R₁₃ − R₃₁, R₂₁ − R₁₂) / 4w",
            )
        )
    return cases


def _from_trace(r: np.ndarray) -> np.ndarray:
    w = np.sqrt(max(0.0, 1 + np.trace(r))) / 2
    return np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4 * w)


def _frames_and_harmonics() -> list[Case]:
    """Duff et al. 2017, *Building an Orthonormal Basis, Revisited*; Sloan 2013, *Efficient Spherical Harmonic
    Evaluation*.
    """
    down = np.array([[0.0, 0.0, -1.0]])
    pole = np.array([0.0, 0.0, 1.0])
    return [
        Case(
            "export",
            "hir_exporters.mesh.tangent_frames.tangent_frames",
            "the direction (0, 0, −1)",
            "three axes at right angles, of length 1",
            lambda: float(np.abs(tangent_frames(down)[0].T @ tangent_frames(down)[0] - np.eye(3)).max()),
            lambda: np.abs(_frisvad(down[0]) @ _frisvad(down[0]).T - np.eye(3)).max(),
            0.0,
            tolerance=1e-12,
            formula="a = 1/(1 + z); t = (1 − x²a, −xya, −x); b = (−xya, 1 − y²a, −y)",
        ),
        Case(
            "export",
            "hir_exporters.light.environment_map.harmonic_basis",
            "the pole of the polar angles",
            "Y₁ and Y₂ of m ≠ 0 are 0",
            lambda: harmonic_basis(pole)[[1, 3, 4, 5, 7, 8]],
            lambda: np.array([np.divide(x, np.hypot(pole[0], pole[1])) * 0.0 for x in (*pole[:2], 0.0, 0, 0, 0)]),
            lambda: np.zeros(6),
            formula="sin θ · x / √(x² + y²), …",
        ),
    ]


def _frisvad(n: np.ndarray) -> np.ndarray:
    x, y, z = n
    a = 1 / (1 + z)
    return np.array([[1 - x * x * a, -x * y * a, -x], [-x * y * a, 1 - y * y * a, -y], n])


def _microfacets() -> list[Case]:
    """Heitz 2014 and 2018 (visible normals, masking), Walter et al. 2007 (GGX)."""
    tiny = 1e-200
    cases = [
        Case(
            "export",
            "hir_exporters.materials.brdf_numpy.smith_visibility",
            f"α = {alpha:g}, both cosines 1e-200",
            "1/α²: the cosines cancel",
            lambda a=alpha: brdf_numpy.smith_visibility(tiny, tiny, a),
            lambda a=alpha: _masked(a, tiny, tiny) / np.float64(4 * tiny * tiny),
            alpha**-2,
            tolerance=1e-12,
            formula="G₁(i) G₁(o) / (4 (n·i)(n·o))",
        )
        for alpha in (1e-3, 0.3)
    ]
    half = math.sqrt(0.5)
    cases.append(
        Case(
            "reflectance",
            "hir_plugins.reflectance_renderers.brdf_torch.specular_lobe",
            "float64, α = 0.3, both cosines 1e-200",
            "D·(n·i)/α²/… with the n·o cancelled",
            lambda: (
                brdf_torch.specular_lobe(*(torch.tensor(v, dtype=torch.float64) for v in (0.3, tiny, tiny, half)))
                / tiny
            ),
            lambda: np.float64(_ggx(0.3, half)) * _masked(0.3, tiny, tiny) / np.float64(4 * tiny * tiny),
            lambda: _ggx(0.3, half) / 0.09,
            tolerance=1e-12,
            formula="D·G₁(i)·G₁(o) / (4 (n·i)(n·o)) · (n·i)",
        )
    )
    for alpha in (1e-4, 0.3):
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit.visible_normal",
                f"α = {alpha:g}, seen along the normal, the middle of the cap",
                "tan θ = α",
                lambda a=alpha: _tangent_of_visible(a),
                lambda: float(np.float64(0.0) / np.hypot(0.0, 0.0)),
                alpha,
                tolerance=1e-5,
                formula="T₁ = (−o_y, o_x, 0) / √(o_x² + o_y²) (Heitz 2018)",
            )
        )
    return cases


def _ggx(alpha: float, cosine: float) -> float:
    return alpha**2 / (math.pi * (cosine**2 * (alpha**2 - 1) + 1) ** 2)


def _masked(alpha: float, i: float, o: float) -> np.float64:
    """G of two directions."""
    first, second = (2 * c / (c + math.sqrt(alpha**2 + (1 - alpha**2) * c * c)) for c in (i, o))
    return np.float64(first * second)


def _tangent_of_visible(alpha: float) -> float:
    h = visible_normal_of((0.0, 0.0, 1.0), alpha, area=0.5, turn=0.5)
    return float(np.linalg.norm(h[:2]) / h[2])


def _energy() -> list[Case]:
    """Kulla & Conty 2017: the share of light that a lobe leaves for what lies below it."""
    return [
        Case(
            "export",
            "hir_exporters.materials.brdf_numpy.albedo_table",
            "F0 = 1 at every angle and width",
            "0 texels whose lobe reflects more than all light",
            lambda: float((brdf_numpy.albedo_table().sum(axis=-1) > 1 + 1e-12).sum()),
            lambda: float((_unlimited_table() > 1 + 1e-12).sum()),
            0.0,
            formula="A + B as interpolated between the nodes of the quadrature",
        ),
        Case(
            "reflectance",
            "hir_plugins.reflectance_renderers.transport_ggx.fit.smoothness.smoothness_energy",
            "float64, an albedo of e⁻⁸⁰⁰ beside one of e⁻⁷⁰⁰",
            "the difference of the logarithms",
            _log_albedo_energy,
            lambda: abs(np.log(_sigmoid(-800.0)) - np.log(_sigmoid(-700.0))),
            100.0,
            tolerance=1e-3,
            formula="log(1 / (1 + exp(−x)))",
        ),
        Case(
            "export",
            "hir_exporters.metallic_parameters.base_color_of",
            "metalness 1, and back",
            "the base colour",
            _base_color_of_metal,
            lambda: np.zeros(3) / np.float64(0.0),
            lambda: [0.9, 0.6, 0.3],
            tolerance=1e-6,
            formula="ρd / (1 − m)",
        ),
    ]


def _unlimited_table() -> np.ndarray:
    rows, columns = (np.linspace(0.0, 1.0, count) for count in brdf_numpy._QUADRATURE_NODES)
    lowest = np.sqrt(brdf_numpy.ALPHA_MIN)
    nodes = brdf_numpy.integrate_albedo(rows[:, None] ** 2, (lowest + (1 - lowest) * columns[None, :]) ** 2)
    down, along = (brdf_numpy._cubic_weights(count, brdf_numpy.TABLE_SIZE) for count in brdf_numpy._QUADRATURE_NODES)
    return np.asarray(down @ (nodes[0] + nodes[1]) @ along.T)


def _sigmoid(x: float) -> np.float64:
    return np.float64(1.0) / (1 + np.exp(-np.float64(x)))


def _log_albedo_energy() -> float:
    diffuse = torch.tensor([[-800.0], [-700.0]], dtype=torch.float64)
    parameters = Parameters(torch.zeros(2, 4, 3, dtype=torch.float64), diffuse, None, None)
    weights = SmoothnessWeights(light=0.0, light_chroma=0.0, albedo=1.0)
    return float(smoothness_energy(parameters, weights, torch.tensor([[0, 1]])))


def _base_color_of_metal() -> np.ndarray:
    base, m, f0 = np.array([0.9, 0.6, 0.3], np.float32), np.float32(1.0).reshape(()), 0.04
    return base_color_of(*effective_albedos(base, m, f0), m, f0)


def _compositing() -> list[Case]:
    """Porter & Duff 1984, *Compositing Digital Images*: colours are filtered after multiplication by alpha."""
    return [
        Case(
            "initialization",
            "hir_core.capture.lens.undistort",
            "the edge of a white object before black, resampled",
            "white where the mask is more than nothing",
            lambda: _darkest_of_the_object(True),
            lambda: _darkest_of_the_object(False),
            1.0,
            tolerance=1e-6,
            formula="the colour resampled without the mask",
        )
    ]


def _darkest_of_the_object(ours: bool) -> float:
    mask = np.zeros((8, 8), np.float32)
    mask[2:6, 2:6] = 1.0
    lens = Lens((8.0, 8.0, 4.0, 4.0), (), "radial", (8.0, 8.0, 3.5, 3.5))
    flat = np.repeat(mask[..., None], 3, axis=2)
    found = undistort(Pixels(flat, mask if ours else None, np.zeros((8, 8), bool)), lens)
    known = undistort(Pixels(flat, mask, np.zeros((8, 8), bool)), lens).mask
    return float(found.color_linear[known > 0.01].min())


def _decisions() -> list[Case]:
    """Quotients of sums that are all 0; a movement of vertices that a difference would lose."""
    far = torch.tensor([[1e17, 0.0, 0.0]], dtype=torch.float64)
    near = torch.tensor([[1.0, 0.0, 0.0]], dtype=torch.float64)
    topology = Topology(torch.tensor([[0, 0, 0]]))
    black = np.zeros((2, 3))
    return [
        Case(
            "geometry",
            "hir_core.stages.geometry.confirmed_movement.interpolated",
            "a vertex that goes all the way from 1e17 to 1",
            "1",
            lambda: interpolated(Mesh(far, topology), Mesh(near, topology), 1.0).positions[0, 0],
            lambda: float(far[0, 0] + 1.0 * (near[0, 0] - far[0, 0])),
            1.0,
            formula="a + t (b − a)",
        ),
        Case(
            "geometry",
            "hir_core.stages.geometry.confirmed_movement.confirmed_share",
            "meshes that explain six views equally well",
            "no movement",
            lambda: confirmed_share([0, 0.5, 1], np.full((3, 6), 0.04), 0.005).share,
            lambda: np.float64(0.0) / np.float64(0.0),
            0.0,
            formula="g² / (g² + s²)",
        ),
        Case(
            "geometry",
            "hir_core.metrics.surface_metrics.f_score",
            "no point within the threshold",
            "0",
            lambda: f_score(0.0, 0.0),
            lambda: np.float64(0.0) / np.float64(0.0),
            0.0,
            formula="2pr / (p + r)",
        ),
        Case(
            "reflectance",
            "hir_core.metrics.light_metrics.scale_invariant_error",
            "a black light",
            "scale 0, the whole error",
            lambda: scale_invariant_error(black, black + 0.5, np.ones(2)),
            lambda: [np.float64(0.0) / np.float64(0.0), 0.0],
            lambda: [0.0, 1.0],
            formula="Σ fit·truth / Σ fit²",
        ),
    ]


CASES = [
    *_angles(),
    *_needles(),
    *_watertight(),
    *_rotations(),
    *_frames_and_harmonics(),
    *_microfacets(),
    *_energy(),
    *_compositing(),
    *_decisions(),
]
