"""The cache of decoded photographs: what it holds, how exact that is, and how much memory it takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import srgb_to_linear

from hir_core.capture import Capture, Pixels, View
from hir_core.capture.pixel_cache import PixelCache

HEIGHT, WIDTH = 5, 4
STORED_BYTES = HEIGHT * WIDTH * (3 * 2 + 2) + 3
"""Of one photograph of these tests: colours and mask of 16 bits, and twenty bits in three bytes."""


def photograph(color: np.ndarray, mask: np.ndarray | None = None) -> Capture:
    """One photograph in memory."""
    pixels = Pixels(color.astype(np.float32), mask, color.max(axis=2) >= 1)
    return Capture(Path("in-memory"), (View("a", None, lambda: pixels),))


def cached(capture: Capture, max_bytes: int = 1 << 20) -> Pixels:
    """The photograph as a run sees it."""
    wrapped = PixelCache(max_bytes).wrap(capture)
    first, second = wrapped.views[0].pixels(), wrapped.views[0].pixels()
    np.testing.assert_array_equal(first.color_linear, second.color_linear)
    return second


@pytest.mark.parametrize("max_bytes", [0, 1 << 20])
def test_steps_of_eight_bits_stay_distinct_whether_a_photograph_is_cached_or_not(max_bytes: int) -> None:
    steps = np.repeat(srgb_to_linear(np.arange(256) / 255)[:, None], 3, axis=1).reshape(16, 16, 3)
    mask = np.arange(256, dtype=np.float32).reshape(16, 16) / 255
    found = cached(photograph(steps, mask), max_bytes)
    step = np.diff(steps[..., 0].reshape(-1)).min()
    np.testing.assert_allclose(found.color_linear, steps, rtol=2**-11, atol=step / 1000)
    assert (np.diff(found.color_linear.reshape(-1, 3), axis=0) > 0).all()
    assert found.mask is not None and found.mask.dtype == np.float32
    np.testing.assert_allclose(found.mask, mask, atol=2**-12)
    assert found.mask[0, 0] == 0 and found.mask[-1, -1] == 1
    np.testing.assert_array_equal(found.saturated, steps.max(axis=2) >= 1)


@pytest.mark.parametrize("largest", [1e-6, 3e5])
def test_colours_beyond_the_range_of_16_bits_stay_as_they_are(largest: float) -> None:
    color = np.linspace(0, largest, HEIGHT * WIDTH * 3).reshape(HEIGHT, WIDTH, 3)
    np.testing.assert_array_equal(cached(photograph(color)).color_linear, color.astype(np.float32))


def test_pixels_without_a_colour_keep_none() -> None:
    color = np.full((HEIGHT, WIDTH, 3), 0.5)
    color[1, 2] = np.nan
    found = cached(photograph(color)).color_linear
    np.testing.assert_array_equal(np.isnan(found), np.isnan(color))
    np.testing.assert_array_equal(
        cached(photograph(np.full((2, 2, 3), np.nan))).color_linear, np.full((2, 2, 3), np.nan)
    )


def test_pixels_are_decoded_once_within_the_bound() -> None:
    read: list[str] = []

    def view(name: str) -> View:
        def decode() -> Pixels:
            read.append(name)
            return Pixels(
                np.full((HEIGHT, WIDTH, 3), 0.5, np.float32),
                np.ones((HEIGHT, WIDTH), np.float32),
                np.zeros((HEIGHT, WIDTH), bool),
            )

        return View(name, None, decode)

    cache = PixelCache(max_bytes=2 * STORED_BYTES)
    capture = cache.wrap(Capture(Path("in-memory"), tuple(view(name) for name in "abc")))
    for _ in range(3):
        for each in capture.views:
            each.pixels()
    assert sorted(read) == ["a", "b", "c", "c", "c"], "two fit, the third is decoded again"
    assert cache.bytes == 2 * STORED_BYTES


def test_a_mask_of_16_bits_is_read_as_one_of_32() -> None:
    capture = photograph(np.full((HEIGHT, WIDTH, 3), 0.5))
    view = replace(capture.views[0], mask=np.full((HEIGHT, WIDTH), 0.25, np.float16))
    mask = view.pixels().mask
    assert mask is not None and mask.dtype == np.float32 and (mask == 0.25).all()
