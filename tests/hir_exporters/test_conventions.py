import numpy as np
import pytest
from hir_exporters import conventions as c
from hypothesis import given
from hypothesis import strategies as st


def test_srgb_curves_meet_at_the_published_points_and_undo_each_other() -> None:
    codes = np.arange(256) / 255
    linear = c.srgb_to_linear(codes)
    np.testing.assert_allclose(c.linear_to_srgb(linear), codes, atol=1e-15, rtol=1e-14)
    assert linear[0] == 0 and linear[255] == 1
    np.testing.assert_allclose(linear[10], 10 / 255 / 12.92, rtol=1e-15)
    np.testing.assert_allclose(linear[188], 0.502886, atol=1e-6)


@given(st.floats(-1e30, 1e30))
def test_color_curves_never_make_nan(value: float) -> None:
    assert not np.isnan(c.linear_to_srgb(value)) and not np.isnan(c.srgb_to_linear(np.clip(value, -1e10, 1e10)))


def test_float32_stays_float32() -> None:
    assert c.srgb_to_linear(np.float32([0.5])).dtype == np.float32
    assert c.linear_to_srgb([1]).dtype == np.float64


def test_single_precision_goes_through_every_conversion() -> None:
    one, two = np.float32([0.25, 0.5, 1.0]), np.float32([[0.25, 0.5], [0.5, 1.0]])
    for value in (
        c.linear_to_srgb(one),
        c.direction_to_latlong_uv(one),
        c.latlong_uv_to_direction(two, two),
        c.flip_v(two),
    ):
        assert value.dtype == np.float32
    assert c.latlong_uv_to_direction(one, one.astype(np.float64)).dtype == np.float32, "the first decides"
    for value in (c.direction_to_latlong_uv([1, 2, 3]), c.latlong_uv_to_direction(0, 1), c.srgb_to_linear(1)):
        assert value.dtype == np.float64
    assert c.srgb_to_linear(np.float16([0.5])).dtype == np.float64


def test_the_toe_holds_its_end() -> None:
    assert c.srgb_to_linear(0.04045) == 0.04045 / 12.92 and c.linear_to_srgb(0.0031308) == 0.0031308 * 12.92
    assert c.srgb_to_linear(-1.0) == -1 / 12.92 and c.linear_to_srgb(-1.0) == -12.92


def test_z_up_becomes_y_up_by_a_rotation() -> None:
    np.testing.assert_array_equal(c.Z_UP_TO_Y_UP @ [1, 2, 3], [1, 3, -2])
    assert np.linalg.det(c.Z_UP_TO_Y_UP) == 1


@pytest.mark.parametrize(
    ("direction", "uv"),
    [
        ([0, 0, 1], (0.5, 0.5)),
        ([1, 0, 0], (0.25, 0.5)),
        ([-1, 0, 0], (0.75, 0.5)),
        ([0, 0, -1], (0.0, 0.5)),
        ([0, 1, 0], (0.5, 0.0)),
        ([0, -1, 0], (0.5, 1.0)),
    ],
)
def test_lat_long_axes(direction: list[int], uv: tuple[float, float]) -> None:
    np.testing.assert_allclose(c.direction_to_latlong_uv(direction), uv, atol=1e-15)
    np.testing.assert_allclose(c.latlong_uv_to_direction(*uv), direction, atol=1e-15)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_both_sides_of_the_seam_stay_inside(kind: type[np.floating]) -> None:
    """(−0, 0, −1) lies at an angle of −π, where u would be 1."""
    tiny = np.array([0.0, 1e-30, 1e-12, 1e-8, 1e-6], kind)
    x = np.concatenate([tiny, -tiny])
    directions = np.stack([x, np.zeros_like(x), np.full_like(x, -1)], axis=1)
    uv = c.direction_to_latlong_uv(directions)
    assert uv.shape == (10, 2) and uv.min() >= 0 and uv[:, 0].max() < 1
    assert uv[5, 0] == 0
    np.testing.assert_allclose(np.minimum(uv[:, 0], 1 - uv[:, 0]), 0, atol=1e-6)
    np.testing.assert_allclose(uv[:, 1], 0.5, atol=1e-7)


@given(st.tuples(*[st.floats(-1e3, 1e3)] * 3).filter(lambda d: np.linalg.norm(d) > 1e-3))
def test_lat_long_round_trip(direction: tuple[float, float, float]) -> None:
    uv = c.direction_to_latlong_uv(direction)
    assert 0 <= uv[0] < 1 and 0 <= uv[1] <= 1
    np.testing.assert_allclose(
        c.latlong_uv_to_direction(uv[0], uv[1]), np.array(direction) / np.linalg.norm(direction), atol=1e-14
    )


def test_solid_angles_cover_the_sphere_and_weigh_the_cosine() -> None:
    weights = c.latlong_solid_angles(64, 128) * np.ones((1, 128))
    np.testing.assert_allclose(weights.sum(), 4 * np.pi, rtol=1e-14)
    cosine = np.maximum(c.latlong_directions(64, 128)[..., 1], 0)
    np.testing.assert_allclose((weights * cosine).sum(), np.pi, rtol=1e-3)


def test_flip_v_is_its_own_inverse_and_luminance_of_white_is_one() -> None:
    uvs = np.array([[0.25, 0.0], [0.5, 1.0]])
    np.testing.assert_array_equal(c.flip_v(uvs), [[0.25, 1.0], [0.5, 0.0]])
    np.testing.assert_array_equal(c.flip_v(c.flip_v(uvs)), uvs)
    np.testing.assert_allclose(c.luminance(np.ones((2, 3))), 1.0, rtol=1e-15)


def test_directions_go_through_pixel_centres() -> None:
    directions = c.latlong_directions(2, 4)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(directions[0, 0], [0.5, half, -0.5], atol=1e-12)
    np.testing.assert_allclose(directions[1, 2], [-0.5, -half, 0.5], atol=1e-12)
    assert directions.shape == (2, 4, 3) and directions.dtype == np.float64


def test_luminance_keeps_single_precision() -> None:
    grey = np.full((2, 3), 0.25, np.float32)
    assert c.luminance(grey).dtype == np.float32 and c.luminance(grey.astype(np.float64)).dtype == np.float64
    np.testing.assert_allclose(c.luminance(np.eye(3)), [0.2126, 0.7152, 0.0722])
