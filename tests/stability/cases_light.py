"""Directions near the poles of a lat-long image, suns that a resampling could miss, lights of one pixel."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import torch
from hir_exporters.conventions import direction_to_latlong_uv, latlong_solid_angles
from hir_exporters.light.environment_map import mean_radiance, resample_latlong, rotate_latlong
from hir_exporters.light.prefilter import filament_roughness, linear_roughness

from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import MAX_RADIANCE, Parameters, logit_of_alpha
from hir_plugins.reflectance_renderers.transport_ggx.operator import light_pyramid
from tests.stability.case import Case

_V = "acos(y) / pi"


def _poles() -> list[Case]:
    cases = []
    for angle, pole in ((1e-6, 1), (1e-5, 1), (1e-4, 1), (3e-4, 1), (1e-3, 1), (1e-4, -1), (1e-3, -1)):
        d = np.array([math.sin(angle), pole * math.cos(angle), 0.0], np.float32)
        exact = {"y": mpmath.cos(mpmath.mpf(angle)) * pole, "t": mpmath.mpf(angle)}
        truth = "t / pi" if pole > 0 else "1 - t / pi"
        where = f"{angle:g} rad from the {'upper' if pole > 0 else 'lower'} pole"
        tolerance = 1e-6 if pole > 0 else 1e-7
        if not (pole < 0 and angle < 1e-3):
            cases.append(
                Case(
                    "export",
                    "hir_exporters.conventions.direction_to_latlong_uv",
                    where,
                    "v to 6 digits",
                    lambda d=d: direction_to_latlong_uv(d)[1],
                    _V,
                    truth,
                    {"y": float(d[1])},
                    exact,
                    tolerance,
                )
            )
    for length in (2.0, 1.0000001, 1e-20, 1e19):
        d = (np.array([0.6, 0.8, 0.0]) * length).astype(np.float32)
        if length == 1.0000001:
            d = np.array([0.0, np.nextafter(np.float32(1), np.float32(2)), 0.0], np.float32)
        cases.append(
            Case(
                "export",
                "hir_exporters.conventions.direction_to_latlong_uv",
                f"a direction of length {length:.8g}",
                "v of the direction, whatever its length",
                lambda d=d: direction_to_latlong_uv(d)[1],
                _V,
                "atan2(sqrt(x*x), y) / pi",
                {"x": float(d[0]), "y": float(d[1])},
                tolerance=1e-6,
            )
        )
    for x in (-1e-20, -1e-9):
        d = np.array([x, 0.0, -1.0], np.float32)
        cases.append(
            Case(
                "export",
                "hir_exporters.conventions.direction_to_latlong_uv",
                f"straight back, x = {x:g}",
                "u = 0 on the seam, a column of the image",
                lambda d=d: direction_to_latlong_uv(d)[0],
                "0.5 - atan2(x, z) / (2 * pi)",
                0.0,
                {"x": x, "z": -1.0},
                tolerance=1e-6,
            )
        )
    return cases


def _suns() -> list[Case]:
    cases = []
    for row, name in ((0, "at the pole"), (3, "near the pole")):
        sun = np.zeros((32, 64, 3), np.float32)
        sun[row, 5] = 1e4
        before = mean_radiance(sun)
        cases.append(
            Case(
                "export",
                "hir_exporters.light.environment_map.resample_latlong",
                f"a sun of one pixel {name}, halved",
                "the light's energy",
                lambda s=sun: mean_radiance(resample_latlong(s, 16, 32)),
                lambda s=sun: mean_radiance(s.reshape(16, 2, 32, 2, 3).mean((1, 3))),
                lambda b=before: b,
                tolerance=1e-9,
                formula="mean of four pixels",
            )
        )
        cases.append(
            Case(
                "reflectance",
                "hir_plugins.reflectance_renderers.transport_ggx.operator.light_pyramid.Pyramid.flatten",
                f"a sun of one pixel {name}",
                "the light's energy at every level",
                lambda s=sun: _levels(light_pyramid.Pyramid(32, 64).flatten(torch.from_numpy(s).double()).numpy()),
                lambda s=sun: _levels(_plain_pyramid(s)),
                lambda b=before: np.full(5, b[0]),
                tolerance=1e-9,
                formula="mean of four texels",
            )
        )
    sun = np.zeros((32, 64, 3), np.float32)
    sun[9, 20] = 1e5
    for degrees in (23.0, 37.0):
        angle = math.radians(degrees)
        turn = np.array([[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]])
        cases.append(
            Case(
                "export",
                "hir_exporters.light.environment_map.rotate_latlong",
                f"a sun of one pixel turned by {degrees:g}°",
                "the light's energy",
                lambda t=turn: mean_radiance(rotate_latlong(sun, t)),
                lambda t=turn: mean_radiance(_nearest(sun, t)),
                lambda: mean_radiance(sun),
                tolerance=1e-9,
                formula="the pixel that the turned-back direction falls into",
            )
        )
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    red = np.zeros((8, 16, 3))
    red[..., 0] = 1.0
    cases.append(
        Case(
            "export",
            "hir_exporters.light.environment_map.rotate_latlong",
            "a light without green and blue",
            "0, not 0/0",
            lambda: mean_radiance(rotate_latlong(red, turn)),
            lambda: mean_radiance(red) * (mean_radiance(red) / mean_radiance(red)),
            lambda: np.array([1.0, 0, 0]),
            formula="turned · before / after",
            tolerance=1e-9,
        )
    )
    cases += [
        Case(
            "export",
            "hir_exporters.conventions.latlong_solid_angles",
            f"an image of {rows} rows",
            "4π in all",
            lambda r=rows: latlong_solid_angles(r, 2 * r).sum() * 2 * r,
            lambda r=rows: (np.sin((np.arange(r) + 0.5) * np.pi / r) * (np.pi / r) ** 2).sum() * 2 * r,
            4 * math.pi,
            tolerance=1e-12,
            formula="sin θ · dθ · dφ",
        )
        for rows in (2, 16, 512)
    ]
    return cases


def _levels(flat: np.ndarray) -> np.ndarray:
    means, start = [], 0
    for height, width in light_pyramid.Pyramid(32, 64).shapes:
        means.append(mean_radiance(flat[start : start + height * width].reshape(height, width, 3))[0])
        start += height * width
    return np.array(means)


def _plain_pyramid(image: np.ndarray) -> np.ndarray:
    levels = [image]
    while levels[-1].shape[0] > 2:
        h, w = levels[-1].shape[:2]
        levels.append(levels[-1].reshape(h // 2, 2, w // 2, 2, 3).mean((1, 3)))
    return np.concatenate([level.reshape(-1, 3) for level in levels])


def _nearest(image: np.ndarray, turn: np.ndarray) -> np.ndarray:
    from hir_exporters.conventions import latlong_directions

    height, width = image.shape[:2]
    uv = direction_to_latlong_uv(latlong_directions(height, width) @ turn)
    return image[(uv[..., 1] * height).astype(int).clip(0, height - 1), (uv[..., 0] * width).astype(int) % width]


def _limits() -> list[Case]:
    def parameters(light: float) -> Parameters:
        return Parameters(torch.full((1, 2, 3), light), torch.zeros(1, 3), None, None)

    cases = [
        Case(
            "reflectance",
            "hir_plugins.reflectance_renderers.transport_ggx.fit.parameters.Parameters.radiance",
            f"a logarithm of {x:g}",
            "held at 1e5",
            lambda x=x: parameters(x).radiance.max(),
            "exp(x)",
            MAX_RADIANCE,
            {"x": x},
            tolerance=1e-5,
        )
        for x in (50.0, 89.0, 1e4)
    ]
    cases += [
        Case(
            "reflectance",
            "hir_plugins.reflectance_renderers.transport_ggx.fit.parameters.logit_of_alpha",
            f"a width α of {a:g}",
            "a slope is left: within ±6.91",
            lambda a=a: logit_of_alpha(torch.tensor(a)),
            "log((a - 0.01) / (1 - a))",
            math.log(999.0) * (1 if a > 0.5 else -1),
            {"a": a},
            tolerance=1e-4,
        )
        for a in (1.0, 0.01, 0.0)
    ]
    cases += [
        Case(
            "export",
            f"hir_exporters.light.prefilter.{f.__name__}",
            "one level",
            "roughness 0",
            lambda f=f: f(0, 1),
            lambda: 0 / (1 - 1),
            0.0,
            formula="level / (levels − 1)",
        )
        for f in (linear_roughness, filament_roughness)
    ]
    return cases


CASES = [*_poles(), *_suns(), *_limits()]
