"""Textures: charts without area, uncovered and unobserved texels, seams, materials at the limits of their range."""

from __future__ import annotations

import numpy as np
import torch
from hir_exporters.asset import AssetMaterial
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.textures.uv_rasterization import rasterize_triangles

from hir_core.mesh.texel_rasterization import dilate
from hir_core.scene.asset_conversion import _unit
from hir_core.scene.bilinear import texture_texels
from hir_plugins.initializers.surface.vertex_colors import _fill_unseen, _weighted_median
from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on
from hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations import (
    TexelEquations,
    solve_texels,
)
from tests.stability.case import Case


def _charts() -> list[Case]:
    cases = []
    square = np.array([[[0.0, 0], [8, 0], [0, 8]], [[8, 8], [0, 8], [8, 0]]])
    shapes = {
        "without area, across the others": np.array([[0.0, 4], [8, 4], [4, 4]]),
        "all vertices at one point": np.full((3, 2), 3.5),
    }
    for name, extra in shapes.items():
        corners = np.concatenate([square, extra[None]])
        cases.append(
            Case(
                "export",
                "hir_exporters.textures.uv_rasterization.rasterize_triangles",
                f"a chart {name}",
                "all 64 texels keep an owner and weights of sum 1",
                lambda c=corners: float(
                    (rasterize_triangles(c, 8, 8)[0] >= 0).sum()
                    + np.abs(rasterize_triangles(c, 8, 8)[1].sum(-1) - 1).max().round(6)
                ),
                lambda c=extra: _plain_barycentrics(c),
                64.0,
                formula="w = cross / area",
            )
        )
    texture = torch.zeros(4, 4, 1)
    cases.append(
        Case(
            "export",
            "hir_core.mesh.texel_rasterization.dilate",
            "a texture of which nothing is covered",
            "as it was, not 0/0",
            lambda: dilate(texture, torch.zeros(4, 4, dtype=torch.bool), 3).abs().max(),
            lambda: np.float32(0) / np.float32(0),
            0.0,
            formula="Σ neighbours / count",
        )
    )
    for u in (1.0, 0.0, -1e-9):
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.drjit_bilinear.repeated",
                f"u = {u:g} of a light of eight columns",
                "texels of the row, weights of sum 1",
                lambda u=u: _in_range(*_periodic(u), 8),
                lambda u=u: float(
                    np.floor(np.float32(u) * 8 - 0.5) >= 0 and np.floor(np.float32(u) * 8 - 0.5) + 1 <= 7
                ),
                1.0,
                formula="⌊8u − ½⌋ and the next",
            )
        )
    for u in (0.0, 1.0):
        cases.append(
            Case(
                "reflectance",
                "hir_core.scene.bilinear.texture_texels",
                f"u = {u:g} of an 8×8 texture",
                "texels inside, weights of sum 1",
                lambda u=u: _in_range(*texture_texels(torch.tensor([[u, 0.5]]), 8, 8), 64),
                lambda u=u: float(np.floor(u * 8 - 0.5) >= 0 and np.floor(u * 8 - 0.5) + 1 <= 7),
                1.0,
                formula="⌊8u − ½⌋ and the next",
            )
        )
    return cases


def _plain_barycentrics(c: np.ndarray) -> float:
    a, ab, ac = c[0], c[1] - c[0], c[2] - c[0]
    weight = (np.array([4.5, 4.5]) - a) @ np.array([ac[1], -ac[0]]) / (ab[0] * ac[1] - ab[1] * ac[0])
    return 64.0 if abs(weight) < 1e6 else float(weight)


def _periodic(u: float) -> tuple[torch.Tensor, torch.Tensor]:
    """Both texels of a row of eight, and their weights."""
    mi = mitsuba_on("cpu")
    from hir_plugins.reflectance_renderers.drjit_bilinear import repeated

    found = repeated(mi.Float(u) * 8 - 0.5, 8)
    low, high, fraction = (torch.from_numpy(np.array(v)) for v in (found.low, found.high, found.fraction))
    return torch.cat([low, high]), torch.cat([1 - fraction, fraction])


def _in_range(index: torch.Tensor, weight: torch.Tensor, count: int) -> float:
    return float(
        ((index >= 0) & (index < count)).all() and abs(float(weight.sum()) - 1) < 1e-6 and float(weight.min()) >= -1e-6
    )


def _solves() -> list[Case]:
    cases = []
    start = torch.full((2, 2, 3), 0.4)
    index, weight = torch.tensor([[0, 1, 2, 3]]), torch.tensor([[1.0, 0, 0, 0]])
    for name, gain in (("photographed in the dark", 0.0), ("under a light of 1e-20", 1e-20)):
        rows = TexelEquations(
            index,
            weight,
            torch.full((1, 3), gain),
            torch.zeros(1, 3),
            torch.zeros(1, 3),
            torch.ones(1, 3),
            torch.zeros(1, 3, dtype=torch.bool),
            torch.zeros(1, 3, dtype=torch.long),
        )
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.transport_ggx.textures.texel_equations.solve_texels",
                f"a texel {name}",
                "keeps the albedo it started from",
                lambda r=rows: solve_texels([r], start, 0.1, 0.01)[0][0, 0],
                lambda g=gain: np.full(3, np.float32(0) * np.float32(g) / (np.float32(g) * np.float32(g))),
                lambda: np.full(3, 0.4),
                formula="Σ gain·target / Σ gain²",
            )
        )
    nobody = np.zeros((2, 3), np.float32)
    cases += [
        Case(
            "initialization",
            "hir_plugins.initializers.surface.vertex_colors._weighted_median",
            "a vertex that no view sees",
            "0 and unknown",
            lambda: _weighted_median(np.ones((2, 3, 3), np.float32), nobody)[0].max(),
            lambda: (nobody * 1.0).sum() / nobody.sum(),
            0.0,
            formula="Σ w c / Σ w",
        ),
        Case(
            "initialization",
            "hir_plugins.initializers.surface.vertex_colors._fill_unseen",
            "a mesh that no view sees",
            "grey",
            lambda: _fill_unseen(np.zeros((3, 3), np.float32), np.zeros(3, bool), np.array([[0, 1, 2]]))[0],
            lambda: np.zeros((0, 3)).mean(axis=0),
            lambda: np.full(3, 0.5),
            formula="mean of the known colours",
        ),
        Case(
            "export",
            "hir_core.scene.asset_conversion._unit",
            "a vertex normal of length 0",
            "+Y",
            lambda: _unit(np.zeros((1, 3)))[0],
            lambda: np.zeros(3) / np.linalg.norm(np.zeros(3)),
            lambda: [0.0, 1, 0],
            formula="n / |n|",
        ),
        Case(
            "export",
            "hir_core.scene.asset_conversion._unit",
            "a texel of a normal map blurred to nothing",
            "+Z",
            lambda: _unit(np.zeros((1, 1, 3)))[0, 0],
            lambda: np.zeros(3) / np.linalg.norm(np.zeros(3)),
            lambda: [0.0, 0, 1],
            formula="n / |n|",
        ),
    ]
    return cases


def _material(model: str, diffuse: float, specular: tuple[float, float, float]) -> AssetMaterial:
    return AssetMaterial(
        model, np.full(3, diffuse, np.float32), np.array(specular, np.float32), np.float32(0.2).reshape(())
    )  # type: ignore[arg-type]


def _materials() -> list[Case]:
    cases = []
    for name, specular, formula, naive in (
        (
            "a paper surface with ρs = 1",
            (1.0, 1.0, 1.0),
            "ρd / (1 − ρs)",
            lambda: np.float32(0.5) / (1 - np.float32(1)),
        ),
        ("a paper surface with ρs = 0", (0.0, 0.0, 0.0), "ρs / max ρs", lambda: np.float32(0) / np.float32(0)),
        (
            "a paper surface of red reflections",
            (1.0, 0.0, 0.0),
            "ρd / (1 − max ρs)",
            lambda: np.float32(0.5) / (1 - np.float32(1)),
        ),
    ):
        for profile in ("khr", "blender", "metalrough"):
            cases.append(
                Case(
                    "export",
                    "hir_exporters.materials.material_conversion.to_gltf",
                    f"{name}, profile {profile}",
                    "0 values that are not finite or negative",
                    lambda s=specular, p=profile: _bad_values(to_gltf(_material("paper", 0.5, s), p)),  # type: ignore[arg-type]
                    lambda n=naive: float((~np.isfinite(n())).sum()),
                    0.0,
                    formula=formula,
                )
            )
    for profile in ("khr", "metalrough", "unity-legacy"):
        cases.append(
            Case(
                "export",
                "hir_exporters.materials.material_conversion.to_gltf",
                f"a black dielectric without reflection, profile {profile}",
                "0 values that are not finite or negative",
                lambda p=profile: _bad_values(to_gltf(_material("dielectric", 0.0, (0.0, 0.0, 0.0)), p)),  # type: ignore[arg-type]
                lambda: float((~np.isfinite(np.zeros(3) / np.zeros(3))).sum()),
                0.0,
                formula="ρs / max ρs",
            )
        )
    return cases


def _bad_values(surface: object) -> float:
    arrays = [np.asarray(v, np.float64) for v in vars(surface).values() if not isinstance(v, tuple)]
    return float(sum(((~np.isfinite(a)) | (a < 0)).sum() for a in arrays))


CASES = [*_charts(), *_solves(), *_materials()]
