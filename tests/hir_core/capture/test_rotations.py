"""Rotations without scipy agree with scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hir_core.capture.rotations import quaternion_from_rotation, rotation_from_quaternion
from hir_plugins.readers.reality_capture import _rotation

ROTATIONS = [
    *Rotation.random(200, rng=np.random.default_rng(0)).as_matrix(),
    *(np.diag(np.array(signs, float)) for signs in ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))),
]


def test_quaternions_are_those_of_scipy_up_to_sign() -> None:
    for rotation in ROTATIONS:
        w, *xyz = quaternion_from_rotation(rotation)
        assert abs(np.dot([*xyz, w], Rotation.from_matrix(rotation).as_quat())) == pytest.approx(1, abs=1e-14)
        np.testing.assert_allclose(rotation_from_quaternion(np.array([w, *xyz]) * 3), rotation, atol=1e-14)


def test_angles_of_reality_capture_are_intrinsic_zxy() -> None:
    for heading, pitch, roll in np.random.default_rng(1).uniform(-180, 180, (50, 3)):
        expected = Rotation.from_euler("ZXY", [-heading, pitch, roll], degrees=True).as_matrix()
        np.testing.assert_allclose(_rotation(heading, pitch, roll), expected, atol=1e-14)
