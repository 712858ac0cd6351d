"""What goes to disk between stages comes back bit for bit, and never by way of pickle."""

from __future__ import annotations

import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.capture import Camera, Capture, OrientedPoints, Pixels, View
from hir_core.capture.measured_irradiance import MeasuredIrradiance
from hir_core.errors import InputError, StageError
from hir_core.run.capture_store import (
    camera_document,
    camera_from_document,
    fingerprint,
    read_cameras,
    restore_capture,
    save_capture,
    write_cameras,
)
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene, Topology
from hir_core.scene.frames import move_scene, unit_similarity
from hir_core.scene.scene_store import load_stage_scene, save_stage_scene

CARD = MeasuredIrradiance((0.0, 1.0, 0.0), {"v0": (1.0, 2.0, 3.0), "v2": (4.0, 2.0, 3.0)})


def a_camera(x: float = 0.1) -> Camera:
    pose = np.eye(4)
    pose[:3, 3] = [x, 1 / 3, 4.0]
    return Camera(np.array([[500.0, 0, 31.9], [0, 500.1, 32.3], [0, 0, 1]]), pose, 64, 60, (0.1, -0.02))


def a_capture(folder: Path, count: int = 3) -> Capture:
    def pixels() -> Pixels:
        return Pixels(np.ones((4, 5, 3), np.float32), np.ones((4, 5), np.float32), np.zeros((4, 5), bool))

    views = []
    for i in range(count):
        path = folder / f"{i}.png"
        path.write_bytes(bytes([i]))
        views.append(View(f"v{i}", a_camera(i), pixels, path=path))
    return Capture(folder, tuple(views), reader="test")


def a_scene() -> Scene:
    generator = torch.Generator().manual_seed(1)

    def random(*shape: int) -> torch.Tensor:
        return torch.rand(*shape, generator=generator)

    faces = torch.tensor([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    mesh = Mesh(random(4, 3), Topology(faces, faces.clone()), random(4, 2), random(4, 3))
    material = Material("dielectric", random(8, 8, 3), random(3), random(8, 8, 1), random(8, 8, 3), random(8, 8) > 0.5)
    return Scene(mesh, material, EnvironmentMap(random(4, 8, 3), torch.eye(3), "camera"))


def tensors(value: object) -> dict[str, object]:
    """Every leaf of a scene by name."""
    from dataclasses import fields, is_dataclass

    if is_dataclass(value):
        return {f"{f.name}.{k}": v for f in fields(value) for k, v in tensors(getattr(value, f.name)).items()}
    return {"": value}


def test_scene_comes_back_bit_for_bit(tmp_path: Path) -> None:
    scene = a_scene()
    save_stage_scene(scene, tmp_path / "scene")
    loaded = tensors(load_stage_scene(tmp_path / "scene"))
    for name, value in tensors(scene).items():
        if isinstance(value, torch.Tensor):
            assert torch.equal(value, loaded[name]) and value.dtype == loaded[name].dtype, name  # type: ignore[attr-defined]
        else:
            assert value == loaded[name], name


def test_same_scene_gives_the_same_bytes(tmp_path: Path) -> None:
    for name in ("a", "b"):
        save_stage_scene(a_scene(), tmp_path / name)
    for file in sorted((tmp_path / "a").iterdir()):
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes(), file.name


def test_pickled_arrays_are_refused(tmp_path: Path) -> None:
    class Evil:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (open, (str(tmp_path / "owned"), "w"))

    save_stage_scene(a_scene(), tmp_path / "scene")
    np.savez(tmp_path / "scene" / "arrays.npz", positions=np.array([Evil()], dtype=object))
    with pytest.raises(InputError, match=r"arrays\.npz"):
        load_stage_scene(tmp_path / "scene")
    (tmp_path / "scene" / "arrays.npz").write_bytes(pickle.dumps(Evil()))
    with pytest.raises(InputError, match=r"arrays\.npz"):
        load_stage_scene(tmp_path / "scene")
    assert not (tmp_path / "owned").exists()


def test_capture_comes_back_with_what_initializers_found(tmp_path: Path) -> None:
    capture = a_capture(tmp_path)
    mask = np.linspace(0, 1, 20, dtype=np.float32).reshape(4, 5)
    moved = np.diag([2.0, 2.0, 2.0, 1.0])
    found = replace(
        capture.transformed(moved),
        points=OrientedPoints(np.arange(6.0).reshape(2, 3)),
        light_frame="camera",
    )
    found = replace(found, views=(replace(found.views[0], mask=mask, exposure=1.5), found.views[2]), irradiance=CARD)
    save_capture(found, tmp_path)
    back = restore_capture(capture, tmp_path)
    assert [v.name for v in back.views] == ["v0", "v2"] and back.light_frame == "camera"
    assert [camera_document(v.camera) for v in back.views] == [camera_document(v.camera) for v in found.views]
    assert back.views[0].mask is not None and back.points is not None
    np.testing.assert_array_equal(back.views[0].mask, mask)
    np.testing.assert_array_equal(back.points.positions, np.arange(6.0).reshape(2, 3))
    np.testing.assert_array_equal(back.world_from_source, moved)
    assert back.views[0].exposure == 1.5 and back.irradiance == CARD


def test_the_card_turns_with_the_world(tmp_path: Path) -> None:
    turn = np.array([[0, -2.0, 0, 1], [2, 0, 0, 5], [0, 0, 2, 0], [0, 0, 0, 1]])
    moved = replace(a_capture(tmp_path), irradiance=CARD).transformed(turn)
    assert moved.irradiance is not None and moved.irradiance.values == CARD.values
    np.testing.assert_allclose(moved.irradiance.normal, [-1, 0, 0], atol=1e-12)
    assert fingerprint(moved) != fingerprint(replace(moved, irradiance=None))


@pytest.mark.parametrize(
    ("normal", "values"),
    [
        ((0.0, 2.0, 0.0), {"a": (1.0, 1.0, 1.0)}),
        ((0.0, 1.0, 0.0), {}),
        ((0.0, 1.0, 0.0), {"a": (1.0, 0.0, 1.0)}),
        ((0.0, 1.0, 0.0), {"a": (1.0, float("nan"), 1.0)}),
    ],
)
def test_an_impossible_card_is_refused(
    normal: tuple[float, float, float], values: dict[str, tuple[float, float, float]]
) -> None:
    with pytest.raises(ValueError, match="card"):
        MeasuredIrradiance(normal, values)


def test_the_mean_of_the_card_is_geometric() -> None:
    assert CARD.mean == pytest.approx((2, 2, 3)) and CARD.relative_deviation == pytest.approx(np.log(2))


def test_fingerprint_sees_what_a_fit_sees_and_nothing_else(tmp_path: Path) -> None:
    capture = a_capture(tmp_path)
    before = fingerprint(capture)
    (tmp_path / "reference.obj").write_text("the truth")
    assert fingerprint(a_capture(tmp_path)) == before
    assert fingerprint(replace(capture, views=capture.views[:2])) != before
    moved = replace(capture.views[0], camera=a_camera(0.100001))
    assert fingerprint(replace(capture, views=(moved, *capture.views[1:]))) != before
    labelled = replace(capture, views=(replace(capture.views[0], take="standing"), *capture.views[1:]))
    assert fingerprint(labelled) != before
    assert fingerprint(labelled) != fingerprint(
        replace(capture, views=(replace(capture.views[0], take="lying"), *capture.views[1:]))
    )
    (tmp_path / "1.png").write_bytes(b"other")
    assert fingerprint(capture) != before


def test_fingerprint_sees_masks_beside_photographs_and_points(tmp_path: Path) -> None:
    capture = a_capture(tmp_path)
    mask = tmp_path / "1_mask.png"
    mask.write_bytes(bytes([1]))
    views = list(capture.views)
    views[1] = replace(views[1], mask_path=mask)
    masked = replace(capture, views=tuple(views))
    before = fingerprint(masked)
    assert before != fingerprint(capture), "a photograph whose mask is a file is not one without a mask"
    mask.write_bytes(b"redrawn")
    after = fingerprint(masked)
    assert after != before
    mask.unlink()
    with pytest.raises(InputError, match=r"1_mask\.png cannot be read"):
        fingerprint(masked)
    cloud = OrientedPoints(np.zeros((2, 3)))
    assert len({fingerprint(replace(capture, points=p)) for p in (None, cloud, OrientedPoints(np.ones((2, 3))))}) == 3


def test_cameras_json_holds_every_photograph(tmp_path: Path) -> None:
    capture = a_capture(tmp_path)
    registered = replace(capture, views=capture.views[1:])
    write_cameras(tmp_path / "cameras.json", registered, [v.name for v in capture.views])
    cameras = read_cameras(tmp_path / "cameras.json")
    assert list(cameras) == ["v1", "v2"]
    assert camera_document(cameras["v2"]) == camera_document(capture.views[2].camera)


@pytest.mark.parametrize(
    "change", [{"K": [[1]]}, {"K": None}, {"width": "many"}, {"world_to_camera": [[float("nan")] * 4] * 4}]
)
def test_malformed_camera_is_an_error_that_names_the_file(change: dict[str, object]) -> None:
    document = camera_document(a_camera())
    assert document is not None
    with pytest.raises(InputError, match=r"cameras\.json"):
        camera_from_document(document | change, "cameras.json")


def test_working_frame_centres_the_object_and_there_and_back_is_the_identity() -> None:
    mesh = a_scene().mesh
    far = Scene(mesh.with_positions(mesh.positions * 0.06 + torch.tensor([10.0, -3.0, 2.0])))
    to_working = unit_similarity(far.mesh)
    moved = move_scene(far, to_working)
    low, high = moved.mesh.positions.amin(0), moved.mesh.positions.amax(0)
    assert (low + high).abs().max() < 1e-4
    assert moved.mesh.positions.norm(dim=1).max() == pytest.approx(1.0, abs=1e-4)
    back = move_scene(moved, np.linalg.inv(to_working))
    torch.testing.assert_close(back.mesh.positions, far.mesh.positions, rtol=0, atol=1e-6)


def test_cameras_see_the_same_pixels_after_the_move() -> None:
    """A pixel is where it was: depth is divided by the scale, the picture does not change."""
    mesh = a_scene().mesh
    to_working = unit_similarity(mesh)
    capture = Capture(Path(), (View("v", a_camera(), lambda: None),))  # type: ignore[arg-type,return-value]
    points = mesh.positions.numpy().astype(np.float64)
    before, _ = a_camera().project(points)
    camera = capture.transformed(to_working).cameras[0]
    after, _ = camera.project(points @ to_working[:3, :3].T + to_working[:3, 3])
    np.testing.assert_allclose(after, before, atol=1e-9)
    rotation = camera.world_to_camera[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)


def test_degenerate_first_mesh_is_an_error() -> None:
    topology = Topology(torch.tensor([[0, 1, 2]]))
    for positions in (torch.zeros(3, 3), torch.full((3, 3), float("nan"))):
        with pytest.raises(StageError, match="initializers"):
            unit_similarity(Mesh(positions, topology))
