"""Cameras of scanning programs: a known point lands on the one bright pixel, through the formulas of their manuals."""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.errors import CaptureError
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.manager import PluginManager

PLUGINS = PluginManager.discover()
WIDTH, HEIGHT, FOCAL = 64, 48, 80.0
OFFSET = np.array([2.5, -1.75])
"""Principal point from the middle of the image, in pixels."""
ROTATION = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""World (+Z up) to camera (OpenCV): a camera that looks along +Y."""
CENTER = np.array([0.5, -5.0, 0.25])
NDFloat = NDArray[np.float64]


def brown(point: NDFloat, k: tuple[float, float, float], along_x: float, along_y: float) -> NDFloat:
    """Pixel of a world point; `along_x` is the coefficient of (r² + 2x²), `along_y` that of (r² + 2y²)."""
    camera = ROTATION @ (point - CENTER)
    x, y = camera[:2] / camera[2]
    r = x * x + y * y
    radial = 1 + k[0] * r + k[1] * r**2 + k[2] * r**3
    u = x * radial + along_x * (r + 2 * x * x) + 2 * along_y * x * y
    v = y * radial + along_y * (r + 2 * y * y) + 2 * along_x * x * y
    return np.array([WIDTH / 2 + FOCAL * u, HEIGHT / 2 + FOCAL * v]) + OFFSET


K, ALONG_X, ALONG_Y = (-0.2, 0.05, 0.01), 0.004, -0.003
POINTS = np.array([[0.2, 0.0, 0.1], [1.6, 0.3, 0.9], [-0.9, 0.1, -0.8]])


def metashape(folder: Path) -> None:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = ROTATION.T, CENTER
    size = f'<resolution width="{WIDTH}" height="{HEIGHT}"/>'
    # their p1 stands with r² + 2x²
    values = {"f": FOCAL, "cx": OFFSET[0], "cy": OFFSET[1], "k1": K[0], "k2": K[1], "k3": K[2]}
    values |= {"p1": ALONG_X, "p2": ALONG_Y}
    lens = "".join(f"<{key}>{value}</{key}>" for key, value in values.items())
    (folder / "cameras.xml").write_text(
        f'<document version="2.0.0"><chunk label="c"><sensors><sensor id="0" type="frame">{size}'
        f'<calibration type="frame" class="adjusted">{size}{lens}</calibration></sensor></sensors><cameras><group>'
        f'<camera id="0" sensor_id="0" label="a"><transform>{" ".join(map(str, pose.ravel()))}</transform></camera>'
        '</group><camera id="1" sensor_id="0" label="not aligned"/></cameras></chunk></document>'
    )


def xmp(folder: Path) -> None:
    # their t1 stands with r² + 2x²
    lens = f"{K[0]} {K[1]} {K[2]} 0 {ALONG_X} {ALONG_Y}"
    u, v = OFFSET / WIDTH
    (folder / "images" / "a.xmp").write_text(
        '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
        '<rdf:Description xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" xcr:DistortionModel="brown3t2" '
        f'xcr:FocalLength35mm="{FOCAL / WIDTH * 36}" xcr:PrincipalPointU="{u}" xcr:PrincipalPointV="{v}">'
        f"<xcr:Rotation>{' '.join(map(str, ROTATION.ravel()))}</xcr:Rotation>"
        f"<xcr:Position>{' '.join(map(str, CENTER))}</xcr:Position>"
        f"<xcr:DistortionCoeficients>{lens}</xcr:DistortionCoeficients></rdf:Description></rdf:RDF></x:xmpmeta>"
    )


def table(folder: Path, header: str = "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2") -> None:
    """A camera that looks along +Y is pitched by 90° from one that looks down, as drones do."""
    u, v = OFFSET / WIDTH
    lens = f"{FOCAL / WIDTH * 36},{u},{v},{K[0]},{K[1]},{K[2]},0,{ALONG_X},{ALONG_Y}"
    (folder / "scan.csv").write_text(f"#cameras 1\n{header}\na.png,{CENTER[0]},{CENTER[1]},{CENTER[2]},0,90,0,{lens}\n")


def table_of_realityscan(folder: Path) -> None:
    table(folder, "#name,x,y,alt,yaw,pitch,roll,f_35mm,px_norm,py_norm,k1,k2,k3,k4,t1,t2")


def sfm(folder: Path, version: str = "1.2.6") -> None:
    offset = OFFSET - 0.5  # pixel centres are at integers
    offset = (offset if version >= "1.2.1" else offset + np.array([WIDTH / 2, HEIGHT / 2])).tolist()
    lens: dict[str, Any] = {"type": "brown", "distortionParams": [*K, ALONG_Y, ALONG_X], "principalPoint": offset}
    lens |= {"focalLength": FOCAL / WIDTH * 36, "sensorWidth": 36} if version >= "1.2.2" else {"pxFocalLength": FOCAL}
    transform = {"rotation": ROTATION.T.ravel().tolist(), "center": CENTER.tolist()}
    content = {
        "version": version.split("."),
        "views": [
            {"viewId": "1", "poseId": "7", "intrinsicId": "3", "path": "C:\\scan\\images\\a.png"},
            {"viewId": "2", "poseId": "8", "intrinsicId": "3", "path": "C:\\scan\\images\\lost.png"},
        ],
        "intrinsics": [{"intrinsicId": "3", "width": str(WIDTH), "height": str(HEIGHT), **lens}],
        "poses": [{"poseId": "7", "pose": {"transform": transform}}],
    }
    (folder / "cameras.sfm").write_text(json.dumps(content))


def old_sfm(folder: Path) -> None:
    sfm(folder, "1.0.0")


def exported_sfm(folder: Path) -> None:
    sfm(folder)
    (folder / "cameras.sfm").rename(folder / "scene.json")


def mvg(folder: Path, nested: bool = False) -> None:
    middle = [WIDTH / 2 + OFFSET[0] - 0.5, HEIGHT / 2 + OFFSET[1] - 0.5]  # pixel centres are at integers
    pinhole = {"width": WIDTH, "height": HEIGHT, "focal_length": FOCAL, "principal_point": middle}
    lens = {**({"value0": pinhole} if nested else pinhole), "disto_t2": [*K, ALONG_Y, ALONG_X]}
    view = {"local_path": "images", "filename": "a.png", "id_intrinsic": 0, "id_pose": 0}
    lost = view | {"filename": "lost.png", "id_pose": 4294967295}
    intrinsic = {"ptr_wrapper": {"data": lens}}
    content = {
        "views": [{"key": i, "value": {"ptr_wrapper": {"data": data}}} for i, data in enumerate((view, lost))],
        "intrinsics": [{"key": 0, "value": intrinsic}],
        "extrinsics": [{"key": 0, "value": {"rotation": ROTATION.tolist(), "center": CENTER.tolist()}}],
    }
    (folder / "sfm_data.json").write_text(json.dumps(content))


def nested_mvg(folder: Path) -> None:
    mvg(folder, nested=True)


FORMATS: dict[str, Callable[[Path], None]] = {
    "metashape": metashape,
    "reality_capture": xmp,
    "reality_capture (CSV)": table,
    "reality_capture (CSV of RealityScan 2)": table_of_realityscan,
    "meshroom": sfm,
    "meshroom (1.0)": old_sfm,
    "meshroom (JSON)": exported_sfm,
    "open_mvg": mvg,
    "open_mvg (nested)": nested_mvg,
}


@pytest.mark.parametrize("name", FORMATS)
def test_points_land_where_the_manual_says(picture: Path, name: str) -> None:
    """Position, axes, principal point, and all five coefficients of the lens."""
    FORMATS[name](picture)
    capture = read_capture(picture, "train", PLUGINS)
    assert capture.reader == name.partition(" ")[0] and len(capture.views) == 1
    view = capture.views[0]
    assert view.camera is not None and view.name == "a"
    world = np.c_[POINTS, np.ones(3)] @ capture.world_from_source.T
    pinhole, depth = view.camera.project(world[:, :3])
    assert (depth > 0).all()
    expected = np.array([brown(point, K, ALONG_X, ALONG_Y) for point in POINTS])
    np.testing.assert_allclose(distorted(pinhole, view.camera.intrinsics, view.distortion), expected, atol=1e-6)
    # the camera stood level, so its up is the world's
    np.testing.assert_allclose(view.camera.world_to_camera[:3, :3] @ [0, 1, 0], [0, -1, 0], atol=1e-9)


def test_angles_of_a_table_are_those_of_a_map(picture: Path) -> None:
    """Heading is clockwise from +Y, as on a compass; pitch 0 looks down, 90° ahead; roll is about the vertical axis."""
    table(picture)
    edited(picture, "scan.csv", ",0,90,0,", ",70,55,20,")
    capture = read_capture(picture, "train", PLUGINS)
    camera = capture.views[0].camera
    assert camera is not None
    turn = capture.world_from_source[:3, :3]
    heading, pitch, roll = np.radians([70, 55, 20])
    ahead = np.array([np.sin(heading), np.cos(heading), 0])
    level, down = np.array([np.cos(heading), -np.sin(heading), 0]), np.array([0, 0, -1.0])
    optical = np.sin(pitch) * ahead + np.cos(pitch) * down
    lower = np.sin(pitch) * down - np.cos(pitch) * ahead
    # the vertical axis is the camera's own, after heading and pitch
    expected = [np.cos(roll) * level + np.sin(roll) * optical, lower, np.cos(roll) * optical - np.sin(roll) * level]
    np.testing.assert_allclose(camera.world_to_camera[:3, :3] @ turn, expected, atol=1e-9)


def distorted(pixels: NDFloat, k: NDFloat, coefficients: tuple[float, ...]) -> NDFloat:
    """OpenCV's own projection of the rays through `pixels`."""
    import cv2

    rays = np.c_[(pixels - k[:2, 2]) / [k[0, 0], k[1, 1]], np.ones(len(pixels))]
    found, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), k, np.array(coefficients))
    return np.asarray(found[:, 0], np.float64)


def bundle(folder: Path) -> None:
    rotation, flip = np.eye(3), np.diag([1.0, -1, -1])
    pose = flip @ rotation
    rows = [f"{FOCAL} 0 0", *(" ".join(map(str, row)) for row in pose), "0 0 -5"]
    text = ["# Bundle file v0.3", "2 1", *rows, "0 0 0", *["0 0 0"] * 4, "0 0 0", "1 2 3", "1 0 0 0 0"]
    (folder / "bundle.out").write_text("\n".join(text) + "\n")
    (folder / "list.txt").write_text("images/a.png 0 80\nimages/lost.png\n")


def keyframes(folder: Path) -> None:
    (folder / "keyframes" / "corrected_cameras").mkdir(parents=True)
    (folder / "keyframes" / "depth").mkdir()
    (folder / "images").rename(folder / "keyframes" / "corrected_images")
    shutil.copy(folder / "keyframes" / "corrected_images" / "a.png", folder / "keyframes" / "depth" / "a.png")
    pose = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5]])
    table = {f"t_{r}{c}": pose[r, c] for r in range(3) for c in range(4)}
    table |= {"fx": FOCAL, "fy": FOCAL, "cx": 32, "cy": 24, "width": WIDTH, "height": HEIGHT, "blur_score": 90}
    (folder / "keyframes" / "corrected_cameras" / "a.json").write_text(json.dumps(table))


SEEN_FROM_ABOVE: dict[str, tuple[Callable[[Path], None], NDFloat]] = {
    "bundler": (bundle, np.array([8.5 / 16, -11.5 / 16, 0.0])),
    "polycam": (keyframes, np.array([8.5 / 16, 11.5 / 16, 0.0])),
}
"""Cameras 5 units from a point of their own world that they see at the centre of pixel (40, 12)."""


@pytest.mark.parametrize("name", SEEN_FROM_ABOVE)
def test_a_point_lands_on_the_bright_pixel(picture: Path, name: str) -> None:
    write, point = SEEN_FROM_ABOVE[name]
    write(picture)
    capture = read_capture(picture, "train", PLUGINS)
    assert capture.reader == name and len(capture.views) == 1
    view = capture.views[0]
    assert view.camera is not None
    pixel, depth = view.camera.project((capture.world_from_source @ [*point, 1.0])[None, :3])
    np.testing.assert_allclose(pixel, [[40.5, 12.5]], atol=1e-6)
    assert depth[0] == pytest.approx(5)
    assert np.argwhere(view.pixels().color_linear[..., 0] > 0.5).tolist() == [[12, 40]]


def test_a_missing_keyframe_is_not_replaced_by_its_depth_map(picture: Path) -> None:
    keyframes(picture)
    (picture / "keyframes" / "corrected_images" / "a.png").unlink()
    with pytest.raises(CaptureError, match=r"'keyframes/corrected_images/a', which is not in"):
        read_capture(picture, "train", PLUGINS)


def test_a_chunk_in_metres_has_its_scale_and_place(picture: Path) -> None:
    metashape(picture)
    file = picture / "cameras.xml"
    place = (
        "<transform><rotation>0 -1 0 1 0 0 0 0 1</rotation><translation>1 2 3</translation><scale>2</scale></transform>"
    )
    file.write_text(file.read_text().replace("<sensors>", f"{place}<sensors>"))
    capture = read_capture(picture, "train", PLUGINS)
    camera = capture.views[0].camera
    assert camera is not None
    center = np.linalg.inv(capture.world_from_source) @ [*camera.center, 1.0]
    np.testing.assert_allclose(center[:3], [1 - 2 * CENTER[1], 2 + 2 * CENTER[0], 3 + 2 * CENTER[2]], atol=1e-9)
    # a position on the Earth is dropped, its scale is not
    file.write_text(file.read_text().replace("1 2 3", "4.1e6 5e5 4.8e6"))
    with pytest.warns(UserWarning, match="placed on the Earth"):
        moved = read_capture(picture, "train", PLUGINS)
    assert moved.views[0].camera is not None
    center = np.linalg.inv(moved.world_from_source) @ [*moved.views[0].camera.center, 1.0]
    np.testing.assert_allclose(center[:3], [-2 * CENTER[1], 2 * CENTER[0], 2 * CENTER[2]], atol=1e-9)


@pytest.mark.parametrize(
    ("references", "expected"),
    [
        ('<scalebars><scalebar id="0"><reference distance="0.3" enabled="1"/></scalebar></scalebars>', "1 scale bar"),
        ('<scalebars><scalebar id="0"><reference distance="0.3" enabled="0"/></scalebar></scalebars>', ""),
        ('<markers><marker id="0"><reference x="0" y="0" z="0"/></marker></markers>', ""),
        (
            "<markers>" + '<marker><reference x="0" y="1" z="0"/></marker>' * 3 + "</markers>",
            "3 markers with coordinates",
        ),
    ],
)
def test_metres_of_a_project_are_those_of_its_references(picture: Path, references: str, expected: str) -> None:
    metashape(picture)
    edited(picture, "cameras.xml", "</chunk>", f"{references}</chunk>")
    assert read_capture(picture, "train", PLUGINS).metres_from == ""  # a chunk without a scale has no unit
    edited(picture, "cameras.xml", "<sensors>", "<transform><scale>2</scale></transform><sensors>")
    found = read_capture(picture, "train", PLUGINS).metres_from
    assert found == (f"Metashape, by {expected}" if expected else "")


def edited(folder: Path, file: str, old: str, new: str) -> None:
    text = (folder / file).read_text()
    assert old in text
    (folder / file).write_text(text.replace(old, new))


REFUSED: list[tuple[Callable[[Path], None], str, str, str, str]] = [
    (metashape, "cameras.xml", "<k1>", "<k4>0.1</k4><k1>", "k4.*not supported"),
    (metashape, "cameras.xml", "<k1>", "<b2>3</b2><k1>", "b2.*not supported"),
    (metashape, "cameras.xml", 'type="frame">', 'type="spherical">', "spherical"),
    (metashape, "cameras.xml", "<document", "<!DOCTYPE a [<!ENTITY b 'c'>]><document", "document type"),
    (metashape, "cameras.xml", 'label="a"', 'label="b"', "'b', which is not in"),
    (metashape, "cameras.xml", "</document>", "", "not valid XML"),
    (metashape, "cameras.xml", "<f>80.0</f>", "<f>nan</f>", "not a finite number"),
    (xmp, "images/a.xmp", "brown3t2", "division", "'division' is not supported"),
    (xmp, "images/a.xmp", " 0 0.004", " 0.1 0.004", "k4"),
    (xmp, "images/a.xmp", "xcr:PrincipalPointU", 'xcr:Skew="0.1" xcr:PrincipalPointU', "skew"),
    (table, "scan.csv", ",heading", ",omega", "no column 'heading'"),
    (table, "scan.csv", ",90,", ",up,", "'up' is not a finite number"),
    (table, "scan.csv", "a.png,", '"a.png,' + "x" * 140_000, "not a CSV file .field larger"),
    (sfm, "cameras.sfm", '"brown"', '"3declassicld"', "'3declassicld' is not supported"),
    (sfm, "cameras.sfm", '"brown"', '"equidistant", "distortionType": "radialk3"', "'equidistant' is not supported"),
    (sfm, "cameras.sfm", '"sensorWidth": 36', '"sensorWidth": 0', "0 mm wide"),
    (sfm, "cameras.sfm", '"poseId": "7", "intrinsicId"', '"rigId": "5", "poseId": "7", "intrinsicId"', "rig"),
    (sfm, "cameras.sfm", '"poseId": "7", "pose"', '"poseId": "9", "pose"', "no photograph with a camera"),
    (mvg, "sfm_data.json", "disto_t2", "disto_k9", "'disto_k9' is not supported"),
    (mvg, "sfm_data.json", '"extrinsics": [', '"extrinsics": [3, ', "not a list of keys and values"),
    (bundle, "bundle.out", "2 1", "200000 1", "five lines of three numbers"),
    (bundle, "list.txt", "images/lost.png", "", "names of as many images"),
    (keyframes, "keyframes/corrected_cameras/a.json", '"fx"', '"focal"', "no 'fx'"),
]


@pytest.mark.parametrize(("write", "file", "old", "new", "words"), REFUSED, ids=[f"{r[1]} {r[4]}" for r in REFUSED])
def test_what_cannot_be_read_is_one_sentence(
    picture: Path, write: Callable[[Path], None], file: str, old: str, new: str, words: str
) -> None:
    write(picture)
    edited(picture, file, old, new)
    with pytest.raises(CaptureError, match=words) as error:
        read_capture(picture, "train", PLUGINS)
    assert "\n" not in str(error.value)


def test_two_photographs_of_one_name_are_refused_unless_the_path_says_which(picture: Path) -> None:
    (picture / "other").mkdir()
    shutil.copy(picture / "images" / "a.png", picture / "other" / "a.png")
    sfm(picture)  # names images/a.png
    path = read_capture(picture, "train", PLUGINS).views[0].path
    assert path is not None and path.parent.name == "images"
    (picture / "cameras.sfm").unlink()
    metashape(picture)  # names a
    with pytest.raises(CaptureError, match="keep only one"):
        read_capture(picture, "train", PLUGINS)


def test_a_sidecar_belongs_to_the_photograph_beside_it(picture: Path) -> None:
    """Also where a folder below has another of that name, such as thumbnails."""
    xmp(picture)
    for name in ("a.png", "a.xmp"):
        shutil.move(picture / "images" / name, picture / name)
    shutil.copy(picture / "a.png", picture / "images" / "a.png")
    assert [view.path for view in read_capture(picture, "train", PLUGINS).views] == [picture / "a.png"]


def test_two_cameras_of_one_photograph_are_refused(picture: Path) -> None:
    """As of two folders of a camera that number alike, of which one was copied."""
    metashape(picture)
    content = (picture / "cameras.xml").read_text()
    camera = content[content.index("<camera id") : content.index("</camera>") + len("</camera>")]
    edited(picture, "cameras.xml", "</group>", camera.replace('id="0"', 'id="5"', 1) + "</group>")
    with pytest.raises(CaptureError, match=r"have the same photograph, .*a\.png; give photographs of"):
        read_capture(picture, "train", PLUGINS)


def test_hidden_files_are_not_read(picture: Path) -> None:
    """`._NAME`, which macOS writes beside each file on some disks."""
    keyframes(picture)
    for file in [f for f in picture.rglob("*") if f.is_file()]:
        file.with_name(f"._{file.name}").write_bytes(b"\0\5\x16\7")
    assert [view.name for view in read_capture(picture, "train", PLUGINS).views] == ["a"]


@pytest.mark.parametrize(
    ("line", "name"),
    [("a b.jpg", "a b.jpg"), ("a.jpg 0", "a.jpg"), ("a 0 1.5e3", "a"), ("a 1 80", "a 1 80"), ("a 0 x", "a 0 x")],
)
def test_names_in_the_list_of_bundler(line: str, name: str) -> None:
    from hir_plugins.readers.bundler import _without_focal_length

    assert _without_focal_length(line) == name
    start = time.process_time()
    _without_focal_length("a" + " " * 1_000_000 + "b")
    assert time.process_time() - start < 5, "linear in the length"


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="no symbolic links")
def test_no_photograph_is_read_outside_the_capture(picture: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    outside = tmp_path_factory.mktemp("outside") / "a.png"
    shutil.move(picture / "images" / "a.png", outside)
    (picture / "images" / "a.png").symlink_to(outside)
    metashape(picture)
    with pytest.raises(CaptureError, match="leads out"):
        read_capture(picture, "train", PLUGINS)


@pytest.mark.parametrize("name", ["metashape", "reality_capture", "meshroom", "open_mvg", "bundler"])
def test_cameras_come_before_photographs_alone(tiny_capture: Path, tmp_path: Path, name: str) -> None:
    """A folder that is also a folder of photographs is read with its cameras."""
    from hir_plugins.readers import contract_inputs

    capture = read_capture(tiny_capture, "train", PLUGINS)
    path = getattr(contract_inputs, name)(capture, tmp_path)
    found = read_capture(path, "train", PLUGINS)
    assert found.reader == name
    assert all(view.camera is not None for view in found.views) and len(found.views) == len(capture.views)


def test_sidecars_of_other_programs_are_no_cameras(picture: Path) -> None:
    (picture / "images" / "a.xmp").write_text('<x:xmpmeta xmlns:x="adobe:ns:meta/"/>')
    shutil.copy(picture / "images" / "a.png", picture / "images" / "b.png")
    capture: Capture = read_capture(picture, "train", PLUGINS)
    assert capture.reader == "photos"
