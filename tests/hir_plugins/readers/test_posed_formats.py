"""Formats of cameras that others made: in each, a known point lands on the one bright pixel."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.interfaces import CaptureReader
from hir_plugins.readers.blended_mvs import BlendedMvsReader
from hir_plugins.readers.idr_cameras import IdrCamerasReader
from hir_plugins.readers.llff import LlffReader
from hir_plugins.readers.middlebury import MiddleburyReader
from hir_plugins.readers.parsing.pose_files import decompose_projection, load_arrays

# a camera at (0, 0, -5) in OpenCV axes, and a point that it sees at the centre of pixel (40, 12): 40.5, 12.5
K = np.array([[80.0, 0, 32], [0, 80, 24], [0, 0, 1]])
POSE = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]])
POINT = np.array([8.5 / 16, -11.5 / 16, 0.0, 1.0])


def check(capture: Capture) -> None:
    view = capture.views[0]
    assert view.camera is not None
    world = (capture.world_from_source @ POINT)[:3]
    pixel, depth = view.camera.project(world[None])
    np.testing.assert_allclose(pixel, [[40.5, 12.5]], atol=1e-6)
    assert depth[0] > 0
    assert np.argwhere(view.pixels().color_linear[..., 0] > 0.5).tolist() == [[12, 40]]
    # the camera stood level, so its up is the world's
    np.testing.assert_allclose(view.camera.world_to_camera[:3, :3] @ [0, 1, 0], [0, -1, 0], atol=1e-9)


def idr(folder: Path) -> CaptureReader:
    scale = np.diag([2.0, 2, 2, 1])
    scale[:3, 3] = [0.3, 0, 0]
    world = np.eye(4)
    world[:3] = -3.0 * K @ POSE[:3]  # neither scale nor sign of a projection means anything
    np.savez(folder / "cameras.npz", world_mat_0=world, scale_mat_0=scale)
    return IdrCamerasReader(NoOptions())


def llff(folder: Path) -> CaptureReader:
    # columns: down, right, backwards, place, (height, width, focal)
    matrix = np.array([[0, 1, 0, 0, 48], [1, 0, 0, 0, 64], [0, 0, -1, -5, 80.0]])
    np.save(folder / "poses_bounds.npy", np.concatenate([matrix.reshape(-1), [1, 9]])[None])
    return LlffReader(NoOptions())


def middlebury(folder: Path) -> CaptureReader:
    numbers = np.concatenate([K.reshape(-1), POSE[:3, :3].reshape(-1), POSE[:3, 3]])
    (folder / "x_par.txt").write_text("1\nimages/a.png " + " ".join(map(str, numbers)) + "\n")
    return MiddleburyReader(NoOptions())


def blended(folder: Path) -> CaptureReader:
    (folder / "cams").mkdir()
    shifted = K.copy()
    shifted[:2, 2] -= 0.5
    rows = lambda m: "\n".join(" ".join(map(str, r)) for r in m)  # noqa: E731
    text = f"extrinsic\n{rows(POSE)}\n\nintrinsic\n{rows(shifted)}\n\n1 0.1 128 9\n"
    (folder / "cams" / "a_cam.txt").write_text(text)
    return BlendedMvsReader(NoOptions())


FORMATS = {"idr": idr, "llff": llff, "middlebury": middlebury, "blended": blended}


@pytest.mark.parametrize("name", FORMATS)
def test_a_point_lands_on_its_pixel(picture: Path, name: str) -> None:
    reader = FORMATS[name](picture)
    assert reader.matches(picture) and reader.splits(picture) == ["train"]
    check(reader.read(picture))
    with pytest.raises(CaptureError, match="'test'"):
        reader.read(picture, "test")


def test_masks_of_dtu_are_matched_by_number_and_it_says_so(picture: Path) -> None:
    """`mask/000.png` beside `image/000000.png`."""
    reader = idr(picture)
    (picture / "images").rename(picture / "image")
    (picture / "image" / "a.png").rename(picture / "image" / "000000.png")
    (picture / "mask").mkdir()
    shutil.copy(picture / "image" / "000000.png", picture / "mask" / "000.png")
    with pytest.warns(UserWarning, match=r"1 masks are matched by number, such as 000.png with 000000.png; if that is"):
        view = reader.read(picture).views[0]
    assert view.mask_path == picture / "mask" / "000.png"


def test_the_unit_ball_of_idr_is_the_unit_ball(picture: Path) -> None:
    capture = idr(picture).read(picture)
    # the ball of radius 2 around (0.3, 0, 0)
    np.testing.assert_allclose((capture.world_from_source @ [0.3, 0, 0, 1])[:3], 0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm((capture.world_from_source @ [0.3, 2, 0, 1])[:3]), 1)


@pytest.mark.parametrize("name", FORMATS)
def test_another_number_of_images_or_none(picture: Path, name: str) -> None:
    reader = FORMATS[name](picture)
    if name in ("idr", "llff"):
        shutil.copy(picture / "images" / "a.png", picture / "images" / "b.png")
        with pytest.raises(CaptureError, match="one each"):
            reader.read(picture)
    shutil.rmtree(picture / "images")
    with pytest.raises(CaptureError):
        reader.read(picture)


def test_pickles_and_nans_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    np.save(tmp_path / "b.npy", np.array([np.nan]))
    (tmp_path / "c.npz").write_bytes(b"PK\x03\x04")
    (tmp_path / "d.npy").write_bytes(b"")
    for name in ("a.npy", "b.npy", "c.npz", "d.npy", "missing.npy"):
        with pytest.raises(CaptureError, match=name):
            load_arrays(tmp_path / name)


@pytest.mark.parametrize("seed", range(4))
def test_projections_are_decomposed_into_their_factors(seed: int) -> None:
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.sign(np.linalg.det(rotation))
    k = np.array([[90, 1.5, 30], [0, 70, 20], [0, 0, 1.0]])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation, rng.normal(size=3)
    found_k, found_pose = decompose_projection(rng.normal() * k @ pose[:3], "x")
    np.testing.assert_allclose(found_k, k, atol=1e-9)
    np.testing.assert_allclose(found_pose, pose, atol=1e-9)


def test_a_flat_projection_is_an_error() -> None:
    with pytest.raises(CaptureError, match="no camera"):
        decompose_projection(np.ones((3, 4)), "x")


def test_the_tankard_in_llff_agrees_with_its_opencv_cameras(shared: Path) -> None:
    import json

    folder = shared / "photos" / "tankard"
    capture = LlffReader(NoOptions()).read(folder)
    known = json.loads((folder / "cameras_opencv.json").read_text())["views"]
    assert len(capture.views) == len(known) == 69
    for view, row in zip(capture.views, known, strict=True):
        assert view.camera is not None and Path(row["image"]).stem == view.name
        found = view.camera.world_to_camera @ capture.world_from_source
        # SVD of a file in float32
        np.testing.assert_allclose(found[:3], np.array(row["world_to_cam"])[:3], atol=2e-3)
        np.testing.assert_allclose(view.camera.intrinsics, row["K"], rtol=1e-3)
    mask = capture.views[0].pixels().mask
    assert mask is not None and 0.02 < mask.mean() < 0.9


@pytest.mark.slow
def test_the_command_line_says_which_masks_were_matched_by_number(tmp_path: Path) -> None:
    """Python's warnings are off there: without being forwarded the sentence would be lost."""
    import subprocess
    import sys

    from hir_core.testing.captures import tiny_capture
    from hir_plugins.readers.contract_inputs import idr_cameras

    folder = idr_cameras(tiny_capture(tmp_path / "truth", views=6, size=32).capture, tmp_path / "scan")
    for kind, digits in (("image", 6), ("mask", 3)):
        for i, file in enumerate(sorted((folder / kind).iterdir())):
            file.rename(file.with_name(f"{i:0{digits}d}.png"))
    command = [sys.executable, "-m", "hir_core.cli"]
    check = subprocess.run([*command, "check", str(folder)], capture_output=True, text=True, check=True)
    assert "6 masks are matched by number, such as 000.png with 000000.png" in " ".join(check.stdout.split())
    run = [*command, "reconstruct", str(folder), "-o", str(tmp_path / "run"), "--until", "initializer"]
    settings = ["--set", "initializer.visual_hull.max_resolution=32"]
    started = subprocess.run([*run, *settings], capture_output=True, text=True, check=True)
    assert "warning: 6 masks are matched by number" in " ".join(started.stderr.split())
