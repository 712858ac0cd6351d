"""Figures of a fit: comparisons with one view, schedules without steps, images without contrast, scales of black."""

from __future__ import annotations

import numpy as np
import torch
from hir_exporters.materials.brdf_slice import brdf_slice, relative_error

from hir_core.capture import Camera, Pixels, View
from hir_core.mesh.large_steps import UniformAdam
from hir_core.metrics import ChannelScale
from hir_core.optimization.schedules import Schedule
from hir_core.plugins.progress import Progress
from hir_core.scene import Mesh, Topology
from hir_core.scene.frames import unit_similarity
from hir_core.stages.geometry.confirmed_movement import confirmed_share
from hir_core.stages.geometry.photo_consistency.detail_images import detail_image
from hir_core.stages.reflectance.selection.held_out_comparison import decibels, paired_gain
from hir_plugins.regularizers.total_variation import environment_variation
from tests.stability.case import Case


def _share(before: np.ndarray, after: np.ndarray) -> list[float]:
    found = confirmed_share([0, 1], np.stack([before, after]), 0.005)
    return [found.gain, found.noise]


def _comparisons() -> list[Case]:
    one, zero = np.array([0.01]), np.zeros(3)
    return [
        Case(
            "reflectance",
            "hir_core.stages.reflectance.selection.held_out_comparison.decibels",
            "an error of 0",
            "120 dB",
            lambda: decibels(zero),
            lambda: -10 * np.log10(zero),
            lambda: np.full(3, 120.0),
            formula="−10 log₁₀ e",
        ),
        Case(
            "reflectance",
            "hir_core.stages.reflectance.selection.held_out_comparison.paired_gain",
            "one held-out view",
            "a gain, and no NaN for its noise",
            lambda: float(np.isnan(paired_gain(one, one / 2)[1])),
            lambda: float(np.isnan(np.std(one, ddof=1))),
            0.0,
            formula="std(gains, ddof=1) / √n",
        ),
        Case(
            "geometry",
            "hir_core.stages.geometry.confirmed_movement.confirmed_share",
            "views that could compare nothing",
            "no gain, no noise",
            lambda: _share(np.array([np.nan, 0.2]), np.array([0.1, np.nan])),
            lambda: [np.mean([np.nan, 1 - np.nan]), np.nan],
            lambda: [0.0, 0.0],
            formula="mean(1 − after/before)",
        ),
        Case(
            "geometry",
            "hir_core.stages.geometry.confirmed_movement.confirmed_share",
            "views without any error before",
            "no gain, no noise",
            lambda: _share(np.zeros(3), np.zeros(3)),
            lambda: [np.mean(1 - zero / zero), np.std(1 - zero / zero)],
            lambda: [0.0, 0.0],
            formula="mean(1 − after/before)",
        ),
        Case(
            "geometry",
            "hir_core.optimization.optimization_loop.Schedule",
            "a schedule that is all warm-up",
            "its last rate",
            lambda: Schedule(5, warmup=5, end=0.1)(5),
            lambda: 0.5 * (1 + np.cos(np.pi * (np.float64(5 - 5) / (5 - 5)))),
            1.0,
            formula="(step − warmup) / (steps − warmup)",
        ),
        Case(
            "geometry",
            "hir_core.plugins.progress.Progress.seconds_left",
            "before the first step",
            "0",
            lambda: Progress("x", 0, 10, 1.0).seconds_left,
            lambda: 1.0 / 0 * 10,
            0.0,
            formula="seconds / step · left",
        ),
    ]


def _pictures() -> list[Case]:
    flat = View(
        "flat",
        Camera(np.eye(3), np.eye(4), 24, 24),
        lambda: Pixels(np.full((24, 24, 3), 0.5, np.float32), np.ones((24, 24), np.float32), np.zeros((24, 24), bool)),
    )
    nothing = View(
        "nothing",
        flat.camera,
        lambda: Pixels(np.full((24, 24, 3), 0.5, np.float32), np.zeros((24, 24), np.float32), np.zeros((24, 24), bool)),
    )
    broken = View(
        "broken",
        flat.camera,
        lambda: Pixels(
            np.full((24, 24, 3), np.nan, np.float32), np.ones((24, 24), np.float32), np.zeros((24, 24), bool)
        ),
    )
    cases = [
        Case(
            "geometry",
            "hir_core.stages.geometry.photo_consistency.detail_images.detail_image",
            f"a photograph {name}",
            "0 values that are not finite",
            lambda v=view: float((~torch.isfinite(detail_image(v, 1)[0])).sum()),
            lambda v=view: float((~np.isfinite(_plain_contrast(v))).sum()),
            0.0,
            formula="(c − mean) / std",
        )
        for name, view in (("of one colour", flat), ("of which the mask leaves nothing", nothing), ("of NaN", broken))
    ]
    scale = ChannelScale()
    scale.add(np.zeros((4, 3), np.float32), np.ones((4, 3), np.float32))
    slices = brdf_slice(np.array([0.2]))
    black = np.zeros((1, 7, 68, 3))
    shape = brdf_black_shape(slices)
    cases += [
        Case(
            "reflectance",
            "hir_core.metrics.ChannelScale",
            "a black fit",
            "a finite scale",
            lambda: float((~np.isfinite(np.asarray(_scale_value(scale)))).sum()),
            lambda: float((~np.isfinite(np.ones(3) * 0 / np.zeros(3))).sum()),
            0.0,
            formula="(Σ (fit·truth)^(1/2.4) / Σ fit^(2/2.4))^2.4",
        ),
        Case(
            "export",
            "hir_exporters.materials.brdf_slice.relative_error",
            "a black surface written as black",
            "0",
            lambda: relative_error(slices, np.zeros(shape), np.zeros(shape)),
            lambda: np.sqrt(black.sum() / black.sum()),
            0.0,
            formula="√(Σ (a−b)² / Σ b²)",
        ),
        Case(
            "reflectance",
            "hir_plugins.regularizers.total_variation.environment_variation",
            "the gradient under an even light",
            "0 values that are not finite",
            _flat_light_gradient,
            lambda: float((~torch.isfinite(_root_gradient())).sum() > 0),
            0.0,
            formula="√(Δx² + Δy²), differentiated",
        ),
    ]
    for offset in (1e5, 1e7):
        positions = torch.tensor(np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]]) * 8 + offset, dtype=torch.float32)
        mesh = Mesh(positions, Topology(torch.tensor([[0, 1, 2]])))
        used = positions.double().numpy()
        moved = unit_similarity(mesh)
        cases.append(
            Case(
                "initialization",
                "hir_core.scene.frames.unit_similarity",
                f"a mesh of size 16 at {offset:g}",
                "radius 1 about the origin",
                lambda u=used, m=moved: np.linalg.norm(u @ m[:3, :3].T + m[:3, 3], axis=1).max(),
                lambda u=used: _plain_radius(u.astype(np.float32)),
                1.0,
                tolerance=1e-7,
                formula="x/r − c/r in float32",
            )
        )
    return cases


def brdf_black_shape(slices: object) -> tuple[int, ...]:
    """The shape of BRDF values on a slice."""
    return (*slices.lobe.shape, 3)  # type: ignore[attr-defined]


def _scale_value(scale: ChannelScale) -> np.ndarray:
    names = [n for n in dir(scale) if not n.startswith("_") and n != "add"]
    value = getattr(scale, names[0])
    return np.asarray(value() if callable(value) else value)


def _plain_contrast(view: View) -> np.ndarray:
    pixels = view.pixels(1)
    inside = pixels.color_linear[pixels.mask > 0.5]
    return np.asarray((pixels.color_linear - inside.mean(0)) / inside.std(0))


def _flat_light_gradient() -> float:
    light = torch.ones(4, 8, 3, requires_grad=True)
    environment_variation(light).backward()
    return float((~torch.isfinite(light.grad)).sum())


def _root_gradient() -> torch.Tensor:
    light = torch.ones(4, 8, 3, requires_grad=True)
    across, down = light - light.roll(1, 1), light - light.roll(1, 0)
    (across.square() + down.square()).sqrt().sum().backward()
    return light.grad


def _plain_radius(p: np.ndarray) -> np.float32:
    center = (p.min(0) + p.max(0)) / np.float32(2)
    radius = np.linalg.norm(p - center, axis=1).max()
    return np.linalg.norm(p / radius - center / radius, axis=1).max()


def _steps() -> list[Case]:
    return [
        Case(
            "geometry",
            "hir_core.mesh.large_steps.UniformAdam.step",
            "a first gradient of 0",
            "no step",
            lambda: _adam_step(0.0),
            "0 - 0.5 * g / sqrt(g * g)",
            0.0,
            {"g": 0.0},
        )
    ]


def _adam_step(size: float) -> torch.Tensor:
    x = torch.zeros(1, requires_grad=True)
    x.grad = torch.full((1,), size)
    UniformAdam([x], 0.5).step()
    return x.detach()[0]


CASES = [*_comparisons(), *_pictures(), *_steps()]
