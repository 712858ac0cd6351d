"""Exposures that EXIF data record or that a fit found, and the captures that they are applied to."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from hir_core.capture import Capture, Pixels, View
from hir_core.capture.exif import camera_record
from hir_core.capture.photograph_exposures import (
    EQUAL_EXPOSURES,
    PhotographExposures,
    recorded_exposure,
    with_recorded_exposures,
)
from hir_core.errors import InputError
from hir_core.files.json_documents import write_json
from hir_core.run.capture_store import read_exposures

TABLE, SECONDS, F_NUMBER, ISO = 0x8769, 0x829A, 0x829D, 0x8827


def photograph(folder: Path, name: str, **exif: object) -> View:
    """A photograph of 2×2 pixels; `exif`: seconds, f_number and iso."""
    keys = {"seconds": SECONDS, "f_number": F_NUMBER, "iso": ISO}
    record = Image.Exif()
    if exif:
        record[TABLE] = {keys[key]: value for key, value in exif.items()}
    path = folder / f"{name}.png"
    Image.new("RGB", (2, 2)).save(path, exif=record)
    return View(name, None, lambda: Pixels(np.zeros((2, 2, 3), np.float32), None, np.zeros((2, 2), bool)), path=path)


def taken(folder: Path, *seconds: float) -> Capture:
    views = (photograph(folder, str(i), seconds=each, f_number=4.0, iso=200) for i, each in enumerate(seconds))
    return Capture(folder, tuple(views))


def test_exposure_is_time_times_sensitivity_over_squared_f_number(tmp_path: Path) -> None:
    view = photograph(tmp_path, "one", seconds=0.02, f_number=4.0, iso=200)
    assert view.path is not None
    assert camera_record(view.path).exposure == pytest.approx(0.02 * 200 / 16, rel=1e-4)


@pytest.mark.parametrize(
    "exif",
    [
        {},
        {"seconds": 0.02, "iso": 200},
        {"seconds": 0.0, "f_number": 4.0, "iso": 200},
        {"seconds": 0.02, "f_number": 4.0},
    ],
    ids=["nothing", "no aperture", "no time", "no sensitivity"],
)
def test_an_incomplete_record_is_no_exposure(exif: dict[str, object], tmp_path: Path) -> None:
    assert recorded_exposure(photograph(tmp_path, "one", **exif)) is None


def test_different_exposures_of_all_photographs_are_recorded(tmp_path: Path) -> None:
    capture = with_recorded_exposures(taken(tmp_path, 0.01, 0.02, 0.04))
    ratios = [(view.recorded_exposure or 0) / 0.125 for view in capture.views]
    np.testing.assert_allclose(ratios, [1, 2, 4], rtol=1e-4)


def test_equal_exposures_and_gaps_are_not_recorded(tmp_path: Path) -> None:
    equal = taken(tmp_path, 0.01, 0.01)
    assert with_recorded_exposures(equal) is equal
    gap = replace(equal, views=(*taken(tmp_path, 0.01, 0.04).views, photograph(tmp_path, "last")))
    assert with_recorded_exposures(gap) is gap


def test_recorded_exposures_have_a_geometric_mean_of_one_and_apply_to_other_splits(tmp_path: Path) -> None:
    capture = with_recorded_exposures(taken(tmp_path, 0.01, 0.02, 0.04))
    factors = np.array([[0.5] * 3, [1.0] * 3, [2.0] * 3], np.float32)
    exposures = PhotographExposures.of("recorded", capture, factors)
    again = PhotographExposures.from_document(exposures.as_document())
    assert again == exposures
    np.testing.assert_allclose([v.gain for v in again.applied_to(capture).views], factors)
    other = replace(taken(tmp_path, 0.08), split="test")
    np.testing.assert_allclose(again.applied_to(other).views[0].gain, 4, rtol=1e-4)


def test_fitted_exposures_apply_to_the_photographs_of_the_fit_alone(tmp_path: Path) -> None:
    capture = taken(tmp_path, 0.01, 0.02)
    exposures = PhotographExposures.of("fitted", capture, np.array([[1, 2, 3], [1, 0.5, 1 / 3]], np.float32))
    brighter = replace(capture, views=tuple(replace(view, exposure=2.0) for view in capture.views))
    np.testing.assert_allclose(exposures.applied_to(brighter).views[0].gain, [2, 4, 6], rtol=1e-6)
    # a photograph of another split may have the same name
    np.testing.assert_array_equal(exposures.applied_to(replace(capture, split="test")).views[0].gain, 1)


def test_equal_exposures_change_nothing(tmp_path: Path) -> None:
    capture = taken(tmp_path, 0.01, 0.02)
    assert EQUAL_EXPOSURES.applied_to(capture) == capture
    assert PhotographExposures.of("equal", capture, None) == EQUAL_EXPOSURES


def test_a_run_of_an_older_version_has_equal_exposures(tmp_path: Path) -> None:
    write_json(tmp_path / "model.json", {"bounces": 3})
    assert read_exposures(tmp_path / "model.json") == EQUAL_EXPOSURES


@pytest.mark.parametrize(
    "document",
    [
        {"exposures": {}},
        {"exposures": ["kind"]},
        {"exposures": {"kind": "strange", "factors": {}, "reference": None}},
        {"exposures": {"kind": "fitted", "factors": {"0": [1, 1]}, "reference": None}},
        {"exposures": {"kind": "fitted", "factors": {"0": [1, 1, -1]}, "reference": None}},
        {"exposures": {"kind": "fitted", "factors": {"0": [1, 1, "x"]}, "reference": None}},
        {"exposures": {"kind": "recorded", "factors": {}, "reference": 0}},
    ],
    ids=["empty", "a list", "kind", "two channels", "negative", "no number", "no reference"],
)
def test_damaged_exposures_are_one_sentence(document: dict[str, object], tmp_path: Path) -> None:
    write_json(tmp_path / "model.json", document)
    with pytest.raises(InputError, match=r"model.json holds damaged exposures .* run without --resume"):
        read_exposures(tmp_path / "model.json")
