"""Plain folders of photographs, and what their cameras wrote about themselves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hir_core.capture.exif import camera_record
from hir_core.errors import CaptureError
from hir_core.plugins import NoOptions
from hir_plugins.readers.photos import PhotosReader

READER = PhotosReader(NoOptions())


def photo(path: Path, size: tuple[int, int] = (32, 24), orientation: int = 1, **tags: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    image = Image.new("RGB", size, (80, 90, 100))
    exif = image.getexif()
    exif[0x0112] = orientation
    if tags:
        exif[0x0110] = "Camera"
        exif.get_ifd(0x8769).update({int(k[1:], 16): v for k, v in tags.items()})
    image.save(path, exif=exif)


def test_a_folder_of_photographs(tmp_path: Path) -> None:
    assert not READER.matches(tmp_path)
    photo(tmp_path / "images" / "b.jpg")
    assert not READER.matches(tmp_path)
    photo(tmp_path / "images" / "a.JPG", orientation=6)
    (tmp_path / "images" / "notes.txt").write_text("x")
    assert READER.matches(tmp_path)
    capture = READER.read(tmp_path)
    assert [v.name for v in capture.views] == ["a", "b"] and capture.views[0].camera is None
    # lying on its side in the file, upright for us
    assert capture.views[0].pixels().color_linear.shape == (32, 24, 3)
    assert capture.views[1].pixels().color_linear.shape == (24, 32, 3)


def test_a_texture_of_a_scan_is_no_photograph(tmp_path: Path) -> None:
    for name in ("a.jpg", "b.jpg", "scan_tex.png", "._a.jpg"):
        photo(tmp_path / name) if name[0] != "." else (tmp_path / name).write_bytes(b"\0\5")
    (tmp_path / "scan.obj").write_text(
        "mtllib scan.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl m\nf 1/1 2/2 3/3\n"
    )
    (tmp_path / "scan.mtl").write_text("newmtl m\nmap_Kd scan_tex.png\n")
    with pytest.warns(
        UserWarning, match="1 pictures are textures of a mesh .* such as scan_tex.png; they are left out"
    ):
        capture = READER.read(tmp_path)
    assert [view.name for view in capture.views] == ["a", "b"]
    (tmp_path / "scan.obj").write_bytes(b"f " + b"1 " * 20_000)  # whoever reads the mesh says so
    assert len(READER.read(tmp_path).views) == 3


def test_a_folder_with_cameras_belongs_to_another_reader(tmp_path: Path) -> None:
    for name in "ab":
        photo(tmp_path / f"{name}.jpg")
    assert READER.matches(tmp_path)
    (tmp_path / "transforms.json").write_text("{}")
    assert not READER.matches(tmp_path)


@pytest.mark.parametrize(
    ("name", "words"), [("sfm.abc", r"sfm\.abc is not read; export .*cameras\.sfm"), ("doc.xml", "doc.xml is empty")]
)
def test_cameras_that_are_not_read_are_named(tmp_path: Path, name: str, words: str) -> None:
    for photo_name in "ab":
        photo(tmp_path / "images" / f"{photo_name}.jpg")
    (tmp_path / name).touch()
    with pytest.warns(UserWarning, match=words):
        READER.read(tmp_path)


def test_another_size_is_named(tmp_path: Path) -> None:
    for name in "abc":
        photo(tmp_path / f"{name}.jpg")
    photo(tmp_path / "d.jpg", size=(24, 32))
    photo(tmp_path / "e.jpg", size=(40, 24))
    with pytest.warns(UserWarning, match=r"1 of 5 photographs .* such as e\.jpg"):
        assert len(READER.read(tmp_path).views) == 5


def test_links_out_of_the_folder_are_refused(tmp_path: Path) -> None:
    photo(tmp_path / "outside.jpg")
    photo(tmp_path / "capture" / "a.jpg")
    (tmp_path / "capture" / "b.jpg").symlink_to(tmp_path / "outside.jpg")
    with pytest.raises(CaptureError, match="leads out"):
        READER.read(tmp_path / "capture")


def test_masks_beside_the_folder(tmp_path: Path) -> None:
    for name in ("IMG_1", "IMG_2"):
        photo(tmp_path / "image" / f"{name}.jpg")
    Image.new("L", (32, 24), 255).save(tmp_path / "image" / "x.png")
    (tmp_path / "image" / "x.png").unlink()
    (tmp_path / "mask").mkdir()
    Image.new("L", (32, 24), 255).save(tmp_path / "mask" / "IMG_1.png")
    masks = [v.pixels().mask for v in READER.read(tmp_path).views]
    assert masks[0] is not None and masks[0].all() and masks[1] is None


def test_the_focal_length_of_the_record(tmp_path: Path) -> None:
    # 55 mm before a sensor of 4272 pixels at 4720.44 an inch: 22.987 mm
    photo(tmp_path / "a.jpg", x920A=55.0, xA002=4272, xA20E=4720.441988950276, xA210=2)
    np.testing.assert_allclose(camera_record(tmp_path / "a.jpg").focal_over_width, 55 / 22.9869, rtol=1e-4)
    photo(tmp_path / "b.jpg", xA405=27, x9209=25)
    record = camera_record(tmp_path / "b.jpg")
    assert (record.focal_over_width, record.flash, record.model) == (0.75, True, "Camera")
    photo(tmp_path / "c.jpg")
    assert camera_record(tmp_path / "c.jpg").focal_over_width == 0
    (tmp_path / "d.jpg").write_bytes(b"no picture")
    assert camera_record(tmp_path / "d.jpg").flash is None


def test_real_photographs(shared: Path) -> None:
    skull = READER.read(shared / "photos" / "skull")
    assert len(skull.views) == 66
    record = camera_record(skull.views[0].path)  # type: ignore[arg-type]
    # the solved focal length is 3230 pixels of 1424
    np.testing.assert_allclose(record.focal_over_width * 1424, 3230, rtol=0.06)
    assert record.flash
    tankard = READER.read(shared / "photos" / "tankard")
    assert len(tankard.views) == 69 and all(v.read.mask_path for v in tankard.views)  # type: ignore[attr-defined]


def test_a_mask_of_no_photograph_is_named(tmp_path: Path) -> None:
    for name in "ab":
        photo(tmp_path / "images" / f"{name}.jpg")
        photo(tmp_path / "masks" / f"{name}.png")
    photo(tmp_path / "masks" / "c.png")
    with pytest.warns(UserWarning, match=r"1 masks belong to no photograph, such as .*c\.png"):
        assert all(view.mask_path is not None for view in READER.read(tmp_path).views)
