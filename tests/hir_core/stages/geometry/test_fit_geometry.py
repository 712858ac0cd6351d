"""The geometry stage on analytic captures: it finds shapes at any scale and tolerates wrong masks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.ndimage import distance_transform_edt, gaussian_filter

from hir_core.capture import Capture
from hir_core.config import GeometrySettings
from hir_core.errors import CaptureError, StageError
from hir_core.mesh.mesh_validity import inspect_mesh
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_core.stages.geometry.geometry_report import GeometryReport
from hir_core.stages.geometry.silhouettes.outline_refinement import OutlinesReport, OutlinesSkipped
from hir_core.stages.geometry.silhouettes.robust_view_weights import RobustViewWeights
from hir_plugins.geometry_renderers import plugin as renderers
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from hir_plugins.regularizers import plugin as regularizers
from tests.fixtures.meshes import around, capture_of, icosphere, mesh_of, torus

pytest.importorskip("open3d")
pytest.importorskip("cholespy")

PEANUT = icosphere(4)[0] * (1 + 0.35 * icosphere(4)[0][:, :1] ** 2) * [0.9, 0.55, 0.6], icosphere(4)[1]
SETTINGS = GeometrySettings(
    renderer="contour",
    photo_consistency="off",
    iterations=100,
    triangles=2000,
    regularizers={"laplacian": {"weight": 1e-5, "cotangent": True, "scale_free": True}},
)


@pytest.fixture(scope="module")
def capture() -> Capture:
    return capture_of(*PEANUT, around(24, 96))


def _context(tmp_path: Path, warnings: list[str] | None = None, seed: int = 0) -> StageContext:
    manager = PluginManager()
    manager.register(renderers, "hir", "0")
    manager.register(regularizers, "hir", "0")
    return StageContext(manager, tmp_path, seed=seed, warn=(warnings if warnings is not None else []).append)


def _ball(radius: float = 0.7) -> Scene:
    positions, faces = icosphere(3)
    return Scene(mesh_of(positions * radius, faces))


def _fit(
    scene: Scene,
    capture: Capture,
    settings: GeometrySettings,
    tmp_path: Path,
    warnings: list[str] | None = None,
    seed: int = 0,
) -> tuple[Mesh, GeometryReport]:
    fitted, report = fit_geometry(scene, capture, settings, _context(tmp_path, warnings, seed))
    return fitted.scene.mesh, report


def _unseen_offset(mesh: Mesh, shape: tuple[np.ndarray, np.ndarray]) -> tuple[float, float]:
    """Mean IoU of thresholded coverage and mean signed offset of the outline in pixels, in views that no fit saw."""
    renderer = Contour(ContourOptions(render_lines=8))
    ious, offsets = [], []
    for camera in around(7, 128, radius=3.5):
        found = renderer.render(mesh.with_positions(mesh.positions.detach()), [camera])[0]
        true = renderer.render(mesh_of(*shape), [camera])[0]
        ious.append(float(((found > 0.5) & (true > 0.5)).sum() / ((found > 0.5) | (true > 0.5)).sum()))
        gradient = torch.hypot(*torch.gradient(true))
        offsets.append(float((found - true).sum() / gradient.sum()))
    return float(np.mean(ious)), float(np.mean(offsets))


def test_a_ball_becomes_the_shape_in_the_masks(capture: Capture, tmp_path: Path) -> None:
    warnings: list[str] = []
    mesh, report = _fit(_ball(), capture, SETTINGS, tmp_path, warnings)
    iou, offset = _unseen_offset(mesh, PEANUT)
    assert iou > 0.985
    # a tenth of a pixel of a 96-pixel mask: the masks' antialiasing is made use of
    assert abs(offset) < 0.1
    state = inspect_mesh(mesh.positions.double().numpy(), mesh.faces.numpy())
    assert state.watertight and state.components == 1 and state.self_intersecting == state.folded == 0
    assert not warnings and not report.views.down_weighted
    before, after = report.iou_held_out.before, report.iou_held_out.after
    assert before is not None and after is not None and after > before
    assert len(report.views.held_out) == 2


@pytest.mark.slow
def test_outlines_are_fitted_without_the_regularizers_that_moved_them(capture: Capture, tmp_path: Path) -> None:
    stiff = replace(SETTINGS, regularizers={"laplacian": {"weight": 3e-3, "cotangent": True, "scale_free": True}})
    without, report = _fit(_ball(), capture, replace(stiff, outline_iterations=0), tmp_path / "without")
    assert [type(each) for each in report.outlines] == [OutlinesSkipped]
    fitted, report = _fit(_ball(), capture, stiff, tmp_path / "fitted")
    (outlines,) = report.outlines  # photographs moved nothing: fitted once
    assert isinstance(outlines, OutlinesReport) and outlines.movement.share > 0.9 and len(outlines.judging_views) == 6
    assert outlines.judging_iou.after > outlines.judging_iou.before
    assert fitted.topology.faces.equal(without.topology.faces)
    # views that took no part: the term rounds the ends of the peanut
    (iou_without, offset_without), (iou, offset) = (_unseen_offset(mesh, PEANUT) for mesh in (without, fitted))
    assert 1 - iou < 0.5 * (1 - iou_without)
    assert abs(offset) < 0.1 < abs(offset_without)


@pytest.mark.slow
def test_outlines_do_not_follow_the_noise_of_masks(capture: Capture, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    views = []
    for view in capture.views:
        mask = view.pixels().mask
        assert mask is not None
        inside = mask > 0.5
        distance = distance_transform_edt(inside) - distance_transform_edt(~inside)
        noise = gaussian_filter(rng.normal(size=mask.shape), 3)
        # two pixels, as of masks by a program that finds the object
        wrong = np.clip(distance + 2 * noise / noise.std() + 0.5, 0, 1).astype(np.float32)
        views.append(replace(view, mask=wrong))
    noisy = replace(capture, views=tuple(views))
    _, report = _fit(_ball(), noisy, SETTINGS, tmp_path)
    (outlines,) = report.outlines
    assert isinstance(outlines, OutlinesReport) and outlines.movement.share < 0.2
    assert outlines.judging_iou.after >= outlines.judging_iou.before


SHORT = replace(SETTINGS, iterations=25, outline_iterations=25)


@pytest.fixture(scope="module")
def plain(capture: Capture, tmp_path_factory: pytest.TempPathFactory) -> Mesh:
    """The fit in a world of radius 1 about its origin."""
    return _fit(_ball(), capture, SHORT, tmp_path_factory.mktemp("plain"))[0]


@pytest.mark.parametrize(
    ("scale", "shift"), [*(pytest.param(scale, 0.0, marks=pytest.mark.slow) for scale in (1e-3, 1e4)), (1.0, 1e4)]
)
def test_scale_and_position_of_the_world_do_not_matter(
    capture: Capture, plain: Mesh, tmp_path: Path, scale: float, shift: float
) -> None:
    move = np.diag([scale, scale, scale, 1.0])
    move[:3, 3] = shift * np.array([1.0, -2.0, 0.5])
    start = _ball()
    there = Scene(mesh_of(start.mesh.positions.double().numpy() * scale + move[:3, 3], start.mesh.faces.numpy()))
    moved, report = _fit(there, capture.transformed(move), SHORT, tmp_path)
    back = (moved.positions.double().numpy() - move[:3, 3]) / scale
    # float32 positions ten thousand radii away are known to a thousandth; remeshing may then choose other triangles
    before, after = report.iou_held_out.before, report.iou_held_out.after
    assert before is not None and after is not None and after > before
    iou, _ = _unseen_offset(mesh_of(back, moved.faces.numpy()), (plain.positions.double().numpy(), plain.faces.numpy()))
    assert iou > 0.98


WRONG = {3: "empty", 9: "shifted", 16: "half"}


@pytest.fixture(scope="module")
def partly_wrong(capture: Capture) -> Capture:
    """The capture with three wrong masks."""
    views = list(capture.views)
    for i, fault in WRONG.items():
        mask = views[i].pixels().mask.copy()
        if fault == "empty":
            mask[:] = 0
        elif fault == "shifted":
            mask = np.roll(mask, 25, axis=1)
        else:
            mask[:, :48] = 0
        views[i] = replace(views[i], mask=mask)
    return replace(capture, views=tuple(views))


def assert_wrong_masks_are_named(report: GeometryReport, capture: Capture, warnings: list[str]) -> None:
    names = [capture.views[i].name for i in WRONG]
    assert set(report.views.down_weighted) == set(names)
    assert all(any(name in sentence for sentence in warnings) for name in names)


@pytest.mark.slow
def test_wrong_masks_are_named(partly_wrong: Capture, tmp_path: Path) -> None:
    warnings: list[str] = []
    _, report = _fit(_ball(), partly_wrong, replace(SETTINGS, iterations=50), tmp_path, warnings)
    assert_wrong_masks_are_named(report, partly_wrong, warnings)


@pytest.mark.slow
def test_wrong_masks_do_not_change_the_mesh(partly_wrong: Capture, tmp_path: Path) -> None:
    warnings: list[str] = []
    mesh, report = _fit(_ball(), partly_wrong, SETTINGS, tmp_path / "robust", warnings)
    assert_wrong_masks_are_named(report, partly_wrong, warnings)
    uniform, _ = _fit(_ball(), partly_wrong, replace(SETTINGS, robust=False), tmp_path / "uniform")
    (iou, offset), (uniform_iou, _) = _unseen_offset(mesh, PEANUT), _unseen_offset(uniform, PEANUT)
    assert iou > 0.98 and abs(offset) < 0.15
    assert iou > uniform_iou


@pytest.mark.slow
def test_a_handle_stays_a_handle(tmp_path: Path) -> None:
    ring = torus(64, 32, 0.3)
    start = torus(32, 16, 0.42)
    mesh, _ = _fit(
        Scene(mesh_of(*start)),
        capture_of(*ring, around(20, 96, radius=4.0)),
        replace(SETTINGS, iterations=60),
        tmp_path,
    )
    assert inspect_mesh(mesh.positions.double().numpy(), mesh.faces.numpy()).genus == 1
    assert _unseen_offset(mesh, ring)[0] > 0.97


@pytest.mark.slow
def test_lost_thin_parts_cause_a_warning(tmp_path: Path) -> None:
    body, faces = icosphere(3)
    rod = body * [0.012, 0.5, 0.012] + [0.0, 0.9, 0.0]
    both = np.concatenate([body * 0.6, rod]), np.concatenate([faces, faces + len(body)])
    warnings: list[str] = []
    _, report = _fit(
        Scene(mesh_of(body * 0.6, faces)),
        capture_of(*both, around(16, 128)),
        replace(SETTINGS, iterations=10, triangles=800),
        tmp_path,
        warnings,
    )
    assert report.silhouette_residual.missing > 0.001
    assert any("thin parts" in sentence for sentence in warnings)


@pytest.mark.slow
def test_a_mesh_too_coarse_for_its_silhouettes_causes_a_warning(tmp_path: Path) -> None:
    body, faces = icosphere(4)
    spiky = body * (0.5 + 0.5 * np.abs(np.sin(7 * body[:, :1])) ** 8)
    warnings: list[str] = []
    _, report = _fit(
        Scene(mesh_of(spiky, faces)),
        capture_of(spiky, faces, around(16, 128)),
        replace(SETTINGS, iterations=5, triangles=500, photo_consistency="off"),
        tmp_path,
        warnings,
    )
    before, after = report.iou_held_out.before, report.iou_held_out.after
    assert before is not None and after is not None and before - after > 0.005
    assert any("held-out views fit worse" in sentence for sentence in warnings)


@pytest.mark.slow
def test_floating_components_that_no_mask_needs_are_removed(tmp_path: Path) -> None:
    body, faces = icosphere(3)
    inner, needed = body * 0.2 + [0.1, 0.0, 0.0], body * 0.15 + [0.0, 0.95, 0.0]
    count = len(body)
    shape = np.concatenate([body * 0.7, needed]), np.concatenate([faces, faces + count])
    start = np.concatenate([body * 0.7, needed, inner]), np.concatenate([faces, faces + count, faces + 2 * count])
    mesh, report = _fit(
        Scene(mesh_of(*start)), capture_of(*shape, around(12, 96)), replace(SETTINGS, iterations=5), tmp_path
    )
    assert report.floating_components_removed == 1
    assert inspect_mesh(mesh.positions.double().numpy(), mesh.faces.numpy()).components == 2


def test_the_paper_path_moves_vertices_at_radius_a_tenth(capture: Capture, tmp_path: Path) -> None:
    few = replace(capture, views=capture.views[:3])
    settings = GeometrySettings(
        renderer="soft_silhouette",
        parameterization="vertices",
        remesh=False,
        views_per_step=1,
        iterations_per_view=4,
        outline_iterations=0,
        learning_rate=0.01,
        learning_rate_end=1.0,
        start_radius=0.1,
        held_out=0.0,
        robust=False,
        prune=False,
        regularizers={
            "laplacian": {"weight": 1.0},
            "normal_consistency": {"weight": 0.01},
            "edge_length": {"weight": 1.0},
        },
    )
    start = _ball()
    mesh, report = _fit(start, few, settings, tmp_path)
    assert mesh.topology.faces.equal(start.mesh.faces)
    assert report.levels[0].steps == 12
    # Adam's step of 0.001 in a world of radius 0.1, twelve times
    moved = float((mesh.positions - start.mesh.positions).abs().max()) / 0.7
    assert 0.05 < moved <= 0.12 * 1.01


def test_same_seed_same_mesh_and_views_not_in_train_are_never_read(capture: Capture, tmp_path: Path) -> None:
    settings = replace(SETTINGS, iterations=10, outline_iterations=10)
    runs = [_fit(_ball(), capture, settings, tmp_path / str(i), seed=s)[0].positions for i, s in enumerate((1, 1, 2))]
    assert torch.equal(runs[0], runs[1])
    assert runs[2].shape != runs[0].shape or not torch.equal(runs[0], runs[2])


def test_it_asks_for_what_it_needs(capture: Capture, tmp_path: Path) -> None:
    blind = replace(capture, views=(replace(capture.views[0], camera=None), *capture.views[1:]))
    maskless = replace(capture.views[0], read=lambda: replace(capture.views[0].read(), mask=None))
    with pytest.raises(CaptureError, match="camera"):
        capture_error = replace(blind, views=blind.views[:1])
        _fit(_ball(), capture_error, SETTINGS, tmp_path)
    with pytest.raises(CaptureError, match="has no mask"):
        _fit(_ball(), replace(capture, views=(maskless,)), SETTINGS, tmp_path)
    with pytest.raises(StageError, match="no views"):
        _fit(_ball(), replace(capture, views=()), SETTINGS, tmp_path)
    with pytest.raises(StageError, match="empty"):
        _fit(Scene(mesh_of(np.zeros((0, 3)), np.zeros((0, 3), int))), capture, SETTINGS, tmp_path)


def test_one_view_and_empty_masks_end_finite(capture: Capture, tmp_path: Path) -> None:
    one = replace(capture, views=capture.views[:1])
    mesh, report = _fit(_ball(), one, replace(SETTINGS, iterations=15), tmp_path / "one")
    assert bool(torch.isfinite(mesh.positions).all()) and report.iou_held_out.after is None
    empty = replace(capture, views=tuple(replace(v, mask=np.zeros((96, 96), np.float32)) for v in capture.views[:3]))
    mesh, _ = _fit(_ball(), empty, replace(SETTINGS, iterations=15), tmp_path / "empty")
    assert bool(torch.isfinite(mesh.positions).all())


def test_down_weighting_needs_five_views_and_a_clear_outlier() -> None:
    view_weights = RobustViewWeights(6)
    errors = np.array([0.01, 0.012, 0.011, 0.013, 0.2, 0.02])
    assert view_weights.update(list(range(6)), errors, active=False).tolist() == [1.0] * 6
    weights = view_weights.update(list(range(6)), errors, active=True)
    assert weights[4] < 0.05 and (np.delete(weights, 4) == 1).all()
    assert set(view_weights.down_weighted()) == {4}
    pair = RobustViewWeights(2)
    assert pair.update([0, 1], np.array([0.01, 0.9]), active=True).tolist() == [1.0, 1.0]
