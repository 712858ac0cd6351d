"""Captures with nonsense: numbers, names, poses, lenses and pipes are one sentence and exit code 2."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hir_exporters.errors import HirError
from hir_exporters.files.untrusted_json import parse_json

from tests.reliability import seeds


def refused(folder: Path, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that `hir check` prints about a capture that it refuses."""
    from hir_core.cli.app import main

    with pytest.raises(SystemExit) as ended:
        main(["check", str(folder)])
    message = capsys.readouterr().err
    assert ended.value.code == 2, message
    assert message.startswith("hir: ") and message.count("\n") == 1 and "this is a bug" not in message
    return message


def changed(folder: Path, change: Callable[[dict[str, Any], dict[str, Any]], object]) -> None:
    """transforms_train.json with a change of the document or its first frame."""
    seeds.transforms(folder)
    path = folder / "transforms_train.json"
    document = json.loads(path.read_text())
    change(document, document["frames"][0])
    path.write_text(json.dumps(document))


def matrix(**entries: float) -> Callable[[dict[str, Any], dict[str, Any]], object]:
    """A change of entries of the pose, such as `m03`."""

    def change(document: dict[str, Any], frame: dict[str, Any]) -> None:
        for name, value in entries.items():
            frame["transform_matrix"][int(name[1])][int(name[2])] = value

    return change


TRANSFORMS: dict[str, tuple[Callable[[dict[str, Any], dict[str, Any]], object], str]] = {
    "huge integer": (lambda d, f: d.update(w=10**400), "integer of 401 digits"),
    "huge integer in a pose": (matrix(m03=10**400), "integer of 401 digits"),
    "half a character": (lambda d, f: f.update(file_path="\ud800.png"), "surrogates not allowed"),
    "distortion": (lambda d, f: f.update(k1=1e30), "move the image"),
    "negative distortion": (lambda d, f: f.update(k1=-1e30), "the image"),
    "distortion that overflows": (lambda d, f: f.update(k1=1e300, k2=1e300), "the image"),
    "far away": (matrix(m03=1e300), "from the origin"),
    "bottom row": (matrix(m32=0.5), "last row"),
    "scaled bottom row": (matrix(m33=2.0), "last row"),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_nonsense_in_transforms_json_is_refused(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    change, expected = TRANSFORMS[name]
    changed(tmp_path, change)
    assert expected in refused(tmp_path, capsys)


def test_ordinary_lenses_and_poses_are_read(tmp_path: Path) -> None:
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager

    changed(tmp_path, lambda d, f: f.update(k1=-0.3, k2=0.1, p1=1e-3))
    assert read_capture(tmp_path, "train", PluginManager.discover()).views


def test_singular_and_oddly_numbered_idr_matrices_are_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seeds.idr(tmp_path)
    with np.load(tmp_path / "cameras.npz") as stored:
        arrays = {name: stored[name] for name in stored.files}
    for value, expected in ((0.0, "singular"), (1.0, "singular"), (1e300, "singular")):
        np.savez(tmp_path / "cameras.npz", **arrays | {"world_mat_0": np.full((4, 4), value)})  # type: ignore[arg-type]
        assert expected in refused(tmp_path, capsys)
    flat = arrays["world_mat_0"].copy()
    flat[0] = flat[1]
    np.savez(tmp_path / "cameras.npz", **arrays | {"world_mat_0": flat})
    assert "singular" in refused(tmp_path, capsys)
    for number in ("9" * 5000, "00"):
        renamed = {name.replace("world_mat_0", f"world_mat_{number}"): value for name, value in arrays.items()}
        np.savez(tmp_path / "cameras.npz", **renamed)
        assert "cameras" in refused(tmp_path, capsys)


def test_an_index_of_5000_digits_in_a_colmap_model_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seeds.colmap_text(tmp_path)
    path = tmp_path / "sparse" / "0" / "cameras.txt"
    path.write_text(re.sub(r"^\d+", "9" * 5000, path.read_text(), flags=re.M))
    assert "not a whole number" in refused(tmp_path, capsys)


def test_a_setting_of_5000_digits_is_refused(tmp_path: Path) -> None:
    from hir_core.config import load_config
    from hir_core.plugins.manager import PluginManager

    (tmp_path / "a.toml").write_text("seed = " + "9" * 5000 + "\n")
    with pytest.raises(HirError, match=r"a\.toml: not valid TOML"):
        load_config(PluginManager.discover(), file=tmp_path / "a.toml")
    with pytest.raises(HirError):
        load_config(PluginManager.discover(), assignments=["seed=" + "9" * 5000])


def test_json_of_others() -> None:
    assert parse_json(b'\xef\xbb\xbf{"a": [-9223372036854775808, "\\ud83d\\ude00"]}') == {"a": [-(2**63), "😀"]}
    for text in ('{"a": ' + "1" * 20 + "}", '{"a": "\\ud800"}', '{"\\udc00": 1}', '["\\ud83d", "\\ude00"]'):
        with pytest.raises(ValueError, match=r"digits|surrogates"):
            parse_json(text)


def test_a_name_with_a_line_end_stays_on_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from hir_core.cli.app import main

    folder = tmp_path / "two\nlines\x1b[31m"
    folder.mkdir()
    message = refused(folder, capsys)
    assert "two\\nlines\\x1b[31m" in message
    capture = tmp_path / "capture"
    capture.mkdir()
    changed(capture, lambda d, f: f.update(file_path="gone\nhir: all is well"))
    assert "hir: all is well" in refused(capture, capsys)
    picture = capture / "train" / "r_0.png"
    picture.rename(picture.with_name("a\nb.png"))
    path = capture / "transforms_train.json"
    document = json.loads(path.read_text())
    document["frames"][0]["file_path"] = "./train/a\nb"
    path.write_text(json.dumps(document))
    with pytest.raises(SystemExit) as ended:
        main(["check", str(capture), "-v"])
    lines = capsys.readouterr().out.splitlines()
    assert ended.value.code == 0 and any("a\\nb" in line for line in lines)


def test_a_file_name_that_is_no_text_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Linux allows any bytes; cameras.json, run.json and the terminal do not."""
    from hir_core.run.run_directory import claimed_run

    (tmp_path / "images").mkdir()
    for name in (b"a\xff.png", b"b.png", b"c.png"):
        Path(os.fsdecode(os.path.join(os.fsencode(tmp_path), b"images", name))).write_bytes(seeds_png())
    assert "not valid Unicode" in refused(tmp_path, capsys)
    with (
        pytest.raises(HirError, match="not valid Unicode"),
        claimed_run(os.fsdecode(os.path.join(os.fsencode(tmp_path), b"run\xff")), resume=False),
    ):
        pass


def seeds_png() -> bytes:
    from hir_exporters.textures.image_files import encode_png

    return encode_png(np.full((8, 9, 3), 0.5, np.float32))


@pytest.mark.parametrize(
    ("fill", "file"),
    [
        (seeds.transforms, "transforms_train.json"),
        (seeds.colmap_text, "sparse/0/images.txt"),
        (seeds.colmap_text, "sparse/0/cameras.txt"),
        (seeds.colmap_text, "sparse/0/points3D.txt"),
        (seeds.idr, "cameras.npz"),
        (seeds.llff, "poses_bounds.npy"),
        (seeds.middlebury, "temple_par.txt"),
        (seeds.blended_mvs, "cams/00000000_cam.txt"),
        (seeds.scan("metashape"), "cameras.xml"),
        (seeds.scan("reality_capture"), "0.xmp"),
        (seeds.scan("meshroom"), "cameras.sfm"),
        (seeds.scan("open_mvg"), "sfm_data.json"),
        (seeds.scan("bundler"), "bundle.out"),
        (seeds.scan("bundler"), "list.txt"),
        (seeds.scan("polycam"), "keyframes/corrected_cameras/0.json"),
        (seeds.scan("record3d"), "recording.r3d"),
    ],
)
def test_a_pipe_in_a_capture_does_not_block(fill: Callable[[Path], None], file: str, tmp_path: Path) -> None:
    """It ends: with one sentence, or by reading the folder as if the file were not there."""
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager

    fill(tmp_path)
    (tmp_path / file).unlink()
    os.mkfifo(tmp_path / file)
    try:
        read_capture(tmp_path, "train", PluginManager.discover())
    except HirError as error:
        assert "\n" not in str(error)


def test_a_pipe_as_photograph_does_not_block(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    changed(tmp_path, lambda d, f: f.update(file_path="./train/r_0.png"))
    picture = tmp_path / "train" / "r_0.png"
    picture.unlink()
    os.mkfifo(picture)
    assert "not a regular file" in refused(tmp_path, capsys)
