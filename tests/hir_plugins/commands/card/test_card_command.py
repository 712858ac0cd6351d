"""`hir card`: a page whose markers have the size that it states."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from hir_core.cli.app import cli
from hir_plugins.commands.card.card_page import MARGIN_MM, PAPERS_MM, side_of_markers
from hir_plugins.initializers.markers.grey_card import HEIGHT, MARKERS, WIDTH


def run(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(cli, ["card", *map(str, arguments)])
    return result.exit_code, result.output


@pytest.mark.parametrize("paper", ["a4", "letter"])
def test_the_markers_have_the_stated_size(paper: str, tmp_path: Path) -> None:
    """Measured in the picture by OpenCV's detector, at the resolution that the file states."""
    from PIL import Image

    code, said = run("-o", tmp_path / "card.png", "--paper", paper)
    side = side_of_markers(paper)
    assert code == 0 and f"initializer.fiducial_markers.side={side:g}" in said
    with Image.open(tmp_path / "card.png") as image:
        picture, dots_per_inch = np.asarray(image), float(image.info["dpi"][0])
    millimetres = 25.4 / dots_per_inch
    size = np.array(picture.shape[::-1]) * millimetres
    np.testing.assert_allclose(size, PAPERS_MM[paper], rtol=1e-3)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    corners, numbers, _ = cv2.aruco.ArucoDetector(dictionary, cv2.aruco.DetectorParameters()).detectMarkers(picture)
    assert sorted(np.ravel(numbers).tolist()) == list(MARKERS)
    for each in corners:
        sides = np.linalg.norm(each[0] - np.roll(each[0], 1, axis=0), axis=1) * millimetres
        np.testing.assert_allclose(sides, 1000 * side, rtol=0.005)
    assert (
        WIDTH * 1000 * side <= size[0] - 2 * MARGIN_MM + 0.1 and HEIGHT * 1000 * side <= size[1] - 2 * MARGIN_MM + 0.1
    )


def test_a_pdf_has_the_size_of_the_paper(tmp_path: Path) -> None:
    assert run("-o", tmp_path / "card.pdf")[0] == 0
    data = (tmp_path / "card.pdf").read_bytes()
    assert data.startswith(b"%PDF-")
    box = data.partition(b"/MediaBox")[2].partition(b"[")[2].partition(b"]")[0].split()
    np.testing.assert_allclose([float(each) / 72 * 25.4 for each in box], [0, 0, *PAPERS_MM["a4"]], atol=0.2)


def test_wrong_targets_are_one_sentence(tmp_path: Path) -> None:
    for target, sentence in (
        (tmp_path / "card.svg", "must end in .pdf or .png"),
        (tmp_path / "no" / "c.png", "create"),
    ):
        result = CliRunner().invoke(cli, ["card", "-o", str(target)])
        assert result.exit_code != 0 and sentence in str(result.exception) + result.output
        assert not target.exists()
