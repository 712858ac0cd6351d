"""Takes of a capture: their names in transforms.json, and the folders that takes.toml lists."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.intake.reader_lookup import find_reader
from hir_core.plugins import NoOptions
from hir_core.plugins.manager import PluginManager
from hir_core.run.capture_store import fingerprint
from hir_plugins.readers.bundler import BundlerReader
from hir_plugins.readers.colmap_model import ColmapModelReader
from hir_plugins.readers.parsing.capture_paths import unique_names
from hir_plugins.readers.parsing.takes_file import MAX_BYTES, read_takes, with_takes
from hir_plugins.readers.parsing.upright import upright_rotation
from hir_plugins.readers.photos import PhotosReader
from hir_plugins.readers.transforms_json import TransformsJsonReader

TRANSFORMS, PHOTOS, COLMAP = (reader(NoOptions()) for reader in (TransformsJsonReader, PhotosReader, ColmapModelReader))
POSE = [[1, 0, 0, 0.0], [0, 0, -1, -4.0], [0, 1, 0, 1.0], [0, 0, 0, 1]]
TAKES = 'takes = ["standing", "upside_down"]\n'
UPRIGHT, TURNED_OVER = "1 0 0 0 0 0 5", "0 0 0 1 0 0 5"
"""Poses of COLMAP, as quaternion and translation: level, and upside down."""


def photo(path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.new("RGB", (64, 48), (80, 90, 100)).save(path)


def write_frames(folder: Path, takes: dict[str, Any], **content: Any) -> Path:
    """transforms.json with a frame for each photograph; a take that is `...` is left out."""
    frames = []
    for name, take in takes.items():
        photo(folder / "images" / f"{name}.png")
        frame = {"file_path": f"images/{name}.png", "transform_matrix": POSE}
        frames.append(frame if take is ... else frame | {"take": take})
    (folder / "transforms.json").write_text(json.dumps({"fl_x": 80.0, "frames": frames} | content))
    return folder


def write_folders(folder: Path, inside: str = "", text: str = TAKES) -> Path:
    """Two takes of two photographs of the same names, and takes.toml."""
    for take in ("standing", "upside_down"):
        for name in ("001", "002"):
            photo(folder / inside / take / f"{name}.jpg")
    (folder / "takes.toml").write_text(text)
    return folder


def write_model(folder: Path, poses: dict[str, str]) -> Path:
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("1 SIMPLE_PINHOLE 64 48 80 32 24\n")
    lines = [f"{i} {pose} 1 {name}\n\n" for i, (name, pose) in enumerate(poses.items(), 1)]
    (model / "images.txt").write_text("".join(lines))
    (model / "points3D.txt").write_text("1 0.5 -0.75 0 255 0 128 0.5 1 0\n")
    return folder


def labels(capture: Capture) -> dict[str, str]:
    return {view.name: view.take for view in capture.views}


def test_frames_name_their_take(tmp_path: Path) -> None:
    write_frames(tmp_path, {"a": "lying", "b": "standing", "c": "lying"}, test_filenames=["images/b.png"])
    frames = json.loads((tmp_path / "transforms.json").read_text())["frames"]
    write_frames(tmp_path, {"a": "lying", "b": "standing", "c": "lying"})
    capture = TRANSFORMS.read(tmp_path)
    assert labels(capture) == {"a": "lying", "b": "standing", "c": "lying"}
    assert capture.takes == ("lying", "standing") and capture.take_numbers == [0, 1, 0]
    for name, indices in (("transforms_train.json", (0, 2)), ("transforms_test.json", (1,))):
        (tmp_path / name).write_text(json.dumps({"fl_x": 80.0, "frames": [frames[i] for i in indices]}))
    assert labels(TRANSFORMS.read(tmp_path, "test")) == {"b": "standing"}


def test_lists_of_splits_keep_the_takes(tmp_path: Path) -> None:
    lists = {"train_filenames": ["images/a.png"], "val_filenames": ["images/b.png"]}
    write_frames(tmp_path, {"a": "lying", "b": "standing"}, **lists)
    assert labels(TRANSFORMS.read(tmp_path)) == {"a": "lying"}
    assert labels(TRANSFORMS.read(tmp_path, "val")) == {"b": "standing"}


def test_a_file_without_takes_is_one_take(tmp_path: Path) -> None:
    assert labels(TRANSFORMS.read(write_frames(tmp_path, {"a": ..., "b": None}))) == {"a": "", "b": ""}


@pytest.mark.parametrize("take", ["", "  ", 3, True, ["x"], {"x": 1}, "x" * 101, "a\nb", "a\x1b[0m"])
def test_what_is_no_name_of_a_take_is_refused(tmp_path: Path, take: object) -> None:
    with pytest.raises(CaptureError, match=r"transforms\.json, frame 1: the take .* is not a name; write") as caught:
        TRANSFORMS.read(write_frames(tmp_path, {"a": "lying", "b": take}))
    assert str(caught.value).isprintable() and len(str(caught.value)) < 400 + len(str(tmp_path))


def test_a_frame_without_take_among_others_is_refused(tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"transforms\.json, frame 1 has no 'take'"):
        TRANSFORMS.read(write_frames(tmp_path, {"a": "lying", "b": ..., "c": ...}))


def test_the_fingerprint_changes_with_the_take(tmp_path: Path) -> None:
    marks = {
        fingerprint(TRANSFORMS.read(write_frames(tmp_path, {"a": first, "b": second})))
        for first, second in ((..., ...), ("x", "x"), ("x", "y"), ("y", "x"))
    }
    assert len(marks) == 4


@pytest.mark.parametrize("inside", ["", "images"])
def test_folders_of_photographs_are_takes(tmp_path: Path, inside: str) -> None:
    write_folders(tmp_path, inside, 'takes = ["upside_down", "standing"]')
    capture = PHOTOS.read(tmp_path)
    assert capture.takes == ("upside_down", "standing"), "in the order of the file"
    stem = f"{inside}_" if inside else ""
    assert labels(capture) == {
        f"{stem}{take}_{name}": take for take in ("upside_down", "standing") for name in ("001", "002")
    }
    assert find_reader(tmp_path, PluginManager.discover())[0] == "photos"


def test_only_takes_toml_makes_folders_takes(tmp_path: Path) -> None:
    """A folder of captures of different objects is no capture."""
    write_folders(tmp_path)
    (tmp_path / "takes.toml").unlink()
    assert not PHOTOS.matches(tmp_path)
    with pytest.raises(CaptureError, match=r"takes\.toml"):
        find_reader(tmp_path, PluginManager.discover())


def test_cameras_of_another_program_come_before_folders(tmp_path: Path) -> None:
    write_folders(tmp_path, "images")
    (tmp_path / "transforms.json").write_text("{}")
    assert not PHOTOS.matches(tmp_path)


@pytest.mark.parametrize("masks", ["{take}/masks/{name}.png", "masks/{take}/{name}.jpg.png", "{take}_mask/{name}.png"])
def test_masks_of_takes(tmp_path: Path, masks: str) -> None:
    write_folders(tmp_path)
    for take in ("standing", "upside_down"):
        for name in ("001", "002"):
            photo(tmp_path / masks.format(take=take, name=name))
    for view in PHOTOS.read(tmp_path).views:
        take, _, name = view.name.rpartition("_")
        assert view.mask_path == tmp_path / masks.format(take=take, name=name)


def test_masks_that_may_belong_to_two_takes_are_refused(tmp_path: Path) -> None:
    write_folders(tmp_path)
    for name in ("001", "002"):
        photo(tmp_path / "masks" / f"{name}.png")
    with pytest.raises(CaptureError, match=r"001\.png belongs to photographs of two takes, .* masks/upside_down"):
        PHOTOS.read(tmp_path)


@pytest.mark.filterwarnings("ignore:.* masks belong to a photograph")
def test_photographs_of_no_take_are_named(tmp_path: Path) -> None:
    write_folders(tmp_path)
    for name in ("x.png", "third/1.png", "masks/other.png", "standing_mask/other.png"):
        photo(tmp_path / name)
    with pytest.warns(UserWarning, match=r"2 photographs lie in no folder .* such as .*x\.png"):
        assert len(PHOTOS.read(tmp_path).views) == 4


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("takes = [", "is not valid TOML"),
        ("takes = 3", "does not list two takes"),
        ('takes = ["standing"]', "does not list two takes"),
        ("", "does not list two takes"),
        (TAKES + "order = 3", "the key 'order' is unknown"),
        ('takes = ["standing", "standing"]', "the take 'standing' twice"),
        ('takes = ["standing", 3]', "the take of type int is not a name"),
        ('takes = ["standing", ""]', "the take '' is not a name"),
        ('takes = ["standing", "../other"]', "is not the name of a folder"),
        ('takes = ["standing", ".."]', "is not the name of a folder"),
        ('takes = ["standing", "/etc"]', "is not the name of a folder"),
        ("takes = ['standing', 'C:\\x']", "is not the name of a folder"),
        ('takes = ["standing", "lying"]', "the take 'lying', which is not a folder"),
        ('takes = ["sitting", "lying"]', "the take 'sitting', which is not a folder"),
        ('takes = ["standing", "empty"]', "the take 'empty', whose folder holds no photograph"),
        ("takes = " + 2000 * "[", "is not valid TOML"),
        (f"takes = {[str(i) for i in range(101)]}", "lists 101 takes; list at most 100"),
        ("#" * MAX_BYTES + TAKES, "is larger than"),
        ("a" + ".a" * 20_000 + " = 1", "has more than 1000 dots"),
    ],
)
def test_a_broken_list_is_one_clear_error(tmp_path: Path, text: str, says: str) -> None:
    write_folders(tmp_path, text=text)
    (tmp_path / "empty").mkdir()
    assert PHOTOS.matches(tmp_path), "the message is that of the list"
    with pytest.raises(CaptureError, match=says) as caught:
        PHOTOS.read(tmp_path)
    assert "takes.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_bytes_that_are_no_text_are_refused(tmp_path: Path) -> None:
    write_folders(tmp_path)
    (tmp_path / "takes.toml").write_bytes(b'takes = ["\xff", "b"]')
    with pytest.raises(CaptureError, match="is not valid TOML"):
        read_takes(tmp_path)


def test_a_take_outside_the_capture_is_refused(tmp_path: Path) -> None:
    for name in ("1", "2"):
        photo(tmp_path / "outside" / f"{name}.png")
    write_folders(tmp_path / "capture", text='takes = ["standing", "link"]')
    (tmp_path / "capture" / "link").symlink_to(tmp_path / "outside")
    with pytest.raises(CaptureError, match="leads out"):
        PHOTOS.read(tmp_path / "capture")


def test_a_colmap_model_of_takes(tmp_path: Path) -> None:
    """Takes come from the folders, in the order of takes.toml; the world is upright for the first one."""
    write_folders(tmp_path, "images")
    names = {"upside_down/001.jpg": TURNED_OVER, "upside_down/002.jpg": TURNED_OVER, "standing/001.jpg": UPRIGHT}
    capture = COLMAP.read(write_model(tmp_path, names))
    assert labels(capture) == {
        "standing_001": "standing", "upside_down_001": "upside_down", "upside_down_002": "upside_down"
    }  # fmt: skip
    assert capture.takes == ("standing", "upside_down")
    ups = [camera.world_to_camera[:3, :3].T @ [0, -1, 0] for camera in capture.cameras]
    np.testing.assert_allclose(ups, [[0, 1, 0], [0, -1, 0], [0, -1, 0]], atol=1e-9)
    # all cameras together would have another one
    poses = [camera.world_to_camera for camera in capture.cameras]
    assert (upright_rotation(poses)[:3, :3] @ [0, 1, 0])[1] < 0.5


def test_a_colmap_model_whose_photographs_lie_in_no_take_is_refused(tmp_path: Path) -> None:
    write_folders(tmp_path, "images", 'takes = ["sitting", "lying"]')
    with pytest.raises(CaptureError, match=r"standing/001\.jpg lies in no folder of the takes sitting, lying"):
        COLMAP.read(write_model(tmp_path, {"standing/001.jpg": UPRIGHT}))


def test_a_take_that_was_not_aligned_is_named(tmp_path: Path) -> None:
    write_folders(tmp_path, "images")
    with pytest.warns(UserWarning, match="the take 'upside_down', of which no photograph has a camera"):
        capture = COLMAP.read(write_model(tmp_path, {"standing/001.jpg": UPRIGHT, "standing/002.jpg": UPRIGHT}))
    assert capture.takes == ("standing",)


def test_frames_without_takes_follow_the_list(tmp_path: Path) -> None:
    write_folders(tmp_path, "images")
    frames = [
        {"file_path": f"images/{take}/{name}.jpg", "transform_matrix": POSE}
        for take in ("upside_down", "standing")
        for name in ("001", "002")
    ]
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 80.0, "frames": frames}))
    assert TRANSFORMS.read(tmp_path).take_numbers == [0, 0, 1, 1]
    (tmp_path / "transforms_test.json").write_text(json.dumps({"fl_x": 80.0, "frames": frames[:1]}))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # a split need not have all takes
        assert labels(TRANSFORMS.read(tmp_path, "test")) == {"001": "upside_down"}


def test_scanning_programs_have_takes(tmp_path: Path) -> None:
    write_folders(tmp_path)
    (tmp_path / "list.txt").write_text("standing/001.jpg\nupside_down/001.jpg\n")
    camera = "80 0 0\n1 0 0\n0 1 0\n0 0 1\n0 0 -5\n"
    (tmp_path / "bundle.out").write_text(f"# Bundle file v0.3\n2 0\n{camera}{camera}")
    assert labels(BundlerReader(NoOptions()).read(tmp_path)) == {
        "standing_001": "standing",
        "upside_down_001": "upside_down",
    }


def test_views_without_a_list_stay_as_they_are(tmp_path: Path) -> None:
    views = TRANSFORMS.read(write_frames(tmp_path, {"a": ...})).views
    assert with_takes(views, tmp_path) == views


def test_names_of_photographs_are_unique(tmp_path: Path) -> None:
    files = [tmp_path / name for name in ("a/1.jpg", "a/1.png", "b/1.jpg")]
    assert unique_names(files, tmp_path) == ["a_1.jpg", "a_1.png", "b_1.jpg"]
    assert unique_names([files[0], files[0]], tmp_path) == ["a_1", "a_1"], "one file that is listed twice"
    with pytest.raises(CaptureError, match="two photographs would have one name"):
        unique_names([tmp_path / "a_b" / "1.jpg", tmp_path / "a" / "b_1.jpg", tmp_path / "1.jpg"], tmp_path)
