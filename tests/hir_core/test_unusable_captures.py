"""Captures that no fit can use, or only in part, are named as what they are."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import read_ldr, write_png

from hir_core.errors import CaptureError, ConfigError
from hir_core.pipeline import Run
from tests.fixtures.runs import make_tiny


def with_channel(capture: Path, channels: slice, value: float, names: slice = slice(None)) -> Path:
    """The capture with one value in some channels of some photographs."""
    for path in sorted((capture / "train").glob("*.png"))[names]:
        picture = np.array(read_ldr(path))
        picture[..., channels] = value
        write_png(path, picture)
    return capture


ALPHA, COLOR = slice(3, 4), slice(0, 3)


@pytest.mark.parametrize(("value", "counted"), [(1.0, "10 show only object and 0"), (0.0, "0 show only object and 10")])
def test_masks_without_an_outline_are_counted(
    tmp_path: Path, quick: Callable[..., Run], value: float, counted: str
) -> None:
    capture = with_channel(make_tiny(tmp_path / "capture"), ALPHA, value)
    with pytest.raises(CaptureError, match=f"0 of 10 masks have an outline.*{counted} only background"):
        quick(capture, tmp_path / "run", until="initializer")


def test_one_mask_with_an_outline_is_not_counted_as_full(tmp_path: Path, quick: Callable[..., Run]) -> None:
    capture = with_channel(make_tiny(tmp_path / "capture"), ALPHA, 1.0, slice(0, 4))
    with_channel(capture, ALPHA, 0.0, slice(4, 9))
    with pytest.raises(CaptureError, match=r"1 of 10 masks have an outline.*4 show only object and 5 only background"):
        quick(capture, tmp_path / "run", until="initializer")


def test_an_object_far_from_the_origin_is_refused_with_the_distance(tmp_path: Path, quick: Callable[..., Run]) -> None:
    capture = make_tiny(tmp_path / "capture")
    path = capture / "transforms_train.json"
    document = json.loads(path.read_text())
    for frame in document["frames"]:
        frame["transform_matrix"][0][3] += 1e7
    path.write_text(json.dumps(document))
    with pytest.raises(CaptureError, match=r"the cameras are 1e\+07 from the origin.*subtract \(1e\+07, "):
        quick(capture, tmp_path / "run", until="initializer")


def test_two_photographs_are_fitted_with_a_warning(tmp_path: Path, quick: Callable[..., Run]) -> None:
    run = quick(make_tiny(tmp_path / "capture", train=2), tmp_path / "run", until="initializer")
    warnings = run.directory.read_run()["stages"]["initializer"]["warnings"]
    assert any("only 2 photographs" in warning and "no models are compared" in warning for warning in warnings)


def test_one_photograph_is_refused_whatever_its_mask(tmp_path: Path, quick: Callable[..., Run]) -> None:
    capture = make_tiny(tmp_path / "capture")
    path = capture / "transforms_train.json"
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"frames": document["frames"][:1]}))
    with pytest.raises(CaptureError, match=r"needs cameras of at least two photographs, there are 1; add photographs"):
        quick(capture, tmp_path / "run", until="initializer")


def test_an_object_that_is_clipped_everywhere_is_refused_and_one_pixel_suffices(
    tmp_path: Path, quick: Callable[..., Run]
) -> None:
    capture = with_channel(make_tiny(tmp_path / "capture"), COLOR, 1.0)
    with pytest.raises(CaptureError, match="every pixel of the object is clipped in all 10 photographs"):
        quick(capture, tmp_path / "run", "geometry.enabled=false", until="reflectance")
    path = sorted((capture / "train").glob("*.png"))[-1]
    picture = np.array(read_ldr(path))
    row, column = (int(np.median(i)) for i in np.nonzero(picture[..., 3] > 0.9))
    picture[row - 2 : row + 3, column - 2 : column + 3, :3] = 0.5
    write_png(path, picture)
    run = quick(capture, tmp_path / "other", "geometry.enabled=false", until="reflectance")
    assert run.directory.record("reflectance")


def test_recorded_exposures_that_are_missing_are_refused_before_the_first_stage(
    tiny_capture: Path, quick: Callable[..., Run], tmp_path: Path
) -> None:
    with pytest.raises(CaptureError, match=r"record no different exposures .* use --set reflectance\.exposures=fitted"):
        quick(tiny_capture, tmp_path / "run", "reflectance.exposures=recorded")
    assert not list((tmp_path / "run").glob("stages/*"))


def test_settings_that_several_takes_do_not_allow_are_refused_before_the_first_stage(
    tmp_path: Path, quick: Callable[..., Run]
) -> None:
    """The preset `best` ends with gradient steps, which have one light."""
    capture = make_tiny(tmp_path / "capture")
    path = capture / "transforms_train.json"
    content = json.loads(path.read_text())
    for number, frame in enumerate(content["frames"]):
        frame["take"] = "front" if number % 2 else "back"
    path.write_text(json.dumps(content))
    with pytest.raises(ConfigError, match=r"set reflectance\.path_tracing\.iterations to 0"):
        quick(capture, tmp_path / "run", "reflectance.path_tracing.iterations=3")
    assert not list((tmp_path / "run").glob("stages/*"))
