"""The grey card on a page to print."""

from __future__ import annotations

import math
from io import BytesIO
from pathlib import Path

import numpy as np
from hir_exporters.files.atomic import write_bytes_atomic

from hir_core.errors import InputError

PAPERS_MM = {"a4": (297.0, 210.0), "letter": (279.4, 215.9)}
"""Width and height, landscape."""
MARGIN_MM = 8.0
"""What printers leave blank."""
PIXELS_PER_SIDE = 600
"""Of a marker: a whole multiple of its eight cells, about 300 dots per inch."""
CAPTION = (
    "hir card. Print without scaling; the side of a black square is then {side:g} mm. Lay it flat beside the object."
)
CAPTION_PIXELS = 40


def side_of_markers(paper: str) -> float:
    """Side of a black square in metres: the largest whole millimetre with which the card fits on the paper."""
    from hir_plugins.initializers.markers.grey_card import HEIGHT, WIDTH

    width, height = PAPERS_MM[paper]
    return math.floor(min((width - 2 * MARGIN_MM) / WIDTH, (height - 2 * MARGIN_MM) / HEIGHT)) / 1000


def write_card(path: Path, paper: str) -> None:
    """Writes the page as .pdf or .png; `InputError` for another suffix or a folder that does not exist."""
    suffix = path.suffix.lower()
    if suffix not in (".pdf", ".png"):
        raise InputError(f"{path} must end in .pdf or .png; give another name with -o")
    if not path.parent.is_dir():
        raise InputError(f"the folder {path.parent} does not exist; create it or give another name with -o")
    from PIL import Image, ImageDraw, ImageFont

    from hir_plugins.initializers.markers.grey_card import GreyCard

    side = side_of_markers(paper)
    side_mm = 1000 * side
    width, height = (round(length / side_mm * PIXELS_PER_SIDE) for length in PAPERS_MM[paper])
    card = GreyCard(side).picture(PIXELS_PER_SIDE / side)
    page = np.full((height, width), 255, np.uint8)
    top, left = (height - card.shape[0]) // 2, (width - card.shape[1]) // 2
    page[top : top + card.shape[0], left : left + card.shape[1]] = card
    image = Image.fromarray(page)
    text = ImageDraw.Draw(image)
    text.text(
        (width / 2, height - top / 2),
        CAPTION.format(side=side_mm),
        fill=90,
        anchor="mm",
        font=ImageFont.load_default(CAPTION_PIXELS),
    )
    data = BytesIO()
    dots_per_inch = PIXELS_PER_SIDE / side_mm * 25.4
    if suffix == ".pdf":
        image.save(data, "PDF", resolution=dots_per_inch)
    else:
        image.save(data, "PNG", dpi=(dots_per_inch, dots_per_inch))
    write_bytes_atomic(path, data.getvalue())
