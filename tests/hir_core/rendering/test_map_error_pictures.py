"""Errors of maps on the object: each block has its colour where the camera sees it."""

from __future__ import annotations

import numpy as np

from hir_core.rendering.map_error_pictures import BRIGHTEST_ERROR, COLORS, RAMP, map_error_pictures
from hir_core.scene.map_errors import OBSERVED, OUTSIDE, UNDER_OBSERVED, MapErrors
from tests.fixtures.scenes import looking_at, square

SIDE = 48


def test_blocks_are_shown_where_the_camera_sees_them() -> None:
    """A square whose left and right halves differ, beside blocks without surface in the middle."""
    condition = np.full((8, 8), OBSERVED, np.uint8)
    condition[:, 4:] = UNDER_OBSERVED
    error = np.where(condition == OBSERVED, 0.0, BRIGHTEST_ERROR).astype(np.float32)
    condition[3] = OUTSIDE
    error[3] = np.nan
    errors = MapErrors(error[..., None].repeat(3, 2), {"roughness": error}, {}, condition)
    cameras = [looking_at((0.0, height, 0.01), SIDE, SIDE) for height in (3.5, 5.0)]
    pictures = map_error_pictures(errors, square(), cameras)
    assert set(pictures) == {"error_base_color", "error_roughness", "map_condition"}
    for name, colors in (
        ("map_condition", (COLORS[OBSERVED], COLORS[UNDER_OBSERVED])),
        ("error_roughness", (RAMP[0], RAMP[-1])),
    ):
        picture = pictures[name]
        assert picture.shape == (SIDE, 2 * SIDE, 3) and np.isfinite(picture).all()
        for view in (picture[:, :SIDE], picture[:, SIDE:]):
            inner = view[SIDE // 2 - 6 : SIDE // 2 + 6]
            ends = inner[:, SIDE // 2 - 6], inner[:, SIDE // 2 + 5]
            found = sorted((end.mean(axis=0) for end in ends), key=lambda each: float(each[0]))
            expected = sorted(map(np.asarray, colors), key=lambda each: float(each[0]))
            np.testing.assert_allclose(found, expected, atol=0.02)
            assert (view[0, 0] == 0).all()
