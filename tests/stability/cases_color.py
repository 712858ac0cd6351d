"""Colour curves, pictures of light, RGBE and 8-bit codes at the limits of their range."""

from __future__ import annotations

import math

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.textures.image_files import quantize
from hir_exporters.textures.rgbe import decode_rgbe, encode_rgbe
from hir_exporters.textures.texture_maps import normal_to_unorm8, srgb8, unorm8

from hir_core.capture import Pixels
from hir_core.metrics import psnr, unassociate
from hir_core.report.rendered_pictures import light_picture
from hir_core.scene import srgb
from tests.stability.case import Case

_WHERE = "np.where(x <= .0031308, 12.92 x, 1.055 x**(1/2.4) − .055), differentiated on both sides"


def _curves() -> list[Case]:
    cases = []
    for x in (-0.06, -0.5, -1.0, -100.0):
        cases.append(
            Case(
                "export",
                "hir_exporters.conventions.srgb_to_linear",
                f"{x:g}, an overshoot of a resampling filter",
                "the toe goes on below zero",
                lambda x=x: srgb_to_linear(np.float32(x)),
                "((x + 0.055) / 1.055)**2.4",
                "x / 12.92",
                {"x": x},
            )
        )
    for x in (-1e-6, -0.02, -1.0, -1e4):
        cases.append(
            Case(
                "export",
                "hir_exporters.conventions.linear_to_srgb",
                f"{x:g}",
                "the toe goes on below zero",
                lambda x=x: linear_to_srgb(np.float32(x)),
                "1.055 * x**(1/2.4) - 0.055",
                "x * 12.92",
                {"x": x},
            )
        )
    for x in (0.0, -0.5, -1e-12):
        cases.append(
            Case(
                "reflectance",
                "hir_core.scene.srgb.linear_to_srgb",
                f"gradient at {x:g}",
                "12.92 at black, 0 below",
                lambda x=x: _slope(srgb.linear_to_srgb, x),
                lambda x=x: _slope(_curve, x),
                12.92 if x >= 0 else 0.0,
                formula=_WHERE,
            )
        )
        cases.append(
            Case(
                "reflectance",
                "hir_core.scene.srgb.srgb_slope",
                f"slope at {x:g}",
                "12.92",
                lambda x=x: srgb.srgb_slope(torch.tensor(x)),
                "1.055 / 2.4 * x**(1/2.4 - 1)",
                12.92,
                {"x": x},
            )
        )
    return cases


def _slope(curve, x: float) -> float:  # type: ignore[no-untyped-def]
    value = torch.tensor(x, requires_grad=True)
    curve(value).backward()
    return float(value.grad)


def _curve(x: torch.Tensor) -> torch.Tensor:
    return torch.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)


def _codes() -> list[Case]:
    cases = []
    for x in (1.004, 1.5, -0.01, -1.0):
        cases.append(
            Case(
                "export",
                "hir_exporters.textures.image_files.quantize",
                f"8 bits of {x:g}",
                "clipped, not wrapped",
                lambda x=x: quantize(np.float32([x])),
                lambda x=x: np.int64([x * 255 + 0.5]).astype(np.uint8),
                lambda x=x: [255.0 if x > 0 else 0.0],
                formula="uint8(x·255 + 0.5)",
            )
        )
    cases.append(
        Case(
            "export",
            "hir_exporters.textures.texture_maps.srgb8",
            "sRGB code of linear 1.5",
            "clipped, not wrapped",
            lambda: srgb8(np.full((1, 1, 3), 1.5, np.float32)).ravel(),
            lambda: np.int64((1.055 * np.float32([1.5] * 3) ** np.float32(1 / 2.4) - 0.055) * 255 + 0.5).astype(
                np.uint8
            ),
            lambda: [255.0] * 3,
            formula="uint8((1.055 x**(1/2.4) − .055)·255 + 0.5)",
        )
    )
    cases.append(
        Case(
            "export",
            "hir_exporters.textures.texture_maps.unorm8",
            "a roughness of 1.0000001",
            "255",
            lambda: unorm8(
                np.full((1, 1), np.nextafter(np.float32(1), np.float32(2)) * np.float32(1.002), np.float32)
            ).ravel(),
            lambda: np.int64([np.float32(1.002) * 255 + 0.5]).astype(np.uint8),
            lambda: [255.0],
            formula="uint8(x·255 + 0.5)",
        )
    )
    normal = np.array([[[0.0, 0.0, 1.0000001]]], np.float32)
    cases.append(
        Case(
            "export",
            "hir_exporters.textures.texture_maps.normal_to_unorm8",
            "(0, 0, 1.01): longer than 1 by rounding",
            "blue 255",
            lambda: float(normal_to_unorm8(normal * np.float32(1.01))[0, 0, 2]),
            lambda: float(np.int64((np.float32(1.01) * 0.5 + 0.5) * 255 + 0.5).astype(np.uint8)),
            255.0,
            formula="uint8((n/2 + 1/2)·255 + 0.5)",
        )
    )
    return cases


def _rgbe() -> list[Case]:
    cases = []
    for x in (0.9999, 1.9999, 4095.99, 2.0**-60 * 1.9999):
        cases.append(
            Case(
                "export",
                "hir_exporters.textures.rgbe.encode_rgbe",
                f"{x:.6g}: the mantissa rounds up to 256",
                "the next exponent",
                lambda x=x: _round_trip(x),
                lambda x=x: _naive_rgbe(x),
                lambda x=x: np.full(3, float(np.float32(x))),
                tolerance=1 / 256,
                formula="e = ⌈log₂ x⌉; uint8(round(x·2^(8−e)))",
            )
        )
    for x, true, note in (
        (0.0, 0.0, "black has no logarithm"),
        (-1.0, 0.0, "negative light is none"),
        (1e-39, 0.0, "below the smallest exponent"),
        (3e38, 255 * 2.0**119, "above the largest"),
    ):
        cases.append(
            Case(
                "export",
                "hir_exporters.textures.rgbe.encode_rgbe",
                f"{x:g}: {note}",
                f"{true:g}",
                lambda x=x: _round_trip(x),
                lambda x=x: _naive_rgbe(x),
                lambda t=true: np.full(3, t),
                tolerance=1e-6,
                formula="e = ⌈log₂ x⌉; uint8(round(x·2^(8−e)))",
            )
        )
    return cases


def _round_trip(x: float) -> np.ndarray:
    return decode_rgbe(encode_rgbe(np.full((1, 1, 3), x, np.float32)))[0, 0]


def _naive_rgbe(x: float) -> np.ndarray:
    exponent = math.ceil(math.log2(x))
    mantissa = np.uint8(round(x * 2.0 ** (8 - exponent)) % 256)
    code = np.int64(exponent + 128).astype(np.uint8)
    return np.full(3, float(mantissa) * 2.0 ** (int(code) - 136))


def _pictures() -> list[Case]:
    black = np.zeros((4, 8, 3), np.float32)
    clear = np.zeros((1, 1, 4), np.float32)
    color, mask = np.full((2, 2, 3), 0.25, np.float32), np.zeros((2, 2), np.float32)
    same = np.full((4, 4, 3), 0.5, np.float32)
    return [
        Case(
            "reflectance",
            "hir_core.report.rendered_pictures.light_picture",
            "a black light",
            "black",
            lambda: light_picture(black).max(),
            lambda: (black / np.quantile(black, 0.95)).max(),
            0.0,
            formula="light · 0.8 / quantile",
        ),
        Case(
            "reflectance",
            "hir_core.metrics.unassociate",
            "a pixel that nothing covers",
            "black, not 0/0",
            lambda: unassociate(clear)[0].ravel(),
            lambda: (clear[..., :3] / clear[..., 3:]).ravel(),
            lambda: np.zeros(3),
            formula="rgb / alpha",
        ),
        Case(
            "initialization",
            "hir_core.capture.Pixels.downsampled",
            "a block without any of the object",
            "the block's plain mean",
            lambda: Pixels(color, mask, mask > 0).downsampled(2).color_linear.ravel(),
            lambda: ((color * mask[..., None]).mean((0, 1)) / mask.mean()).ravel(),
            lambda: np.full(3, 0.25),
            formula="mean(mask·color) / mean(mask)",
        ),
        Case(
            "reflectance",
            "hir_core.metrics.psnr",
            "equal pictures",
            "100 dB, so that a mean over views stays one",
            lambda: psnr(same, same),
            lambda: -10 * np.log10(((same - same) ** 2).mean()),
            100.0,
            formula="−10 log₁₀ mean (a − b)²",
        ),
    ]


CASES = [*_curves(), *_codes(), *_rgbe(), *_pictures()]
