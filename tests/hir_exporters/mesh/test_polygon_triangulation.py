import numpy as np
import pytest
from hir_exporters.mesh.polygon_triangulation import MAX_CONCAVE_CORNERS, triangulate

ARROW = [(0, 0), (4, 0), (1, 1), (0, 4)]
L_SHAPE = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]
COMB = [(0, 0), (7, 0), (7, 3), (5, 3), (5, 1), (4, 1), (4, 3), (3, 3), (3, 1), (2, 1), (2, 3), (0, 3)]
WITH_CORNERS_ON_EDGES = [(0, 0), (1, 0), (2, 0), (2, 2), (1, 2), (1, 1), (0, 1)]


def _area(corners: np.ndarray) -> float:
    x, y = corners.T
    return float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) / 2)


@pytest.mark.parametrize("polygon", [ARROW, L_SHAPE, COMB, WITH_CORNERS_ON_EDGES])
@pytest.mark.parametrize("shift", range(4))
@pytest.mark.parametrize("reverse", [False, True])
def test_triangles_cover_a_concave_polygon_once(polygon: list[tuple[float, float]], shift: int, reverse: bool) -> None:
    flat = np.roll(np.asarray(polygon, float), shift, axis=0)[:: -1 if reverse else 1]
    frame = np.linalg.qr(np.array([[1.0, 2, 3], [0, 1, 4], [5, 6, 0]]))[0][:2]
    triangles, polygons, overlapping = triangulate(np.array([len(flat)]), flat @ frame + [7, 8, 9])
    areas = np.array([_area(flat[triangle]) for triangle in triangles]) * (-1 if reverse else 1)
    assert len(triangles) == len(flat) - 2 and (polygons == 0).all() and overlapping == 0
    assert areas.min() >= -1e-12 and areas.sum() == pytest.approx(abs(_area(flat)), rel=1e-12)


def test_polygons_keep_their_order_and_numbers() -> None:
    square, pentagon = [(0, 0), (1, 0), (1, 1), (0, 1)], [(0, 0), (2, 0), (3, 1), (1, 3), (0, 2)]
    shapes = [square, square[:3], pentagon, square[:2], square]
    corners = np.concatenate([np.pad(np.asarray(shape, float), ((0, 0), (0, 1))) for shape in shapes])
    triangles, polygons, overlapping = triangulate(np.array([len(shape) for shape in shapes]), corners)
    assert overlapping == 0
    assert polygons.tolist() == [0, 0, 1, 2, 2, 2, 4, 4]
    assert triangles[:3].tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]] and triangles[-1].tolist() == [14, 16, 17]


@pytest.mark.parametrize(
    "outline",
    [
        [(0, 0), (4, 0), (0, 4), (5, 4)],
        [(0, 0), (4, 0), (4, 4), (2, -2), (0, 4)],
        [(0, 0), (4, 0), (0, 4), (4, 4)],  # the signed areas of its halves cancel
        [(-2, -1), (2, 1), (3, 0), (2, -1), (-2, 1), (-3, 0)],  # so do these
    ],
)
def test_polygons_that_cross_themselves_are_a_fan_and_counted(outline: list[tuple[float, float]]) -> None:
    crossed = np.pad(np.array(outline, float), ((0, 0), (0, 1)))
    square = np.array([(0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)], float)
    count = len(crossed)
    triangles, polygons, overlapping = triangulate(np.array([count, 4]), np.concatenate([crossed, square]))
    assert overlapping == 1 and polygons.tolist() == [0] * (count - 2) + [1, 1]
    assert sorted(set(triangles.ravel().tolist())) == list(range(count + 4))


def test_a_polygon_without_an_area_does_not_cross_itself() -> None:
    line = np.array([(0, 0, 0), (1, 1, 0), (3, 3, 0), (2, 2, 0)], float)
    assert triangulate(np.array([4, 4]), np.concatenate([line, 0 * line]))[2] == 0


def test_a_concave_polygon_of_very_many_corners_is_a_fan_and_counted() -> None:
    turn = np.linspace(0, 2 * np.pi, MAX_CONCAVE_CORNERS + 2, endpoint=False)
    radius = np.where(np.arange(len(turn)) % 2, 1.0, 2.0)
    star = np.stack([radius * np.cos(turn), radius * np.sin(turn), 0 * turn], axis=1)
    triangles, _, overlapping = triangulate(np.array([len(star)]), star)
    assert overlapping == 1 and len(triangles) == len(star) - 2
