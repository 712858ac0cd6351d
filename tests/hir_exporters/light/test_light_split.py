"""Lights and residual have the irradiance of the light that was divided; extremes; what is refused."""

import numpy as np
import pytest
from hir_exporters.conventions import latlong_directions, latlong_solid_angles
from hir_exporters.errors import InputError
from hir_exporters.light.light_split import LightSplit, rotation_to, split_light
from scipy.spatial.transform import Rotation

HEIGHT = 64


def sphere_directions(count: int = 200) -> np.ndarray:
    number = np.arange(count) + 0.5
    y, azimuth = 1 - 2 * number / count, number * np.pi * (3 - np.sqrt(5))
    ring = np.sqrt(1 - y * y)
    return np.stack([ring * np.sin(azimuth), y, ring * np.cos(azimuth)], -1)


def irradiance(radiance: np.ndarray, normals: np.ndarray) -> np.ndarray:
    height, width = radiance.shape[:2]
    cosine = np.maximum(normals @ latlong_directions(height, width).reshape(-1, 3).T, 0)
    energy = (radiance * latlong_solid_angles(height, width)[..., None]).reshape(-1, 3)
    return cosine @ energy.astype(np.float64)


def irradiance_of(split: LightSplit, normals: np.ndarray) -> np.ndarray:
    return irradiance(split.residual, normals) + np.maximum(normals @ split.directions.T, 0) @ split.irradiance


def lamps() -> np.ndarray:
    """A grey sky with a warm lamp of 12 degrees, a blue one of 25 and a sun of one texel."""
    directions = latlong_directions(HEIGHT, 2 * HEIGHT)
    sky = 0.2 + 0.1 * directions[..., 1:2] * np.ones(3)
    for toward, degrees, color in (((1, 1, 0.5), 6, (40, 25, 10)), ((-1, 0.2, 1), 12.5, (4, 6, 9))):
        toward = np.asarray(toward) / np.linalg.norm(toward)
        sky[directions @ toward > np.cos(np.radians(degrees))] += color
    sky[10, 100] += 900
    return sky


@pytest.mark.parametrize("threshold", [1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize(("lights", "tolerance"), [(4, 0.03), (8, 0.01), (32, 0.005)])
def test_irradiance_is_conserved(threshold: float, lights: int, tolerance: float) -> None:
    """Relative to the largest irradiance; only surfaces from which a cluster sets differ, by the cluster's size."""
    radiance, normals = lamps(), sphere_directions()
    split = split_light(radiance, lights, threshold)
    assert 3 <= len(split.directions) <= lights
    before, after = irradiance(radiance, normals), irradiance_of(split, normals)
    assert np.abs(after - before).max() < tolerance * before.max()


def test_a_surface_that_faces_a_whole_lamp_has_the_same_irradiance() -> None:
    radiance = np.full((HEIGHT, 2 * HEIGHT, 3), 0.1)
    directions = latlong_directions(HEIGHT, 2 * HEIGHT)
    radiance[directions[..., 1] > np.cos(np.radians(15))] = (9.0, 6.0, 3.0)
    split = split_light(radiance, 1, 4.0)
    assert len(split.directions) == 1
    normals = sphere_directions()
    facing = normals[normals[:, 1] > np.sin(np.radians(16))]
    np.testing.assert_allclose(irradiance_of(split, facing), irradiance(radiance, facing), rtol=1e-6)


def test_a_constant_light_has_no_lights() -> None:
    radiance = np.full((HEIGHT, 2 * HEIGHT, 3), 0.7, np.float32)
    for threshold in (1.0, 4.0):
        split = split_light(radiance, 8, threshold)
        assert len(split.directions) == 0
        np.testing.assert_array_equal(split.residual, radiance)


def test_a_black_light_has_no_lights() -> None:
    split = split_light(np.zeros((HEIGHT, 2 * HEIGHT, 3)), 8, 1.0)
    assert len(split.directions) == 0 and split.share == 0


def test_a_sun_of_one_texel_is_one_light_in_its_direction() -> None:
    radiance = np.zeros((HEIGHT, 2 * HEIGHT, 3), np.float32)
    radiance[13, 77] = (1000, 800, 500)
    split = split_light(radiance, 8, 1.0)
    assert len(split.directions) == 1
    np.testing.assert_allclose(split.directions[0], latlong_directions(HEIGHT, 2 * HEIGHT)[13, 77], atol=1e-12)
    whole = radiance[13, 77] * latlong_solid_angles(HEIGHT, 2 * HEIGHT)[13]
    np.testing.assert_allclose(split.irradiance[0], whole, rtol=1e-3)
    assert split.residual.max() < 1 and split.share > 0.999


def test_opposite_suns_that_must_share_a_light_stay_in_the_residual() -> None:
    radiance = np.zeros((HEIGHT, 2 * HEIGHT, 3), np.float32)
    radiance[20, 10] = radiance[HEIGHT - 1 - 20, 10 + HEIGHT] = 500
    split = split_light(radiance, 1, 1.0)
    assert len(split.directions) == 0
    np.testing.assert_array_equal(split.residual, radiance)
    assert len(split_light(radiance, 2, 1.0).directions) == 2


def test_the_residual_is_not_brighter_than_the_threshold_and_never_negative() -> None:
    radiance = lamps()
    split = split_light(radiance, 32, 2.0)
    weight = latlong_solid_angles(HEIGHT, 2 * HEIGHT)[..., None]
    mean = float((radiance * weight).sum() / weight.sum() / 2 / HEIGHT / 3)
    dropped = split.residual.max(axis=-1) > 2.0 * mean * (1 + 1e-6)
    assert split.residual.min() >= 0
    # what stays above it is a cluster of less than a thousandth of the energy
    assert float((radiance * weight)[dropped].sum()) < 1e-3 * float((radiance * weight).sum())


def test_lights_turn_with_the_environment() -> None:
    radiance = lamps()
    a, b = split_light(radiance, 8, 2.0), split_light(np.roll(radiance, 32, axis=1), 8, 2.0)
    np.testing.assert_allclose(a.irradiance, b.irradiance, rtol=1e-9)
    quarter = Rotation.from_euler("y", -90, degrees=True).apply(a.directions)
    # halves of a lamp have equal energy: their order may differ
    distance = np.linalg.norm(quarter[:, None] - b.directions[None], axis=-1)
    assert distance.min(axis=1).max() < 1e-9 and distance.min(axis=0).max() < 1e-9


@pytest.mark.parametrize(
    ("value", "message"), [(np.nan, "NaN or infinite"), (np.inf, "NaN or infinite"), (-1, "negative")]
)
def test_invalid_radiance_is_refused(value: float, message: str) -> None:
    radiance = np.ones((8, 16, 3))
    radiance[3, 3, 1] = value
    with pytest.raises(InputError, match=message):
        split_light(radiance, 8, 2.0)


def test_another_shape_is_refused() -> None:
    with pytest.raises(InputError, match="must be"):
        split_light(np.ones((8, 8, 3)), 8, 2.0)


def test_the_rotation_takes_z_to_the_light() -> None:
    for toward in (*sphere_directions(40), np.array([0, 0, -1.0]), np.array([0, 0, 1.0])):
        np.testing.assert_allclose(Rotation.from_quat(rotation_to(toward)).apply([0, 0, 1]), toward, atol=1e-9)
