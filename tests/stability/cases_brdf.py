"""BRDF terms at the limits of their range: lobes narrower than float32, grazing directions, no half vector."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import torch
from hir_exporters.materials import brdf_numpy as numpy_brdf

from hir_plugins.reflectance_renderers import brdf_torch
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import tangent_frame
from tests.stability.case import Case

_GGX = "a*a / (pi * (c*c*(a*a - 1) + 1)**2)"
_GGX_TRUTH = "a*a / (pi * (cos(t)**2*(a*a - 1) + 1)**2)"
_LOBE = "a*a / (pi * (c*c*(a*a - 1) + 1)**2) * (2*i/(i + sqrt(a*a + (1-a*a)*i*i))) * (2*o/(o + sqrt(a*a + (1-a*a)*o*o))) / (4*i*o) * i"  # noqa: E501
_LOBE_TRUTH = (
    "a*a / (pi * (c*c*(a*a - 1) + 1)**2) * (2*i/(i + sqrt(a*a + (1-a*a)*i*i))) * 2/(o + sqrt(a*a + (1-a*a)*o*o)) / 4"
)


def _t(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float32)


def _narrow_lobes() -> list[Case]:
    cases = []
    for alpha, angle in (
        (1e-4, 3e-5),
        (1e-4, 1e-4),
        (1e-4, 1e-3),
        (1e-3, 1e-4),
        (1e-3, 1e-3),
        (1e-3, 1e-2),
        (1e-2, 1e-3),
        (1e-2, 3e-3),
        (3e-2, 1e-2),
    ):
        cosine, squared = np.float32(math.cos(angle)), np.float32(math.sin(angle) ** 2)
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.brdf_torch.ggx_d",
                f"α = {alpha:g}, half vector {angle:g} rad off the normal",
                "the peak of a lobe narrower than 1 − cos θ resolves",
                lambda a=alpha, c=cosine, s=squared: brdf_torch.ggx_d(_t(float(c)), _t(a), _t(float(s))),
                _GGX,
                _GGX_TRUTH,
                {"a": alpha, "c": float(cosine)},
                {"t": mpmath.mpf(angle), "a": mpmath.mpf(float(np.float32(alpha)))},
                tolerance=2e-6,
            )
        )
    for alpha, angle in ((1e-4, 0.0), (1e-4, 1e-4), (1e-3, 1e-3)):
        cosine64 = math.cos(angle)
        cases.append(
            Case(
                "export",
                "hir_exporters.materials.brdf_numpy.ggx_distribution",
                f"float64, α = {alpha:g}, half vector {angle:g} rad off",
                "the peak to 10 digits",
                lambda a=alpha, c=cosine64: numpy_brdf.ggx_distribution(c, a),
                _GGX,
                _GGX,
                {"a": alpha, "c": cosine64},
                {"a": mpmath.mpf(alpha), "c": mpmath.mpf(cosine64)},
                tolerance=1e-10,
            )
        )
    return cases


def _grazing() -> list[Case]:
    cases = []
    for alpha, i, o in ((0.3, 0.5, 0.0), (0.3, 0.0, 0.0), (1e-4, 0.5, 0.0)):
        values = {"a": alpha, "i": i, "o": o, "c": 0.9}
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.brdf_torch.specular_lobe",
                f"α = {alpha:g}, n·i = {i:g}, n·o = {o:g}",
                "finite: n·o cancels",
                lambda v=values: brdf_torch.specular_lobe(_t(v["a"]), _t(v["i"]), _t(v["o"]), _t(v["c"])),
                _LOBE,
                _LOBE_TRUTH if i else 0.0,
                values,
                tolerance=1e-5,
            )
        )
    for name, wi, wo in (("along the surface", (1.0, 0, 0), (-1.0, 0, 0)), ("across it", (0, 0, 1.0), (0, 0, -1.0))):
        i, o = np.array(wi, np.float32), np.array(wo, np.float32)
        cases.append(
            Case(
                "export",
                "hir_exporters.materials.brdf_numpy.half_vector_cosines",
                f"opposite directions {name}: no half vector",
                "n·h = h·o = 0",
                lambda i=i, o=o: np.array(numpy_brdf.half_vector_cosines(i, o)[2:]),
                lambda i=i, o=o: [((i + o) / np.linalg.norm(i + o))[2], ((i + o) / np.linalg.norm(i + o)) @ o],
                lambda: [0.0, 0.0],
                formula="h = (i + o) / |i + o|",
            )
        )
    for alpha in (1e-4, 0.1, 1.0):
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit.visible_normal",
                f"α = {alpha:g}, seen along the surface, the last point of the cap",
                "a unit vector above the surface",
                lambda a=alpha: _last_normal(a),
                lambda a=alpha: _naive_visible(np.float32(a)),
                lambda: [1.0, 1.0],
                formula="c = (√(1−z²)cos φ, √(1−z²)sin φ, z) + o; h = normalize(α c_x, α c_y, c_z)",
                tolerance=1e-6,
            )
        )
    return cases


def _last_normal(alpha: float) -> list[float]:
    """Length, and whether it points up."""
    h = visible_normal_of((1.0, 0.0, 0.0), alpha, area=1.0, turn=0.5)
    return [float(np.linalg.norm(h)), float(h[2] > 0)]


def visible_normal_of(eye: tuple[float, float, float], alpha: float, area: float, turn: float) -> np.ndarray:
    """The renderer's visible normal at a point of the unit square."""
    import mitsuba as mi

    mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.mitsuba_ggx.brdf_drjit import visible_normal

    return np.array(visible_normal(mi.Vector3f(*eye), mi.Float(alpha), mi.Point2f(area, turn)))[:, 0]


def _naive_visible(alpha: np.float32) -> list[np.float32]:
    phi, z = np.float32(np.pi), np.float32(0.0)
    r = np.sqrt(1 - z * z)
    c = np.array([np.round(r * np.cos(phi), 6) + 1, np.round(r * np.sin(phi), 6), z], np.float32)
    h = c * [alpha, alpha, 1]
    h = h / np.linalg.norm(h)
    return [np.linalg.norm(h), np.float32(h[2] > 0)]


def _frames() -> list[Case]:
    cases = []
    for normal_offset in (0.0, 1e-4, 3e-4, 1e-3):
        normal = np.array([math.sin(normal_offset), 0, -math.cos(normal_offset)], np.float32)
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface.tangent_frame",
                f"normal {normal_offset:g} rad from −z, where a frame of one sign has its pole",
                "tangents at right angles, of length 1",
                lambda n=normal: _skew(*(v[0].numpy() for v in tangent_frame(torch.from_numpy(n)[None])), n),
                lambda n=normal: _skew(*_frisvad(n), n),
                0.0,
                tolerance=1e-6,
                formula="a = 1/(1 + z); t = (1 − x²a, −xya, −x); b = (−xya, 1 − y²a, −y)",
            )
        )
    return cases


def _skew(t: np.ndarray, b: np.ndarray, n: np.ndarray) -> float:
    axes = np.stack([t, b, n]).astype(np.float64)
    return float(np.abs(axes @ axes.T - np.eye(3)).max())


def _frisvad(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x, y, z = n
    a = np.float32(1) / (1 + z)
    return np.array([1 - x * x * a, -x * y * a, -x]), np.array([-x * y * a, 1 - y * y * a, -y])


def _albedo() -> list[Case]:
    cases = []
    for cosine, alpha in ((0.0, 0.3), (0.0, 1e-4), (1.0, 1e-4)):

        def slope(c: float = cosine, a: float = alpha, ours: bool = True) -> float:
            cos, width = (torch.tensor(v, requires_grad=True) for v in (c, a))
            value = sum(brdf_torch.directional_albedo_terms(cos, width)) if ours else cos.sqrt() * (1 - width.sqrt())
            value.backward()
            grads = torch.stack([cos.grad, width.grad])
            return float((~torch.isfinite(grads)).sum())

        if cosine == 0.0:
            cases.append(
                Case(
                    "reflectance",
                    "hir_plugins.reflectance_renderers.brdf_torch.directional_albedo_terms",
                    f"gradient at n·o = {cosine:g}, α = {alpha:g} of a table even in √(n·o)",
                    "0 gradients that are not finite",
                    slope,
                    lambda s=slope: s(ours=False),
                    0.0,
                    formula="d√c/dc at c = 0",
                )
            )
    return cases


CASES = [*_narrow_lobes(), *_grazing(), *_frames(), *_albedo()]
