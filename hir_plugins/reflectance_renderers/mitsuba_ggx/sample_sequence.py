"""Random points in the unit square, well distributed among the samples of one pixel."""

from __future__ import annotations

from copy import copy

import drjit as dr
import mitsuba as mi

from hir_plugins.reflectance_renderers.drjit_types import DrJitArray


class SampleSequence:
    """2D points for each lane (a sample of a pixel).

    The samples of a pixel are a randomly scrambled (0, 2)-sequence (van der Corput, Sobol) in each pair of dimensions,
    in a random order: every single point is uniform, so estimates are unbiased.
    """

    def __init__(
        self, pixel: tuple[DrJitArray, DrJitArray], sample: DrJitArray, samples: int, seed: DrJitArray
    ) -> None:
        """`pixel`: two integers that identify the pixel, independent of its batch; `seed`: an opaque integer."""
        self._sample = sample
        self._mask = (1 << max(samples - 1, 0).bit_length()) - 1
        first, second = mi.sample_tea_32(pixel[0], pixel[1])
        self._key: tuple[DrJitArray, DrJitArray] = mi.sample_tea_32(first ^ seed, second)
        self._drawn = 0

    def gathered(self, lanes: DrJitArray) -> SampleSequence:
        """The sequence of some of the lanes, which goes on where this one is."""
        part = copy(self)
        part._sample = dr.gather(mi.UInt32, self._sample, lanes)
        part._key = (dr.gather(mi.UInt32, self._key[0], lanes), dr.gather(mi.UInt32, self._key[1], lanes))
        return part

    def next(self) -> DrJitArray:
        """The next Point2f of each lane."""
        self._drawn += 1
        number = mi.UInt32((self._drawn * 0x9E3779B9) & 0xFFFFFFFF)
        first, second = mi.sample_tea_32(self._key[0] ^ number, self._key[1])
        third, fourth = mi.sample_tea_32(first, second)
        # an odd factor and a shift permute the numbers below a power of two
        order = (self._sample * (third | 1) + fourth) & self._mask
        return mi.Point2f(_van_der_corput(order, first), _sobol(order, second, self._mask.bit_length()))


# `mi.radical_inverse_2` and `mi.sobol_2` stay those of the variant that a process asks for first (Mitsuba 3.9)
def _van_der_corput(number: DrJitArray, scramble: DrJitArray) -> DrJitArray:
    """The bits of an integer behind the point in reverse order, scrambled; float in [0, 1)."""
    bits = dr.brev(number) ^ scramble
    from_one_to_two: DrJitArray = dr.reinterpret_array(mi.Float, (bits >> 9) | 0x3F800000)
    return from_one_to_two - 1


def _sobol(number: DrJitArray, scramble: DrJitArray, bits: int) -> DrJitArray:
    """The second dimension of the (0, 2)-sequence, scrambled; float in [0, 1). `number` has at most `bits` bits."""
    direction = 1 << 31
    for bit in range(bits):
        scramble = scramble ^ dr.select(((number >> bit) & 1) == 1, mi.UInt32(direction), mi.UInt32(0))
        direction ^= direction >> 1
    return dr.minimum(mi.Float(scramble) * 2.0**-32, 1 - 2.0**-24)


def lanes(pixels: int, samples: int) -> tuple[DrJitArray, DrJitArray]:
    """Indices of the pixel and of the sample of each lane; samples of a pixel are adjacent."""
    lane = dr.arange(mi.UInt32, pixels * samples)
    pixel = lane // samples
    return pixel, lane - pixel * samples
