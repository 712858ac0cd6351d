"""The mean of the directions of a GGX lobe for each view angle and α, for one lookup in prefiltered light.

A lobe that is seen along the normal is symmetric about it. Seen at an angle it is neither centred on the mirrored
direction nor as wide: masking draws it towards the normal, Schlick's term away from it, and it is cut at the horizon.
Its first moment, the mean of its directions, has a direction and a length. The lookup uses the symmetric lobe with the
same mean: in the direction of the moment, and of the α whose symmetric lobe has a moment of the same length.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from hir_exporters.conventions import ALPHA_MIN
from hir_exporters.materials.brdf_numpy import Array

COSINES, WIDTHS = 32, 32
"""Rows and columns of `moment_table`."""
LENGTHS = 64
"""Of `width_table`."""
DIRECTIONS = 32
"""Rows and columns of the visible normals of each lobe."""
LEAST_COSINE = 1e-4
"""Of n·o: seen exactly along the surface, a lobe has no directions above it."""


@cache
def moment_table() -> Array:
    """The means (COSINES, WIDTHS, 4) of each lobe without Schlick's term and of that term alone; read-only.

    Each mean is x and z: in a frame of the normal n and the eye o it is x (n·o n − o) + z n. Rows are linear in √(n·o),
    columns in √α from `ALPHA_MIN` to 1.
    """
    cosine = np.maximum(np.linspace(0, 1, COSINES) ** 2, LEAST_COSINE)
    lowest = np.sqrt(ALPHA_MIN)
    alpha = (lowest + (1 - lowest) * np.linspace(0, 1, WIDTHS)) ** 2
    plain, schlick = lobe_means(cosine[:, None], alpha[None])
    table = np.concatenate([plain, schlick], axis=-1)
    table[..., ::2] /= np.maximum(np.sqrt(1 - cosine**2), 1e-6)[:, None, None]
    table[-1, :, ::2] = table[-2, :, ::2]  # seen along the normal, n·o n − o vanishes
    table.setflags(write=False)
    return table


@cache
def width_table() -> Array:
    """log α (LENGTHS,) of the symmetric lobe whose mean has a length, linear in √(1 − length) in 0…1; read-only."""
    widths = np.geomspace(ALPHA_MIN, 1, 256)
    lengths = np.linalg.norm(lobe_means(np.ones_like(widths), widths)[0], axis=-1)
    table = np.interp(np.linspace(0, 1, LENGTHS), np.sqrt(1 - lengths), np.log(widths))
    table.setflags(write=False)
    return table


def lobe_means(cosine: Array, alpha: Array) -> tuple[Array, Array]:
    """Mean directions (…, 2) in the plane of incidence: along the surface, away from the eye, and along the normal.

    Weighted by the lobe times 1 − s and times s, where s is Schlick's term. Their lengths are below 1. The directions
    are reflections at visible normals (Heitz 2018), weighted by G1.
    """
    cosine, alpha = (each[..., None] for each in np.broadcast_arrays(cosine, alpha))
    u = (np.arange(DIRECTIONS) + 0.5) / DIRECTIONS
    # more rows at the edge of the disc, whose normals are farthest from the eye: Schlick's term is largest there
    radius, turn = (each.reshape(-1) for each in np.meshgrid(np.sqrt(1 - u**2), 2 * np.pi * u, indexing="ij"))
    sine = np.sqrt(1 - cosine**2)
    length = np.hypot(alpha * sine, cosine)
    stretched, up = alpha * sine / length, cosine / length
    # the eye lies in the plane of the first and third axis; the disc of visible normals is squeezed along `in_plane`
    across, in_plane = radius * np.cos(turn), radius * np.sin(turn)
    half = (1 + up) / 2
    in_plane = (1 - half) * np.sqrt(1 - across**2) + half * in_plane
    toward = np.sqrt(np.maximum(1 - across**2 - in_plane**2, 0))
    normal = np.stack(
        [alpha * (toward * stretched - in_plane * up), alpha * across, toward * up + in_plane * stretched]
    )
    normal[2] = np.maximum(normal[2], 0)
    normal = normal / np.linalg.norm(normal, axis=0)
    along_eye = normal[0] * sine + normal[2] * cosine
    along, above = sine - 2 * along_eye * normal[0], 2 * along_eye * normal[2] - cosine
    squared = alpha**2
    shown = np.where(above > 0, 2 * above / np.maximum(above + np.sqrt(squared + (1 - squared) * above**2), 1e-12), 0)
    shown = shown * np.repeat(2 * u, DIRECTIONS)
    schlick = (1 - np.clip(along_eye, 0, 1)) ** 5
    directions = np.stack([along, above], axis=-1)

    def mean(weight: Array) -> Array:
        total = np.maximum(weight.sum(axis=-1), 1e-30)
        return np.asarray((directions * weight[..., None]).sum(axis=-2) / total[..., None])

    return mean(shown * (1 - schlick)), mean(shown * schlick)
