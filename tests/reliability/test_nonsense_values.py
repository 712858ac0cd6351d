"""Values that no camera, light or setting has: one sentence, in bounded time and memory, and no figure from them."""

from __future__ import annotations

import io
import json
import os
import time
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.errors import HirError
from hir_exporters.textures.image_files import read_exr, write_hdr
from PIL import Image

from tests.reliability import seeds


def test_numbers_of_exif_records_stay_finite(tmp_path: Path) -> None:
    """Of an f-number of 1e-200 the square is 0; others overflow."""
    from hir_core.capture.exif import _exposure, _focal_over_width

    time_of, aperture, iso = 0x829A, 0x829D, 0x8827
    for value in (1e-200, 1e200, 5e-324):
        for key in (time_of, aperture, iso):
            found = _exposure({time_of: 0.01, aperture: 2.0, iso: 100} | {key: value})
            assert np.isfinite(found) and found >= 0
    assert _exposure({time_of: 0.01, aperture: 2.0, iso: 100}) == pytest.approx(0.25)
    focal, across, resolution = 0x920A, 0xA002, 0xA20E
    for across_value, resolution_value in ((1e-300, 1e300), (1e300, 1e-300)):
        assert np.isfinite(_focal_over_width({focal: 50.0, across: across_value, resolution: resolution_value}))


def test_an_exr_of_many_channels_is_not_read(tmp_path: Path) -> None:
    import OpenEXR

    plane = np.zeros((64, 64), np.float16)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    names = ["R", "G", "B", *(f"layer{i}.v" for i in range(300))]
    OpenEXR.File(header, {name: plane for name in names}).write(str(tmp_path / "a.exr"))
    assert read_exr(tmp_path / "a.exr").shape == (64, 64, 3)
    with pytest.raises(HirError, match="has 303 channels of 64 x 64; save RGB or RGBA alone"):
        read_exr(tmp_path / "a.exr", max_pixels=64 * 64)


def test_a_strength_that_overflows_is_refused(tmp_path: Path) -> None:
    from hir_core.capture import EnvironmentSource
    from hir_core.rendering.light_files import is_same_light, load_light

    write_hdr(tmp_path / "a.hdr", np.ones((4, 8, 3), np.float32))
    source = EnvironmentSource(tmp_path / "a.hdr", 1e300, np.eye(3))
    with pytest.raises(HirError, match=r"a.hdr: its radiance times 1e\+300 is too large"):
        load_light(source, np.eye(4))
    gone = [EnvironmentSource(tmp_path / name, 1.0, np.eye(3)) for name in ("b.hdr", "c.hdr")]
    with pytest.raises(HirError, match=r"b.hdr cannot be read: .*; add the light"):
        is_same_light(*gone)


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("fl_x", 1e300, "focal length 1e\\+300"),
        ("cx", -1e9, "centre -1e\\+09"),
        ("camera_angle_x", 5e-324, "no focal length"),
        ("file_path", "./", "names a folder, not an image"),
    ],
)
def test_lenses_that_cannot_be_are_refused(
    key: str, value: object, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from hir_core.intake.reader_lookup import read_capture
    from hir_core.plugins.manager import PluginManager

    seeds.transforms(tmp_path)
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "transforms_train.json"
    document = json.loads(path.read_text())
    target = document["frames"][0] if key == "file_path" else document
    target[key] = value
    if key in ("fl_x", "cx"):
        document |= {"fl_x": document.get("fl_x", 20.0), "w": 0, "h": 0}
    if key == "camera_angle_x":
        document.pop("fl_x", None)
    path.write_text(json.dumps(document))
    with pytest.raises(HirError, match=words):
        read_capture(Path(), "train", PluginManager.discover())


def test_a_pipe_as_a_layer_of_usd_does_not_block(tmp_path: Path) -> None:
    from hir_exporters.reading.usd_reading.usd_import import read_untrusted_usd

    os.mkfifo(tmp_path / "pipe.usda")
    (tmp_path / "a.usda").write_text("#usda 1.0\n(\n    subLayers = [@./pipe.usda@]\n)\n")
    started = time.monotonic()
    with pytest.raises(HirError, match=r"pipe.usda is not a regular file"):
        read_untrusted_usd(tmp_path / "a.usda")
    assert time.monotonic() - started < 60


def test_a_settings_file_of_many_dots_or_bytes_is_refused(tmp_path: Path) -> None:
    from hir_core.config import read_toml

    (tmp_path / "dots.toml").write_text(".".join("a" * 8_000) + " = 1\n")
    (tmp_path / "large.toml").write_text("#" * (2 << 20))
    os.mkfifo(tmp_path / "pipe.toml")
    for name, words in (
        ("dots", "is no file of settings"),
        ("large", "larger than 1024 kB"),
        ("pipe", "not a regular"),
    ):
        with pytest.raises(HirError, match=words):
            read_toml(tmp_path / f"{name}.toml")


def test_messages_and_names_stay_on_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    from rich.console import Console

    from hir_core.cli.evaluation_table import IMAGE_COLUMNS, table_of
    from hir_core.terminal.progress_bar import ProgressBar

    with ProgressBar(quiet=False) as bar:
        bar.message("view a\nhir: forged line\x1b[31m")
    printed = capsys.readouterr()
    assert "view a\\nhir: forged line\\x1b[31m" in " ".join((printed.out + printed.err).split())
    console = Console(width=200, file=io.StringIO())
    console.print(table_of([{"run": "two\nlines[red]", "split": "test"}], IMAGE_COLUMNS))
    assert "two\\nlines[red]" in console.file.getvalue()  # type: ignore[attr-defined]


def test_masks_are_read_inside_the_capture_alone(tmp_path: Path) -> None:
    from hir_core.capture import Capture, Pixels, View
    from hir_plugins.masks.folder import Folder
    from hir_plugins.masks.options import FolderOptions

    capture = tmp_path / "capture"
    for name in ("images/a.png", "m/b.png"):
        (capture / name).parent.mkdir(parents=True, exist_ok=True)
        Image.new("L", (4, 4), 255).save(capture / name)
    Image.new("L", (4, 4), 255).save(tmp_path / "outside.png")
    (capture / "m" / "a.png").symlink_to(tmp_path / "outside.png")
    pixels = Pixels(np.zeros((4, 4, 3), np.float32), None, np.zeros((4, 4), bool))
    view = View("a", None, lambda: pixels, path=capture / "images" / "a.png")
    with pytest.raises(HirError, match="leads out of"):
        Folder(FolderOptions(path="m")).masks(Capture(capture, (view,)), None)
