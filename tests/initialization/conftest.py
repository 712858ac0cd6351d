"""Small captures made on the spot: a known point of the world on a known pixel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

WIDTH, HEIGHT = 64, 48


def spot_picture(x: int, y: int) -> NDArray[np.uint8]:
    """Black, with one white pixel."""
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    pixels[y, x] = 255
    return pixels


@pytest.fixture
def picture(tmp_path: Path) -> Path:
    """A folder with one picture, `images/a.png`, white at pixel (40, 12)."""
    (tmp_path / "images").mkdir()
    Image.fromarray(spot_picture(40, 12)).save(tmp_path / "images" / "a.png")
    return tmp_path
