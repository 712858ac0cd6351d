"""Areas and overlaps of `contour` against exact polygons."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from tests.fixtures import exact_polygons as polygons
from tests.fixtures.meshes import bumpy_sphere, camera, facing, icosphere, mesh_of, targets_of, torus

SQUARE = np.array([[2, 3, 0], [12, 3, 0], [12, 9, 0], [2, 9, 0]], dtype=float)
TWO = np.array([[0, 1, 2], [0, 2, 3]])


@pytest.fixture
def contour() -> Contour:
    return Contour(ContourOptions())


def _area(contour: Contour, positions: np.ndarray, faces: np.ndarray, *cameras, **mesh) -> list[float]:
    return contour.overlap(mesh_of(positions, faces, **mesh), targets_of(list(cameras)))[0].tolist()


def _ramp(size: int) -> np.ndarray:
    return np.tile((np.arange(size) + 0.5) / size, (size, 1))


@pytest.mark.parametrize("faces", [TWO, TWO[:, ::-1], np.array([[0, 1, 2], [0, 3, 2]])], ids=["front", "back", "mixed"])
def test_an_axis_aligned_square_is_exact_whichever_way_its_triangles_run(contour: Contour, faces: np.ndarray) -> None:
    assert _area(contour, SQUARE, faces, facing(16)) == pytest.approx([60.0], abs=1e-9)


def test_overlap_with_a_linear_mask_is_exact(contour: Contour) -> None:
    # ∫ x/16 over [2, 12] × [3, 9]
    _, shared = contour.overlap(mesh_of(SQUARE, TWO), targets_of([facing(16)], [_ramp(16)]))
    assert shared.item() == pytest.approx(6 * (12**2 - 2**2) / 2 / 16, abs=1e-5)


def test_the_frame_cuts_the_silhouette(contour: Contour) -> None:
    assert _area(contour, SQUARE * [4, 1, 1], TWO, facing(16)) == pytest.approx([(16 - 8) * 6.0], abs=1e-9)
    assert _area(contour, (SQUARE - 7) * [100, 100, 0], TWO, facing(16)) == pytest.approx([256.0], abs=1e-9)


@pytest.mark.parametrize(
    "make", [lambda: bumpy_sphere(3), torus, lambda: icosphere(2)], ids=["bumpy", "torus", "sphere"]
)
def test_areas_agree_with_polygons(contour: Contour, make) -> None:
    positions, faces = make()
    for eye in ((3.0, 1.0, 0.5), (-1.0, 0.4, 3.2), (0.7, 3.0, 1.1)):
        view = camera(256, eye)
        mesh = mesh_of(positions, faces, torch.float64)
        found, shared = contour.overlap(mesh, targets_of([view], [_ramp(256)]))
        # lines one pixel apart: on average the outline is known to a hundredth of a pixel
        near = 0.01 * polygons.silhouette(positions, faces, view).length
        assert found.item() == pytest.approx(polygons.area(positions, faces, view), abs=near)
        assert shared.item() == pytest.approx(polygons.ramp_overlap(positions, faces, view), abs=near)


def test_a_hole_is_a_hole(contour: Contour) -> None:
    positions, faces = torus()
    view = camera(256, (0.0, 0.0, 4.0))
    outer = polygons.shapely.Polygon(polygons.silhouette(positions, faces, view).exterior)
    exact = polygons.area(positions, faces, view)
    assert outer.area - exact > 1000
    assert _area(contour, positions, faces, view) == pytest.approx([exact], abs=0.01 * outer.length)


def test_components_in_front_of_each_other_count_once(contour: Contour) -> None:
    positions, faces = icosphere(2)
    two_parts = np.concatenate([positions * 0.5, positions * 0.5 + [0.3, 0.2, -0.8]])
    both = np.concatenate([faces, faces + len(positions)])
    view = camera(256, (0.2, 0.3, 4.0))
    assert _area(contour, two_parts, both, view) == pytest.approx([polygons.area(two_parts, both, view)], rel=2e-4)


def test_open_and_non_manifold_meshes_need_no_special_care(contour: Contour) -> None:
    positions, faces = bumpy_sphere(3)
    half = faces[positions[faces].mean(axis=1)[:, 0] > 0]
    fin = np.concatenate(
        [half, [[half[0, 0], half[0, 1], len(positions)]], [[half[0, 0], half[0, 1], len(positions) + 1]]]
    )
    more = np.concatenate([positions, [[1.5, 1.0, 0.2], [0.2, 1.6, -1.0]]])
    for triangles in (half, fin):
        for eye in ((3.0, 1.0, 0.5), (-3.0, 0.7, 0.2)):
            view = camera(256, eye)
            expected = polygons.area(more, triangles, view)
            assert _area(contour, more, triangles, view, dtype=torch.float64) == pytest.approx([expected], rel=3e-4)


def test_cracks_between_duplicated_vertices_and_at_t_junctions_stay_shut(contour: Contour) -> None:
    view = camera(64, (0.3, 0.2, 3.0))
    whole = _area(contour, SQUARE / 12 - 0.5, TWO, view)[0]
    soup = (SQUARE / 12 - 0.5)[TWO].reshape(-1, 3)
    assert _area(contour, soup, np.arange(6).reshape(2, 3), view)[0] == pytest.approx(whole, rel=1e-9)
    # a vertex in the middle of the diagonal that only one of the two triangles knows of
    corners = SQUARE / 12 - 0.5
    junction = np.concatenate([corners, [corners[0] + (corners[2] - corners[0]) / 3]])
    faces = np.array([[0, 1, 2], [0, 4, 3], [4, 2, 3]])
    assert _area(contour, junction, faces, view)[0] == pytest.approx(whole, rel=1e-6)
    # and no gradient comes from the crack: moving the inner vertex along the diagonal changes nothing
    mesh = mesh_of(junction, faces, grad=True)
    contour.overlap(mesh, targets_of([view]))[0].sum().backward()
    assert float(mesh.positions.grad[4].abs().max()) == 0.0


def test_a_plane_through_the_camera_fills_the_half_below_its_horizon(contour: Contour) -> None:
    # a floor under the camera that runs behind it: everything below the horizon is covered
    floor = np.array([[-1e4, 1, -1e4], [1e4, 1, -1e4], [1e4, 1, 1e4], [-1e4, 1, 1e4]])
    view = camera(64, (0.0, 0.0, 5.0))
    floor = floor @ np.diag([1.0, -1.0, 1.0])
    assert _area(contour, floor, TWO, view, dtype=torch.float64) == pytest.approx([32 * 64], rel=2e-3)


def test_a_camera_inside_a_sphere_sees_it_everywhere(contour: Contour) -> None:
    positions, faces = icosphere(3)
    assert _area(contour, positions, faces, camera(32, (0.1, 0.2, 0.3))) == pytest.approx([32 * 32], abs=1e-9)


def test_what_is_behind_the_camera_is_not_seen(contour: Contour) -> None:
    positions, faces = icosphere(2)
    assert _area(contour, positions * 0.1 + [0, 0, 9.0], faces, camera(32, (0.0, 0.0, 3.0))) == [0.0]


def test_views_of_a_batch_do_not_mix_and_sizes_may_differ(contour: Contour) -> None:
    positions, faces = bumpy_sphere(3)
    views = [camera(128, (3.0, 1.0, 0.5)), camera(96, (-1.0, 0.4, 3.2), height=64), camera(200, (0.5, 3.0, 0.7))]
    together = _area(contour, positions, faces, *views)
    assert together == [_area(contour, positions, faces, view)[0] for view in views]


def test_render_is_the_coverage(contour: Contour) -> None:
    positions, faces = bumpy_sphere(3)
    view = camera(64, (3.0, 1.0, 0.5))
    image = contour.render(mesh_of(positions, faces), [view])[0].double().numpy()
    import shapely

    outline = polygons.silhouette(positions, faces, view)
    columns, rows = np.meshgrid(np.arange(64), np.arange(64))
    exact = shapely.area(shapely.intersection(shapely.box(columns, rows, columns + 1, rows + 1), outline))
    assert image.sum() == pytest.approx(exact.sum(), rel=2e-4)
    # four lines a pixel, midpoint rule: where the coverage of a line runs from 0 to 1 within the pixel, off by an
    # eighth
    assert np.abs(image - exact).max() < 1 / 8
    fine = Contour(ContourOptions(render_lines=16)).render(mesh_of(positions, faces), [view])[0].double().numpy()
    assert np.abs(fine - exact).max() < 1 / 32


def test_lens_distortion_bends_the_outline(contour: Contour) -> None:
    from dataclasses import replace

    cv2 = pytest.importorskip("cv2")
    positions, faces = icosphere(5)
    view = replace(camera(256, (0.0, 0.0, 3.0)), distortion=(-0.2, 0.05, 0.001, -0.002, 0.01))
    local = positions @ view.world_to_camera[:3, :3].T + view.world_to_camera[:3, 3]
    pixels = cv2.projectPoints(local, np.zeros(3), np.zeros(3), view.intrinsics, np.array(view.distortion))[0][:, 0]
    flat = np.concatenate([pixels, np.zeros((len(pixels), 1))], axis=1)
    plain = polygons.area(flat, faces, facing(256))
    assert _area(contour, positions, faces, view)[0] == pytest.approx(plain, rel=2e-4)
    assert abs(_area(contour, positions, faces, camera(256, (0.0, 0.0, 3.0)))[0] / plain - 1) > 0.01
