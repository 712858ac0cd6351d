"""Mask sources: what belongs to which photograph, and what is background."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import srgb_to_linear
from PIL import Image

from hir_core.capture import Capture, OrientedPoints, View
from hir_core.config import load_config
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_core.plugins.manager import PluginManager
from hir_core.stages.initialization import hashes_of_files_read
from hir_plugins.masks.alpha import Alpha
from hir_plugins.masks.color_key import ColorKey
from hir_plugins.masks.folder import Folder
from hir_plugins.masks.grabcut import GrabCut
from hir_plugins.masks.object_region import consistent_points, draw_discs
from hir_plugins.masks.options import ColorKeyOptions, FolderOptions, GrabCutOptions
from hir_plugins.readers.parsing.decoding.photo_file import PhotoFile
from hir_plugins.readers.parsing.mask_files import find_mask, match_mask
from tests.fixtures.silhouette_captures import StoredPixels, coverage, dome, hits_sphere, look_at, make_view


@pytest.mark.parametrize(
    ("photo", "mask"),
    [
        ("a.jpg", "a.png"),
        ("IMG_9669.JPG", "IMG_9669.png"),
        ("a.jpg", "a.jpg.png"),
        ("a.jpg", "A_Mask.PNG"),
        ("a.jpg", "mask-a.png"),
        ("DSC1.jpeg", "dsc1.tif"),
        ("r_0.png", "r_0.png"),
        ("000007.png", "007.png"),
        ("000007.png", "7_mask.png"),
    ],
)
def test_names_match_tolerantly(photo: str, mask: str) -> None:
    masks = [Path("masks") / mask, Path("masks/other.png"), Path("masks/a10.png"), Path("masks/notes.txt")]
    assert match_mask(Path("images") / photo, masks) == masks[0]
    assert match_mask(Path("images/b.jpg"), masks) is None


def test_a_number_that_two_masks_have_matches_none() -> None:
    masks = [Path("masks/007.png"), Path("masks/07.png")]
    assert match_mask(Path("images/000007.png"), masks) is None
    assert match_mask(Path("images/007.png"), masks) == masks[0]


def capture_with(folder: Path, masks: dict[str, np.ndarray]) -> Capture:
    (folder / "images").mkdir()
    (folder / "masks").mkdir()
    views = []
    for name in ("a", "b"):
        path = folder / "images" / f"{name}.jpg"
        Image.new("RGB", (32, 24), (90, 90, 90)).save(path)
        views.append(View(name, None, PhotoFile(path), path=path))
    for name, mask in masks.items():
        Image.fromarray(mask).save(folder / "masks" / name)
    return Capture(folder, tuple(views))


def test_a_folder_of_masks_stays_soft_and_names_what_is_missing(tmp_path: Path) -> None:
    ramp = np.broadcast_to(np.arange(32, dtype=np.uint8) * 8, (24, 32)).copy()
    capture = capture_with(tmp_path, {"a.png": ramp})
    with pytest.warns(UserWarning, match="1 of 2 photographs have no mask, such as b"):
        masks = Folder(FolderOptions()).masks(capture, None)
    assert masks[0] is not None and masks[1] is None
    np.testing.assert_allclose(masks[0], ramp / 255, atol=1e-6)
    with pytest.warns(UserWarning):
        inverted = Folder(FolderOptions(path="masks", inverted=True)).masks(capture, None)[0]
    assert inverted is not None
    np.testing.assert_allclose(inverted, 1 - ramp / 255, atol=1e-6)


def test_masks_that_no_reader_found_are_watched(tmp_path: Path) -> None:
    capture = capture_with(tmp_path, {"a.png": np.zeros((24, 32), np.uint8), "b.png": np.zeros((24, 32), np.uint8)})
    plugins = PluginManager.discover()

    def hashes(capture: Capture, *assignments: str) -> list[str]:
        config = load_config(plugins, assignments=assignments)
        return hashes_of_files_read(capture, replace(config, initializers=()), plugins)

    before = hashes(capture)
    assert len(before) == 2
    Image.fromarray(np.full((24, 32), 255, np.uint8)).save(tmp_path / "masks" / "b.png")
    assert [a == b for a, b in zip(before, hashes(capture), strict=True)] == [True, False]
    assert hashes(capture, "mask_source.folder.path=masks") == hashes(capture)
    assert hashes(capture, 'masks=["alpha"]') == []
    known = tuple(replace(view, mask_path=tmp_path / "masks" / f"{view.name}.png") for view in capture.views)
    assert hashes(replace(capture, views=known)) == [], "the capture's own fingerprint holds them"


def test_folders_that_do_not_fit_are_errors(tmp_path: Path) -> None:
    capture = capture_with(tmp_path, {"zzz.png": np.zeros((24, 32), np.uint8)})
    assert Folder(FolderOptions()).masks(capture, None) == [None, None]
    for path, says in (("masks", "the name of a photograph"), ("nowhere", "not a folder"), ("..", "leads out")):
        with pytest.raises(CaptureError, match=says):
            Folder(FolderOptions(path=path)).masks(capture, None)
    Image.new("L", (30, 24)).save(tmp_path / "masks" / "a.png")
    with pytest.warns(UserWarning), pytest.raises(CaptureError, match="30×24"):
        Folder(FolderOptions()).masks(capture, None)


def test_masks_of_distorted_photographs_are_straightened_with_them(tmp_path: Path) -> None:
    block = np.zeros((24, 32), np.uint8)
    block[4:20, 24:30] = 255
    capture = capture_with(tmp_path, {"a.png": block, "b.png": block})
    camera = look_at(np.array([0, 0, 3.0]), np.zeros(3), 20.0, 32, 24)
    views = tuple(replace(v, camera=camera, distortion=(-0.2, 0.0, 0.0, 0.0)) for v in capture.views)
    mask = Folder(FolderOptions()).masks(replace(capture, views=views), None)[0]
    find_mask = replace(views[0], read=PhotoFile(views[0].path, tmp_path / "masks" / "a.png")).pixels().mask  # type: ignore[arg-type]
    assert mask is not None and find_mask is not None
    np.testing.assert_allclose(mask, find_mask, atol=1e-6)
    assert np.abs(mask - block / 255).max() > 0.3


def test_alpha_gives_what_the_file_has(tmp_path: Path) -> None:
    rgba = np.zeros((8, 8, 4), np.uint8)
    rgba[2:5, 3:6, 3] = 200
    Image.fromarray(rgba).save(tmp_path / "a.png")
    view = View("a", None, PhotoFile(tmp_path / "a.png"))
    mask = Alpha(NoOptions()).masks(Capture(tmp_path, (view,)), None)[0]
    assert mask is not None
    np.testing.assert_allclose(mask, rgba[..., 3] / 255, atol=1e-6)


@pytest.mark.parametrize("background", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (0.1, 0.3, 0.8)])
def test_a_key_finds_the_disk_and_keeps_its_holes_closed(background: tuple[float, ...]) -> None:
    camera = look_at(np.array([0, 0, 4.0]), np.zeros(3), 100.0, 64, 64)
    disk, hole = (coverage(camera, hits_sphere(np.zeros(3), r))[..., None] for r in (0.8, 0.2))
    back = srgb_to_linear(np.array(background))
    # a disk of another colour, with a spot of the background's colour in its middle
    color = (0.3, 0.12, 0.05) * (disk - hole) + back * (1 - disk + hole)
    view = make_view("a", camera, disk[..., 0], color.astype(np.float32))
    mask = ColorKey(ColorKeyOptions()).masks(Capture(Path("x"), (view,)), None)[0]
    assert mask is not None
    assert ((mask > 0.5) != (disk[..., 0] > 0.5)).mean() < 0.01
    assert mask[32, 32] == 1 and mask[0, 0] == 0


def test_each_take_has_its_own_background_colour() -> None:
    camera = look_at(np.array([0, 0, 4.0]), np.zeros(3), 100.0, 64, 64)
    disk = coverage(camera, hits_sphere(np.zeros(3), 0.6))
    views = []
    for i, background in enumerate([[0.8, 0.8, 0.8], [0.8, 0.8, 0.8], [0.5, 0.3, 0.1]]):
        color = np.where(disk[..., None] > 0.5, [0.1, 0.2, 0.6], background).astype(np.float32)
        views.append(replace(make_view(f"{i}", camera, np.zeros_like(disk), color), take=f"light {i // 2}"))
    for mask in ColorKey(ColorKeyOptions()).masks(Capture(Path("x"), tuple(views)), None):
        assert mask is not None
        assert ((mask > 0.5) != (disk > 0.5)).mean() < 0.01
    one_take = Capture(Path("x"), tuple(replace(view, take="") for view in views))
    with pytest.raises(CaptureError, match="several colours"):
        ColorKey(ColorKeyOptions()).masks(one_take, None)


def test_a_wild_border_is_an_error() -> None:
    color = np.random.default_rng(0).uniform(size=(32, 32, 3)).astype(np.float32)
    camera = look_at(np.array([0, 0, 4.0]), np.zeros(3), 100.0, 32, 32)
    view = make_view("a", camera, np.zeros((32, 32), np.float32), color)
    with pytest.raises(CaptureError, match="several colours"):
        ColorKey(ColorKeyOptions()).masks(Capture(Path("x"), (view,)), None)


def test_stanford_orb_keeps_masks_beside_each_split(tmp_path: Path) -> None:
    for folder in ("train", "train_mask", "test_mask"):
        (tmp_path / folder).mkdir()
    Image.new("RGB", (8, 8)).save(tmp_path / "train" / "0001.png")
    Image.new("L", (8, 8), 255).save(tmp_path / "train_mask" / "0001.png")
    Image.new("L", (8, 8), 0).save(tmp_path / "test_mask" / "0001.png")
    assert find_mask(tmp_path / "train" / "0001.png", tmp_path) == tmp_path / "train_mask" / "0001.png"


def test_the_surface_of_agreed_points_covers_what_all_of_them_cover() -> None:
    """Points inside are behind those at the surface: the silhouettes need no disc for them."""
    cameras = dome(6, 3.0, np.zeros(3), 130.0, 96)
    masks = [coverage(camera, hits_sphere(np.zeros(3), 0.5), samples=1) > 0.5 for camera in cameras]
    surface, reach = consistent_points(masks, cameras, np.zeros(3), 1.2, 0.8)
    radii = np.linalg.norm(surface, axis=1)
    assert radii.min() > 0.4 and radii.max() < 0.65, "a shell, as thick as few views leave the hull of a ball"
    inside = np.random.default_rng(0).uniform(-0.3, 0.3, (2000, 3))
    for camera, mask in zip(cameras, masks, strict=True):
        drawn = draw_discs(surface, camera, reach)
        assert not (draw_discs(inside, camera, reach) & ~drawn).any(), "no hole in the middle"
        assert (mask & ~drawn).sum() < 0.02 * mask.sum() and (drawn & ~mask).sum() < 0.25 * mask.sum()
    nothing, _ = consistent_points([~mask & False for mask in masks], cameras, np.zeros(3), 1.2, 0.8)
    assert nothing.shape == (0, 3) and not draw_discs(nothing, cameras[0], reach).any()


def test_grabcut_without_points_names_what_has_no_mask() -> None:
    views = [
        make_view(f"p{i}", camera, np.ones((16, 16))) for i, camera in enumerate(dome(3, 3.0, np.zeros(3), 20, 16))
    ]
    views[1] = replace(views[1], read=StoredPixels(replace(views[1].read(), mask=None)))
    with pytest.raises(CaptureError, match="there are 0 \\(1 of 3 photographs have no mask, such as p1\\)"):
        GrabCut(GrabCutOptions()).masks(Capture(Path("made-in-memory"), tuple(views)), None)


@pytest.mark.slow
def test_grabcut_finds_a_ball_before_a_room() -> None:
    """A ball of one colour range before noise of another; its points are known, as a reconstruction would give them."""
    rng = np.random.default_rng(0)
    ball = hits_sphere(np.zeros(3), 0.5)
    views = []
    for i, camera in enumerate(dome(8, 3.0, np.zeros(3), 130.0, 96)):
        mask = coverage(camera, ball, samples=2)[..., None]
        front = np.array([0.5, 0.35, 0.2]) * rng.uniform(0.7, 1.0, (96, 96, 1))
        back = np.array([0.03, 0.05, 0.09]) * rng.uniform(0.2, 1.5, (96, 96, 1))
        color = (front * mask + back * (1 - mask)).astype(np.float32)
        view = make_view(f"{i}", camera, mask[..., 0], color)
        views.append(replace(view, read=StoredPixels(replace(view.read(), mask=None))))
    normals = rng.normal(size=(400, 3))
    points = 0.5 * normals / np.linalg.norm(normals, axis=1, keepdims=True)
    room = rng.uniform(-9, 9, (60, 3))
    cloud = OrientedPoints(np.concatenate([points, room]))
    capture = Capture(Path("made-in-memory"), tuple(views), points=cloud)
    masks = GrabCut(GrabCutOptions(max_image_size=96)).masks(capture, None)
    for view, mask in zip(views, masks, strict=True):
        assert mask is not None and view.camera is not None
        true = coverage(view.camera, ball, samples=2) > 0.5
        # all along the outline, 2π · 130 · 0.5 / 2.96 pixels, less than a pixel and a half off
        assert ((mask > 0.5) != true).sum() < 1.5 * 138
    with pytest.raises(CaptureError, match="points"):
        GrabCut(GrabCutOptions()).masks(replace(capture, points=None), None)
