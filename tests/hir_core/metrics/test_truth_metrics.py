"""Figures against a true mesh, light and albedo: by definition, by formula, and by other programs."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import trimesh
from hir_exporters.conventions import latlong_directions, linear_to_srgb

from hir_core.metrics import light_metrics, published_conventions, surface_metrics
from hir_core.rendering.orbit_cameras import orbit_cameras


def ball(radius: float = 1.0, subdivisions: int = 5) -> tuple[np.ndarray, np.ndarray]:
    made = trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius)
    return np.asarray(made.vertices), np.asarray(made.faces)


class TestSurfaces:
    def test_equal_surfaces_cut_differently_have_no_distance(self) -> None:
        box = trimesh.creation.box()
        cut = box.subdivide().subdivide()
        found = surface_metrics.compare_surfaces((box.vertices, box.faces), (cut.vertices, cut.faces), samples=5000)
        assert found.chamfer < 1e-6 and found.normal_error_deg < 1.0
        assert set(found.f_score.values()) == {1.0}

    def test_a_sphere_that_is_too_large_is_off_by_the_difference_of_radii(self) -> None:
        found = surface_metrics.compare_surfaces(ball(1.015), ball(1.0), samples=5000)
        # in units of half the diagonal of the truth's box, √3 for the unit sphere
        assert found.accuracy == pytest.approx(0.015 / np.sqrt(3), rel=0.02)
        assert found.completeness == pytest.approx(0.015 / np.sqrt(3), rel=0.02)
        assert found.chamfer_squared == pytest.approx((0.015 / np.sqrt(3)) ** 2, rel=0.04)
        assert found.f_score[0.005] == 0.0 and found.f_score[0.01] == 1.0

    def test_place_turn_and_size_of_the_world_change_nothing(self) -> None:
        fit, truth = ball(1.02, 3), ball(1.0, 3)
        moved = [(mesh[0] * 250 + [1e4, 5, -3e3], mesh[1]) for mesh in (fit, truth)]
        near, far = (surface_metrics.compare_surfaces(*pair, samples=2000) for pair in ((fit, truth), moved))
        assert far.chamfer == pytest.approx(near.chamfer, rel=1e-3)

    def test_distance_from_a_box_is_its_formula(self) -> None:
        box = trimesh.creation.box()
        points = np.random.default_rng(7).uniform(-2, 2, (500, 3))
        outside = np.linalg.norm(np.maximum(np.abs(points) - 0.5, 0), axis=1)
        inside = np.maximum(0.5 - np.abs(points).max(axis=1), 0)
        found, face = surface_metrics.MeshQueries(box.vertices, box.faces).nearest(points)
        np.testing.assert_allclose(found, outside + inside, atol=1e-6)
        assert face.min() >= 0 and face.max() < len(box.faces)

    def test_normals_of_a_turned_plane_are_off_by_the_turn(self) -> None:
        flat = (np.array([[-1, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1.0]]), np.array([[0, 2, 1], [0, 3, 2]]))
        turn = trimesh.transformations.rotation_matrix(np.radians(10), [1, 0, 0])[:3, :3]
        found = surface_metrics.compare_surfaces((flat[0] @ turn.T, flat[1]), flat, samples=2000)
        assert found.normal_error_deg == pytest.approx(10.0, abs=1e-3)

    def test_points_are_even_by_area(self) -> None:
        corners = np.array([[0, 0, 0], [3, 0, 0], [3, 1, 0], [0, 1, 0], [0, 0, 0.0], [1, 0, 0], [1, 1, 0]])
        points, normals = surface_metrics.sample_surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), 20_000, seed=3)
        # a mean of a uniform variable over (0, 3) has the standard error 3 / √(12 N)
        assert points[:, 0].mean() == pytest.approx(1.5, abs=5 * 3 / np.sqrt(12 * 20_000))
        np.testing.assert_allclose(normals, [[0, 0, 1]] * 20_000)

    def test_what_no_camera_sees_does_not_count(self) -> None:
        shell, core = ball(1.0, 4), ball(0.5, 3)
        both = (np.concatenate([shell[0], core[0]]), np.concatenate([shell[1], core[1] + len(shell[0])]))
        cameras = [*orbit_cameras(6, 30.0, 64), *orbit_cameras(6, -30.0, 64)]
        all_of_it = surface_metrics.compare_surfaces(shell, both, samples=4000)
        outside = surface_metrics.compare_surfaces(shell, both, cameras, samples=4000)
        assert all_of_it.completeness > 0.03 and outside.completeness < 1e-6


class TestPublished:
    """Stanford-ORB's rules, restated here with OpenCV."""

    @pytest.fixture
    def pictures(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        random = np.random.default_rng(4)
        truth = random.gamma(1.0, 0.4, (48, 40, 3)).astype(np.float32)
        fit = (truth * [0.8, 1.1, 1.3] + random.normal(0, 0.03, truth.shape)).clip(0).astype(np.float32)
        coverage = np.zeros((48, 40), np.float32)
        coverage[6:44, 0:33] = 1.0
        return fit, truth, coverage

    def test_mask_is_eroded_as_opencv_does(self, pictures: tuple[np.ndarray, ...]) -> None:
        coverage = pictures[2]
        expected = cv2.erode((coverage * 255).astype(np.uint8), np.ones((5, 5), np.uint8)) > 127
        np.testing.assert_array_equal(published_conventions.eroded(coverage), expected)

    @pytest.mark.parametrize("scaled", [False, True])
    def test_psnr_high_and_low(self, pictures: tuple[np.ndarray, ...], scaled: bool) -> None:
        fit, truth, coverage = pictures
        mask = (cv2.erode((coverage * 255).astype(np.uint8), np.ones((5, 5), np.uint8)) > 127)[..., None]
        a, b = fit.astype(np.float64) * mask, truth.astype(np.float64) * mask
        if scaled:
            inside = mask[..., 0]
            a = a * [np.linalg.lstsq(a[inside][:, [c]], b[inside][:, c], rcond=None)[0][0] for c in range(3)]
        gain = linear_to_srgb(b.clip(0, 1)).mean() / b.clip(0, 1).mean()
        high = -10 * np.log10(np.mean(((a * gain).clip(0, 4) - (b * gain).clip(0, 4)) ** 2))
        low = -10 * np.log10(np.mean((linear_to_srgb(a.clip(0, 1)) - linear_to_srgb(b.clip(0, 1))) ** 2))
        found = published_conventions.stanford_orb(fit, truth, coverage, scaled)
        assert found.psnr_h == pytest.approx(high, abs=1e-5)
        assert found.psnr_l == pytest.approx(low, abs=1e-5)
        assert found.lpips is None

    def test_nothing_is_worse_than_grey(self, pictures: tuple[np.ndarray, ...]) -> None:
        _, truth, coverage = pictures
        mask = published_conventions.eroded(coverage)[..., None]
        white = np.full_like(truth, 50.0)
        b = linear_to_srgb((truth * mask).clip(0, 1))
        grey = -10 * np.log10(np.mean((0.5 * mask - b) ** 2))
        assert published_conventions.stanford_orb(white, truth, coverage, False).psnr_l == pytest.approx(grey, abs=1e-4)

    def test_ssim_of_small_windows_at_one_pixel(self) -> None:
        random = np.random.default_rng(5)
        a, b = random.random((2, 3, 3, 1))
        g = np.exp(-0.5 * np.array([1, 0, 1]) / 1.5**2)
        w = np.outer(g, g) / g.sum() ** 2
        x, y = a[..., 0], b[..., 0]
        mx, my = (w * x).sum(), (w * y).sum()
        vx, vy, c = (w * x * x).sum() - mx**2, (w * y * y).sum() - my**2, (w * x * y).sum() - mx * my
        one = (2 * mx * my + 1e-4) * (2 * c + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
        assert published_conventions.small_window_ssim(a, b)[1, 1, 0] == pytest.approx(one, rel=1e-9)
        # borders are mirrored: seen from the corner, the window is [[e, d, e], [b, a, b], [e, d, e]]
        mirrored = np.pad(a[..., 0], 1, mode="reflect")[:3, :3], np.pad(b[..., 0], 1, mode="reflect")[:3, :3]
        corner = published_conventions.small_window_ssim(mirrored[0][..., None], mirrored[1][..., None])[1, 1, 0]
        assert published_conventions.small_window_ssim(a, b)[0, 0, 0] == pytest.approx(corner, rel=1e-9)

    def test_albedo_may_be_scaled_by_channel(self, pictures: tuple[np.ndarray, ...]) -> None:
        _, truth, coverage = pictures
        assert published_conventions.stanford_orb_albedo(truth * np.float32(0.3), truth, coverage) > 99


class TestLight:
    def test_a_scaled_light_is_the_same_light(self) -> None:
        truth = np.random.default_rng(6).gamma(0.5, 1.0, (32, 64, 3))
        found = light_metrics.compare_lights(truth * 0.25, truth)
        assert found.scale == pytest.approx(4.0) and found.texels < 1e-12
        assert all(error < 1e-12 for error in found.spheres.values())
        assert all(angle < 1e-4 for angle in found.angular_deg.values())

    def test_error_of_a_light_is_by_solid_angle(self) -> None:
        truth = np.ones((64, 128, 3))
        wrong = truth.copy()
        wrong[:32] = 0.0
        # half the sphere is dark: the best scale is 1, and half of the squares are left
        found = light_metrics.compare_lights(wrong, truth)
        assert found.scale == pytest.approx(1.0) and found.texels == pytest.approx(np.sqrt(0.5), rel=1e-9)
        polar = truth.copy()
        polar[0] = 3.0
        near = light_metrics.compare_lights(polar, truth).texels
        polar[0], polar[32] = 1.0, 3.0
        assert light_metrics.compare_lights(polar, truth).texels > 4 * near, "a row at the pole is small"

    def test_colour_error_is_an_angle(self) -> None:
        red, yellow = np.zeros((16, 32, 3)), np.zeros((16, 32, 3))
        red[..., 0], yellow[..., :2] = 1, 1
        found = light_metrics.compare_lights(yellow, red)
        assert found.angular_deg == pytest.approx(dict.fromkeys(light_metrics.SPHERES, 45.0), abs=1e-6)

    def test_white_furnace_makes_all_spheres_white(self) -> None:
        for name, picture in light_metrics.three_spheres(np.full((32, 64, 3), 0.7)).items():
            np.testing.assert_allclose(picture, 0.7, rtol=2e-3, err_msg=name)

    def test_mirror_and_diffuse_spheres_are_mitsubas(self) -> None:
        mi = pytest.importorskip("mitsuba", reason="pip install 'hir[reconstruct]'")
        mi.set_variant("llvm_ad_rgb")
        d = latlong_directions(32, 64)
        radiance = (0.6 + 0.5 * d[..., 1:2] + 0.3 * np.sin(2 * d[..., :1] + d[..., 2:])).clip(0.05) * [1.0, 0.8, 0.6]
        # Mitsuba's panoramas have one convention with ours (docs/conventions.md)
        emitter = {"type": "envmap", "bitmap": mi.Bitmap(radiance.astype(np.float32))}
        pixels = light_metrics.SPHERE_PIXELS
        film = {"type": "hdrfilm", "width": pixels, "height": pixels, "rfilter": {"type": "box"}}
        camera_at = mi.ScalarTransform4f().look_at([0, 0, 4], [0, 0, 0], [0, 1, 0])
        sensor = {"type": "orthographic", "to_world": camera_at, "film": film}
        normals = light_metrics.sphere_normals()
        ticks = (np.arange(pixels) + 0.5) / pixels * 2 - 1
        x, y = np.meshgrid(ticks, -ticks)
        inside = x**2 + y**2 < 0.98
        ours = light_metrics.three_spheres(radiance)
        bsdfs = {
            "mirror": {"type": "conductor", "material": "none"},
            "diffuse": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 1.0}},
        }
        for name, bsdf in bsdfs.items():
            scene = mi.load_dict(
                {
                    "type": "scene",
                    "integrator": {"type": "direct"},
                    "sensor": sensor,
                    "emitter": emitter,
                    "ball": {"type": "sphere", "bsdf": bsdf},
                }
            )
            first, second = (np.array(mi.render(scene, spp=512, seed=seed))[..., :3][inside] for seed in (1, 2))
            theirs = (first + second) / 2
            drawn = np.full((pixels, pixels, 3), np.nan)
            drawn[inside] = ours[name]
            # ours is the value at a pixel's centre, theirs its mean: no further apart than the next pixel
            steps = [np.abs(drawn - np.roll(drawn, shift, axis)) for shift in (-1, 1) for axis in (0, 1)]
            bound = np.max(steps, axis=0)[inside]
            whole = np.isfinite(bound).all(axis=1) & (normals[:, 2] > 0.3)
            off = np.abs(ours[name] - theirs)[whole]
            noise = 5 * np.sqrt(np.mean((first - second) ** 2)) / 2
            assert whole.sum() > 1000 and (off <= bound[whole] + noise).all(), name
            assert ours[name][whole].mean() == pytest.approx(theirs[whole].mean(), rel=0.003), name

    def test_silver_sphere_is_brightest_where_it_reflects_a_lamp(self) -> None:
        point = np.zeros((32, 64, 3))
        point[10, 31] = 1.0
        picture = light_metrics.three_spheres(point)["silver"][:, 0]
        normals = light_metrics.sphere_normals()
        half = latlong_directions(32, 64)[10, 31] + np.array([0.0, 0.0, 1.0])
        half /= np.linalg.norm(half)
        assert (normals[picture.argmax()] @ half) == pytest.approx(normals.dot(half).max(), abs=2e-3)
