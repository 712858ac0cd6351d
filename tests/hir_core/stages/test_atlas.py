"""Texture coordinates, texels on the surface, dilation and fill."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters.textures.uv_rasterization import rasterize_triangles

from hir_core.capture import Capture, View
from hir_core.config import AtlasSettings
from hir_core.errors import StageError
from hir_core.mesh import texture_inpainting, uv_charts
from hir_core.mesh.texel_rasterization import dilate, texel_surface
from hir_core.mesh.texture_inpainting import fill_unobserved
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene, Topology
from hir_core.stages.atlas import texture_size, unwrap, unwrap_mesh
from tests.fixtures.scenes import bumpy_sphere, icosphere, looking_at, square


def uv_areas(mesh: Mesh) -> torch.Tensor:
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    a, b, c = mesh.uvs[mesh.topology.uv_faces].double().unbind(1)
    return 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])


def context(tmp_path: Path, warnings: list[str]) -> StageContext:
    return StageContext(plugins=None, workspace=tmp_path, warn=warnings.append)  # type: ignore[arg-type]


def capture_of(*cameras) -> Capture:  # type: ignore[no-untyped-def]
    return Capture(Path("none"), tuple(View(str(i), camera, read=lambda: None) for i, camera in enumerate(cameras)))  # type: ignore[arg-type,return-value]


@pytest.mark.parametrize("scale", [1.0, 1e-3, 1e4])
def test_unwrapped_faces_have_their_area_and_do_not_overlap(scale: float) -> None:
    mesh, _ = unwrap_mesh(bumpy_sphere().with_positions(bumpy_sphere().positions * scale + 7 * scale), 256)
    assert mesh.uvs is not None
    assert float(mesh.uvs.min()) >= 0
    assert float(mesh.uvs.max()) <= 1
    surface = texel_surface(mesh, 512)
    assert surface.overlaps == 0
    ratio = uv_areas(mesh).abs() / mesh.face_areas_normals.double().norm(dim=1)
    assert float(ratio.max() / ratio.median()) < 4
    assert float(ratio.min() / ratio.median()) > 0.25


def test_unwrapping_twice_gives_the_same_bits() -> None:
    first, _ = unwrap_mesh(bumpy_sphere(), 256)
    second, _ = unwrap_mesh(bumpy_sphere(), 256)
    assert first.uvs is not None and second.uvs is not None
    assert torch.equal(first.uvs, second.uvs)


@pytest.mark.parametrize("size", [128, 512])
def test_charts_keep_their_distance(size: int) -> None:
    """No two texels of different charts are closer than the padding."""
    from scipy.ndimage import label

    mesh, _ = unwrap_mesh(bumpy_sphere(), size, padding=4)
    covered = texel_surface(mesh, size).covered.numpy()
    charts, count = label(covered, structure=np.ones((3, 3)))
    assert count > 1
    grown = dilate(torch.from_numpy(charts).float()[..., None], torch.from_numpy(covered), 1)
    reach, number = label(grown[..., 0].numpy() > 0, structure=np.ones((3, 3)))
    assert number == count, "one ring more and two charts touch"
    assert reach.max() == count


def test_a_texel_is_covered_exactly_when_its_centre_is_in_a_triangle() -> None:
    """Against a plain test of every texel with every triangle."""
    rng = np.random.default_rng(0)
    corners = rng.uniform(-4, 24, (30, 3, 2))
    owner, weights, _ = rasterize_triangles(corners, 20, 21)
    columns, rows = np.meshgrid(np.arange(21) + 0.5, np.arange(20) + 0.5)
    centre = np.stack([columns, rows], -1)
    expected = np.zeros((20, 21), bool)
    for a, b, c in corners:
        side = [
            (q[0] - p[0]) * (centre[..., 1] - p[1]) - (q[1] - p[1]) * (centre[..., 0] - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        expected |= (np.min(side, axis=0) >= 0) | (np.max(side, axis=0) <= 0)
    np.testing.assert_array_equal(owner >= 0, expected)
    rebuilt = (weights[..., None] * corners[owner]).sum(axis=2)
    np.testing.assert_allclose(rebuilt[expected], centre[expected], atol=1e-4)


def test_no_crack_between_faces_that_share_an_edge() -> None:
    """A grid of triangles whose edges run through texel centres leaves none out."""
    n = 9
    x, y = np.meshgrid(np.arange(n) * 2 + 0.5, np.arange(n) * 2 + 0.5)
    points = np.stack([x, y], -1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    corners = np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3, 2), np.stack([a, c, d], 2).reshape(-1, 3, 2)])
    owner, _, overlaps = rasterize_triangles(corners, 20, 20)
    assert (owner[:17, :17] >= 0).all()
    assert overlaps == 0


def test_texels_lie_on_the_surface() -> None:
    mesh, _ = unwrap_mesh(icosphere(4), 256)
    surface = texel_surface(mesh, 256)
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    torch.testing.assert_close(surface.barycentric.sum(1), torch.ones(len(surface.face)))
    np.testing.assert_allclose(surface.position.norm(dim=1), 1, atol=4e-3)
    outwards = torch.nn.functional.normalize(surface.position, dim=1)
    assert float((outwards * surface.normal).sum(1).min()) > 0.9999
    rows, columns = surface.covered.nonzero(as_tuple=True)
    uv = (mesh.uvs[mesh.topology.uv_faces[surface.face]] * surface.barycentric[..., None]).sum(1)
    torch.testing.assert_close(uv, torch.stack([columns + 0.5, rows + 0.5], 1) / 256, atol=1e-5, rtol=0)


def test_an_image_in_the_texture_appears_upright() -> None:
    """v grows downwards: the first row of a texture lies at v = 0."""
    surface = texel_surface(square(), (2, 4))
    assert bool(surface.covered.all())
    grid = surface.position.reshape(2, 4, 3)
    torch.testing.assert_close(grid[0, 0], torch.tensor([-0.75, 0.0, -0.5]))
    torch.testing.assert_close(grid[1, 3], torch.tensor([0.75, 0.0, 0.5]))


def test_dilation_fills_rings_with_means_and_keeps_the_chart() -> None:
    texture = torch.zeros(7, 7, 1)
    covered = torch.zeros(7, 7, dtype=torch.bool)
    texture[3, 3], covered[3, 3] = 5.0, True
    texture[0, 0] = 9.0
    grown = dilate(texture, covered, 2)
    assert bool((grown[1:6, 1:6] == 5).all())
    assert float(grown[0, 0]) == 9, "texels that dilation does not reach stay"
    texture.requires_grad_()
    gradient = torch.autograd.grad(dilate(texture, covered, 2).sum(), texture)[0]
    assert float(gradient[3, 3]) == pytest.approx(25)


def plain_dilation(texture: np.ndarray, covered: np.ndarray, iterations: int) -> np.ndarray:
    values, known = texture.copy(), covered.copy()
    for _ in range(iterations):
        before, reached = values.copy(), known.copy()
        for y, x in np.argwhere(~reached):
            rows, columns = slice(max(0, y - 1), y + 2), slice(max(0, x - 1), x + 2)
            near = before[rows, columns][reached[rows, columns]]
            if len(near):
                values[y, x], known[y, x] = near.mean(axis=0), True
    return values


@pytest.mark.parametrize(("size", "share", "iterations"), [((17, 23), 0.05, 3), ((9, 6), 0.4, 8), ((5, 5), 0.02, 0)])
def test_dilation_is_that_of_a_plain_loop(size: tuple[int, int], share: float, iterations: int) -> None:
    random = np.random.default_rng(0)
    texture, covered = random.random((*size, 3)), random.random(size) < share
    grown = dilate(torch.from_numpy(texture), torch.from_numpy(covered), iterations)
    np.testing.assert_allclose(grown, plain_dilation(texture, covered, iterations), atol=1e-12)


def test_relaxation_is_that_of_a_plain_loop() -> None:
    random = np.random.default_rng(1)
    covered = random.random((14, 11)) < 0.7
    free = covered & (random.random(covered.shape) < 0.6)
    texture = random.random((14, 11, 2))
    expected = texture.copy()
    for _ in range(40):
        before = expected.copy()
        for y, x in np.argwhere(free):
            around = [(y - 1, x), (y + 1, x), (y, x - 1), (y, x + 1)]
            near = [before[p] for p in around if min(p) >= 0 and p[0] < 14 and p[1] < 11 and covered[p]]
            if near:
                expected[y, x] = np.mean(near, axis=0)
    relaxed = texture_inpainting._relax(*(torch.from_numpy(each) for each in (texture, covered, free)))
    np.testing.assert_allclose(relaxed, expected, atol=1e-12)


def test_fill_is_smooth_across_seams_and_keeps_what_was_seen() -> None:
    """Half of a sphere is hidden: a colour that depends linearly on height is continued between its extremes."""
    mesh, _ = unwrap_mesh(icosphere(4), 256)
    surface = texel_surface(mesh, 256)
    texture = torch.zeros(256, 256, 3)
    texture[surface.covered] = surface.position * 0.4 + 0.5
    seen = surface.covered.clone()
    seen[surface.covered] = surface.position[:, 0].abs() > 0.35
    filled = fill_unobserved(texture * seen[..., None], mesh, seen, surface)
    assert torch.equal(filled[seen], texture[seen])
    error = (filled - texture)[surface.covered].abs()
    assert float(error.max()) < 0.08
    assert float(filled[surface.covered].min()) >= float(texture[seen].min()) - 1e-6
    assert float(filled[surface.covered].max()) <= float(texture[seen].max()) + 1e-6


def test_fill_of_a_component_without_any_view_is_the_median() -> None:
    ball = icosphere(2)
    far = Mesh(
        torch.cat([ball.positions, ball.positions + 3]),
        Topology(torch.cat([ball.faces, ball.faces + len(ball.positions)])),
    )
    mesh, _ = unwrap_mesh(far, 128)
    surface = texel_surface(mesh, 128)
    texture = torch.zeros(128, 128, 1)
    texture[surface.covered] = 0.25
    seen = surface.covered.clone()
    seen[surface.covered] = surface.position[:, 0] < 1.5
    filled = fill_unobserved(texture * seen[..., None], mesh, seen, surface)
    torch.testing.assert_close(filled[surface.covered], torch.full((len(surface.face), 1), 0.25))
    nothing = torch.zeros_like(seen)
    assert torch.equal(fill_unobserved(texture, mesh, nothing, surface), texture)


def test_texture_has_a_texel_for_each_pixel() -> None:
    """A square that fills a 256² image, on 0.6 of the texture: the next power of two above 330, twice it for twice the
    resolution."""

    def camera(width: int):  # type: ignore[no-untyped-def]
        return looking_at((0.0, 1.0 / 2 * 2 * 1.5 * 2, 0.0), width, width, focal=1.5)

    assert texture_size(square(), [camera(256)]) == 512
    assert texture_size(square(), [camera(512)]) == 1024
    assert texture_size(square(), [looking_at((0.0, -3.0, 0.0), 512, 512)]) == 64, "seen from behind"


def strips(count: int) -> Mesh:
    """A square in strips with gaps; each becomes a chart of its own."""
    left = torch.linspace(-1, 1, count + 1)[:-1]
    right = left + 1.8 / count
    low, high = torch.full_like(left, -1), torch.full_like(left, 1)
    corners = torch.stack([torch.stack(c, 1) for c in ((left, low), (right, low), (right, high), (left, high))], 1)
    flat = corners.reshape(-1, 2)
    positions = torch.stack([flat[:, 0], torch.zeros(len(flat)), flat[:, 1]], 1)
    first = 4 * torch.arange(count)[:, None]
    faces = torch.cat([first + torch.tensor([0, 2, 1]), first + torch.tensor([0, 3, 2])])
    return Mesh(positions, Topology(faces))


def test_charts_that_leave_most_of_the_atlas_empty_get_a_larger_texture(tmp_path: Path) -> None:
    """Gaps between 100 strips take most of it: two or three pixels of a photograph would share a texel."""
    camera = looking_at((0.0, 3.0, 0.0), 380, 380, focal=1.5)
    derived, capture = texture_size(strips(1), [camera]), capture_of(camera)
    for mesh, doubled in ((strips(1), False), (strips(100), True)):
        unwrapped, report = unwrap(Scene(mesh), capture, AtlasSettings(), context(tmp_path, []))
        assert (report.texture_size > derived) == doubled
        assert texel_surface(unwrapped.mesh, report.texture_size).covered.sum() > 0.45 * 380**2
        assert unwrapped.material is not None and len(unwrapped.material.diffuse_albedo) == report.texture_size
    _, report = unwrap(Scene(strips(100)), capture, AtlasSettings(texture_size=derived), context(tmp_path, []))
    assert report.texture_size == derived, "one that was set stays"
    small = replace(square(), uvs=square().uvs * 0.3)  # coordinates of the mesh itself, on 0.09 of the atlas
    _, report = unwrap(Scene(small), capture, AtlasSettings(), context(tmp_path, []))
    assert report.texture_size == 2 * derived and report.charts is None


def test_stage_keeps_good_coordinates_and_replaces_bad_ones(tmp_path: Path) -> None:
    warnings: list[str] = []
    capture = capture_of(looking_at((0, 3, 0), 128, 128))
    settings = AtlasSettings(texture_size=64)
    kept, report = unwrap(Scene(square()), capture, settings, context(tmp_path, warnings))
    assert torch.equal(kept.mesh.uvs, square().uvs)  # type: ignore[arg-type]
    assert report.texture_size == 64
    assert not warnings
    overlapping = replace(bumpy_sphere(), uvs=square().uvs)
    overlapping = replace(overlapping, topology=Topology(overlapping.faces, overlapping.faces % 4))
    fresh, _ = unwrap(Scene(overlapping), capture, settings, context(tmp_path, warnings))
    assert texel_surface(fresh.mesh, 128).overlaps == 0
    assert len(warnings) == 1


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda uvs: uvs + torch.tensor([1.0, 0.0]), r"outside 0…1 \(as UDIM tiles"),
        (lambda uvs: None, "no texture coordinates"),
        (lambda uvs: uvs * 0, "without an area"),
        (lambda uvs: uvs[[0, 0, 1, 1]] * 0.5 + uvs[[0, 2, 0, 2]] * 0.1, "without an area|overlap"),
    ],
)
def test_coordinates_that_cannot_be_kept_name_the_file_and_the_remedy(change, words: str, tmp_path: Path) -> None:  # type: ignore[no-untyped-def]
    settings = AtlasSettings(texture_size=64, texture_coordinates="keep")
    mesh = replace(square(), uvs=change(square().uvs))
    capture = capture_of(looking_at((0, 3, 0), 128, 128))
    with pytest.raises(StageError, match=f"^scan.obj has .*({words}).*unwrap it .*texture_coordinates"):
        unwrap(Scene(mesh), capture, settings, context(tmp_path, []), "scan.obj")


@pytest.mark.parametrize(("beyond", "kept"), [(1e-6, True), (9e-4, True), (2e-3, False)])
def test_coordinates_that_a_program_rounded_are_moved_to_the_border(beyond: float, kept: bool, tmp_path: Path) -> None:
    mesh, _ = unwrap_mesh(bumpy_sphere(), 64)
    assert mesh.uvs is not None
    low, high = mesh.uvs.min(dim=0).values, mesh.uvs.max(dim=0).values
    stretched = (mesh.uvs - low) / (high - low) * (1 + 2 * beyond) - beyond
    settings = AtlasSettings(texture_size=64, texture_coordinates="keep")
    scene = Scene(replace(mesh, uvs=stretched))
    if not kept:
        with pytest.raises(StageError, match="outside 0…1"):
            unwrap(scene, capture_of(), settings, context(tmp_path, []))
        return
    found, report = unwrap(scene, capture_of(), settings, context(tmp_path, []))
    assert report.charts is None and found.mesh.uvs is not None
    torch.testing.assert_close(found.mesh.uvs, stretched.clamp(0, 1), rtol=0, atol=0)


def test_stage_bakes_vertex_colours(tmp_path: Path) -> None:
    mesh = icosphere(3)
    mesh = replace(mesh, vertex_colors=mesh.positions * 0.4 + 0.5)
    scene, _ = unwrap(
        Scene(mesh), capture_of(looking_at((0, 0, 4), 64, 64)), AtlasSettings(texture_size=128), context(tmp_path, [])
    )
    assert scene.material is not None
    surface = texel_surface(scene.mesh, 128)
    expected = surface.position * 0.4 + 0.5
    torch.testing.assert_close(scene.material.diffuse_albedo[surface.covered], expected, atol=1e-5, rtol=0)


def test_stage_gives_a_mesh_without_colours_a_texture_of_the_size_that_was_set(tmp_path: Path) -> None:
    """Later stages fit as many texels; a constant would have been one colour for the whole object."""
    scene = Scene(mesh=replace(icosphere(2), vertex_colors=None))
    capture = capture_of(looking_at((0, 0, 4), 64, 64))
    unwrapped, report = unwrap(scene, capture, AtlasSettings(texture_size=64), context(tmp_path, []))
    assert report.texture_size == 64 and unwrapped.material is not None
    assert unwrapped.material.diffuse_albedo.shape == (64, 64, 3)
    assert bool((unwrapped.material.diffuse_albedo == 0.5).all())


def test_a_mesh_without_triangles_is_named() -> None:
    with pytest.raises(StageError, match="no triangles"):
        unwrap_mesh(Mesh(torch.zeros(3, 3), Topology(torch.zeros(0, 3, dtype=torch.long))), 64)


@pytest.mark.slow
def test_four_times_as_many_noisy_triangles_take_less_than_three_times_as_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """Processor seconds of the process that cuts, against those of xatlas alone for a quarter of the triangles on the
    same machine: 10.6 and 6.1 on one, and 24.0 for xatlas alone with all. No texel is covered twice.
    """
    quarter = noisy(bumpy_sphere(5))
    with monkeypatch.context() as patch:
        patch.setattr(uv_charts, "SIMPLIFIED_FROM", len(quarter.faces))
        by_xatlas = child_seconds(lambda: unwrap_mesh(quarter, 1024))
    mesh = noisy(bumpy_sphere(6))
    assert len(mesh.faces) > 80_000
    cut: list[Mesh] = []
    assert child_seconds(lambda: cut.append(unwrap_mesh(mesh, 1024)[0])) < 3 * by_xatlas
    assert texel_surface(cut[0], 1024).overlaps == 0


def noisy(mesh: Mesh) -> Mesh:
    edge = float((mesh.positions[mesh.faces[:, 0]] - mesh.positions[mesh.faces[:, 1]]).norm(dim=1).mean())
    noise = torch.from_numpy(np.random.default_rng(0).normal(size=(len(mesh.positions), 1)) * 0.2 * edge)
    return mesh.with_positions((mesh.positions * (1 + noise)).to(mesh.positions))


def child_seconds(call: Callable[[], object]) -> float:
    """Processor seconds of the processes that ended in a call."""
    import resource

    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    call()
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
