"""Motions, scales, reflections, reorderings and recolourings of the input change the result accordingly and no more."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hir_exporters.asset import AssetMaterial
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.light.environment_map import irradiance_harmonics, mean_radiance, rotate_latlong
from hir_exporters.materials.brdf_numpy import dielectric_brdf, paper_brdf
from hir_exporters.materials.material_conversion import to_gltf
from hir_exporters.mesh.tangents import corner_tangents
from hir_exporters.textures.image_files import read_ldr, write_png
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hir_core.capture import Capture, Pixels, View
from hir_core.config import GeometrySettings
from hir_core.mesh.mesh_validity import inspect_mesh
from hir_core.pipeline import Run
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Mesh, Scene, Topology
from hir_core.scene.frames import unit_similarity
from hir_core.scene.scene_store import load_stage_scene
from hir_core.stages.geometry.geometry_fit import fit_geometry
from hir_core.testing.captures import tiny_capture
from hir_core.testing.scenes import sphere

FEW = settings(
    max_examples=6, deadline=None, derandomize=True, database=None, suppress_health_check=[HealthCheck.too_slow]
)
SEEDS = st.integers(0, 2**31)

SETTINGS = GeometrySettings(
    renderer="contour",
    iterations=25,
    levels=1,
    remesh=False,
    photo_consistency="off",
    outline_iterations=25,
    held_out=0.0,
    prune=False,
    robust=False,
    views_per_step=8,
    regularizers={"laplacian": {"weight": 0.05}},
)
"""All views in every step, one mesh: nothing depends on a random order."""


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Capture:
    return tiny_capture(tmp_path_factory.mktemp("tiny"), views=8, size=48).capture


def fitted(mesh: Mesh, capture: Capture, folder: Path) -> np.ndarray:
    """Vertices after the geometry stage."""
    geometry, _ = fit_geometry(Scene(mesh), capture, SETTINGS, StageContext(PluginManager.discover(), folder))
    return geometry.scene.mesh.positions.numpy().astype(np.float64)


def moved(mesh: Mesh, transform: np.ndarray) -> Mesh:
    points = mesh.positions.numpy().astype(np.float64) @ transform[:3, :3].T + transform[:3, 3]
    return mesh.with_positions(torch.from_numpy(points.astype(np.float32)))


def similarity(seed: int, scale: float = 1.0) -> np.ndarray:
    transform = np.eye(4)
    transform[:3, :3] = scale * Rotation.random(random_state=seed).as_matrix()
    transform[:3, 3] = scale * np.random.default_rng(seed).normal(size=3)
    return transform


PIXEL = 3.4 / (1.05 * 48)
"""Width of a pixel of the tiny capture at the object."""


@pytest.mark.parametrize(
    "scale", [1e-3, pytest.param(250.0, marks=pytest.mark.slow)], ids=["millimetres", "a building"]
)
def test_other_units_give_the_same_mesh_in_those_units(capture: Capture, scale: float, tmp_path: Path) -> None:
    start = sphere(10, 14, 1.3)
    plain = fitted(start, capture, tmp_path / "a")
    units = np.diag([scale, scale, scale, 1.0])
    again = fitted(moved(start, units), capture.transformed(units), tmp_path / "b")
    assert np.abs(plain - start.positions.numpy()).max() > 0.1, "the fit does something"
    np.testing.assert_allclose(again / scale, plain, atol=1e-4)


@pytest.mark.slow
def test_a_turned_and_shifted_capture_gives_the_turned_and_shifted_mesh(capture: Capture, tmp_path: Path) -> None:
    start = sphere(10, 14, 1.3)
    plain = fitted(start, capture, tmp_path / "a")
    transform = similarity(3)
    again = fitted(moved(start, transform), capture.transformed(transform), tmp_path / "b")
    # the box about the mesh, and with it the step size, turns only nearly: a tenth of a pixel after 25 steps
    np.testing.assert_allclose(again, plain @ transform[:3, :3].T + transform[:3, 3], atol=0.1 * PIXEL)


def test_a_mirrored_capture_gives_the_mirrored_mesh(capture: Capture, tmp_path: Path) -> None:
    start = sphere(10, 14, 1.3)
    plain = fitted(start, capture, tmp_path / "a")
    mirror = np.diag([-1.0, 1.0, 1.0])

    def flip(view: View) -> View:
        camera, pixels = view.camera, view.read()
        assert camera is not None and pixels.mask is not None
        # the world's x and the picture's x both turn: the camera stays right-handed
        pose = np.diag([-1.0, 1, 1, 1]) @ camera.world_to_camera @ np.diag([-1.0, 1, 1, 1])
        intrinsics = camera.intrinsics.copy()
        intrinsics[0, 2] = camera.width - intrinsics[0, 2]
        turned = Pixels(
            pixels.color_linear[:, ::-1].copy(), pixels.mask[:, ::-1].copy(), pixels.saturated[:, ::-1].copy()
        )
        return replace(view, camera=replace(camera, world_to_camera=pose, intrinsics=intrinsics), read=lambda: turned)

    mirrored = Mesh(
        torch.from_numpy((start.positions.numpy() @ mirror).astype(np.float32)),
        Topology(start.faces[:, [0, 2, 1]].contiguous()),
    )
    again = fitted(mirrored, replace(capture, views=tuple(map(flip, capture.views))), tmp_path / "b")
    np.testing.assert_allclose(again @ mirror, plain, atol=3e-3)


@pytest.mark.slow
def test_the_order_of_views_and_vertices_does_not_matter(capture: Capture, tmp_path: Path) -> None:
    start = sphere(10, 14, 1.3)
    plain = fitted(start, capture, tmp_path / "a")
    order = np.random.default_rng(0).permutation(len(capture.views))
    views = tuple(capture.views[i] for i in order)
    np.testing.assert_allclose(fitted(start, replace(capture, views=views), tmp_path / "b"), plain, atol=1e-3)
    shuffle = np.random.default_rng(1).permutation(len(start.positions))
    back = np.argsort(shuffle)
    other = Mesh(start.positions[torch.from_numpy(shuffle)], Topology(torch.from_numpy(back)[start.faces]))
    np.testing.assert_allclose(fitted(other, capture, tmp_path / "c")[back], plain, atol=1e-3)


@FEW
@given(SEEDS)
def test_the_state_of_a_mesh_does_not_depend_on_place_size_or_order(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = sphere(6, 8)
    points, faces = mesh.positions.numpy().astype(np.float64), mesh.faces.numpy()
    points = points + rng.normal(size=points.shape) * 0.05
    state = inspect_mesh(points, faces)
    transform = similarity(seed, float(rng.uniform(0.01, 100)))
    shuffle = rng.permutation(len(points))
    place = points[shuffle] @ transform[:3, :3].T + transform[:3, 3]
    turned = np.argsort(shuffle)[faces[rng.permutation(len(faces))]]
    assert inspect_mesh(place, np.roll(turned, 1, axis=1)) == state
    frame = unit_similarity(Mesh(torch.from_numpy(place.astype(np.float32)), Topology(torch.from_numpy(turned))))
    unit = place @ frame[:3, :3].T + frame[:3, 3]
    assert np.linalg.norm(unit, axis=1).max() == pytest.approx(1.0, abs=1e-5)


def _directions(rng: np.random.Generator) -> np.ndarray:
    d = rng.normal(size=(2, 20, 3))
    d[..., 2] = np.abs(d[..., 2]) + 0.02
    return d / np.linalg.norm(d, axis=-1, keepdims=True)


@FEW
@given(SEEDS)
def test_brdfs_do_not_change_with_turns_mirrors_and_swaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wi, wo = _directions(rng)
    diffuse, specular, alpha = rng.random(3) * 0.8, rng.random(3) * 0.2, rng.uniform(0.01, 1)
    turn = Rotation.from_euler("z", rng.uniform(0, 7)).as_matrix()
    for brdf in (paper_brdf, dielectric_brdf):
        value = brdf(wi, wo, diffuse, specular, alpha)
        assert np.isfinite(value).all() and (value >= 0).all()
        np.testing.assert_allclose(brdf(wi @ turn.T, wo @ turn.T, diffuse, specular, alpha), value, rtol=1e-9)
        flip = np.array([-1.0, 1, 1])
        np.testing.assert_allclose(brdf(wi * flip, wo * flip, diffuse, specular, alpha), value, rtol=1e-12)
        swap = rng.permutation(3)
        np.testing.assert_allclose(brdf(wi, wo, diffuse[swap], specular[swap], alpha), value[..., swap], rtol=1e-12)
    np.testing.assert_allclose(  # Helmholtz; the diffuse part of `dielectric` is coupled to one side only
        paper_brdf(wo, wi, diffuse, specular, alpha), paper_brdf(wi, wo, diffuse, specular, alpha), rtol=1e-9
    )


@FEW
@given(SEEDS, st.sampled_from(["khr", "blender", "metalrough", "unity-legacy"]))
def test_conversions_swap_channels_with_the_material(seed: int, profile: str) -> None:
    rng = np.random.default_rng(seed)
    model = ("paper", "dielectric")[seed % 2]
    diffuse, specular = (rng.random((2, 2, 3)) * s for s in (0.7, 0.3))
    swap = rng.permutation(3)

    def convert(channels: list[int]) -> dict[str, object]:
        material = AssetMaterial(
            model,
            diffuse[..., channels].astype(np.float32),
            specular[..., channels].astype(np.float32),
            np.float32(0.3).reshape(()),
        )
        return vars(to_gltf(material, profile))  # type: ignore[arg-type]

    plain, other = convert([0, 1, 2]), convert(list(swap))
    for name, value in plain.items():
        if isinstance(value, np.ndarray):
            expected = value[..., swap] if value.shape[-1:] == (3,) else value
            np.testing.assert_allclose(other[name], expected, atol=2e-5, err_msg=name)


@FEW
@given(SEEDS)
def test_lights_keep_their_energy_in_every_turn(seed: int) -> None:
    light = np.random.default_rng(seed).random((8, 16, 3)) ** 8 * 100
    turn = Rotation.random(random_state=seed).as_matrix()
    turned = rotate_latlong(light, turn)
    np.testing.assert_allclose(mean_radiance(turned), mean_radiance(light), rtol=1e-9)
    np.testing.assert_allclose(irradiance_harmonics(turned)[0], irradiance_harmonics(light)[0], rtol=0.02)
    np.testing.assert_allclose(rotate_latlong(7.5 * light, turn), 7.5 * turned, rtol=1e-9)


@FEW
@given(SEEDS)
def test_tangents_turn_with_the_mesh_and_forget_its_size(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = sphere(5, 6)
    points, normals = mesh.positions.numpy(), mesh.normals.numpy()
    uvs, faces = rng.random((len(points), 2)).astype(np.float32), mesh.faces.numpy().astype(np.int32)
    plain = corner_tangents(points, normals, uvs, faces)
    turn = Rotation.random(random_state=seed).as_matrix()
    other = corner_tangents(
        (points @ turn.T * 1e-3 + 5).astype(np.float32), (normals @ turn.T).astype(np.float32), uvs, faces
    )
    close = np.abs(other[..., :3] - plain[..., :3] @ turn.T).max(axis=-1) < 0.02
    # a corner whose faces' tangents cancel has none to speak of: float32 of a place 5000 sizes away decides
    assert close.mean() > 0.97 and (other[..., 3] == plain[..., 3]).all()


@FEW
@given(st.lists(st.floats(-0.5, 4.0, width=32), min_size=1, max_size=50))
def test_srgb_is_its_own_inverse_and_rises(values: list[float]) -> None:
    linear = np.sort(np.array(values, np.float64))
    np.testing.assert_allclose(srgb_to_linear(linear_to_srgb(linear)), linear, atol=1e-9)
    assert (np.diff(linear_to_srgb(linear)) >= 0).all()


@pytest.mark.slow
def test_swapped_channels_give_swapped_textures_and_light(
    tiny_capture: Path, quick: Callable[..., Run], tmp_path: Path
) -> None:
    """A whole fit of photographs whose red, green and blue were permuted; the mesh is the same to the last bit."""
    swapped = tmp_path / "tiny"
    shutil.copytree(tiny_capture, swapped)
    for path in (swapped / "train").iterdir():
        write_png(path, read_ldr(path)[..., [1, 2, 0, 3]])
    scenes = []
    for name, source in (("plain", tiny_capture), ("swapped", swapped)):
        run = quick(source, tmp_path / name, "geometry.photo_consistency=off", until="reflectance", deterministic=True)
        scenes.append(load_stage_scene(run.directory.stage("reflectance") / "scene"))
    plain, other = scenes
    assert torch.equal(plain.mesh.positions, other.mesh.positions)
    assert plain.material is not None and other.material is not None
    assert plain.environment is not None and other.environment is not None
    order = [1, 2, 0]
    pairs = [
        (plain.material.diffuse_albedo, other.material.diffuse_albedo),
        (plain.environment.radiance.log(), other.environment.radiance.log()),
    ]
    for one, two in pairs:
        assert float((one[..., order] - two).abs().mean()) < 1e-3
