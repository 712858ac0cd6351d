"""The points of a pixel's samples, against Mitsuba's own functions, in the one variant for which they work."""

from __future__ import annotations

import numpy as np
import pytest

from hir_plugins.reflectance_renderers.mitsuba_variant import mitsuba_on

mi = mitsuba_on("cpu")

from hir_plugins.reflectance_renderers.mitsuba_ggx.sample_sequence import (  # noqa: E402 - needs a variant
    SampleSequence,
    _sobol,
    _van_der_corput,
    lanes,
)


@pytest.mark.parametrize("bits", [0, 1, 5, 16, 32])
def test_both_dimensions_are_those_of_mitsuba(bits: int) -> None:
    random = np.random.default_rng(bits)
    number = mi.UInt32(random.integers(2**bits, size=1000).astype(np.uint32))
    scramble = mi.UInt32(np.append(random.integers(2**32, size=998), (0, 2**32 - 1)).astype(np.uint32))
    assert np.array_equal(_van_der_corput(number, scramble), mi.radical_inverse_2(number, scramble))
    below_one = np.minimum(mi.sobol_2(number, scramble), np.float32(1 - 2.0**-24))  # Mitsuba's can be 1
    assert np.array_equal(_sobol(number, scramble, bits), below_one)


@pytest.mark.parametrize("samples", [1, 4, 64])
def test_each_strip_of_the_square_has_one_sample_of_a_pixel(samples: int) -> None:
    pixel, sample = lanes(20, samples)
    points = SampleSequence((pixel, pixel), sample, samples, mi.UInt32(3))
    for _ in range(3):
        drawn = points.next()
        for axis in (drawn.x, drawn.y):
            strip = np.floor(np.array(axis).reshape(20, samples) * samples)
            assert np.array_equal(np.sort(strip, axis=1), np.tile(np.arange(samples), (20, 1)))
