"""Composes docs/images/hollows.jpg: `python tools/make_hollow_picture.py BEFORE AFTER`.

Two finished and evaluated runs of one capture, without hollows and with them. A row a view: the photograph, the same
view of both runs, then a view under another light. `--split`, `--views` and `--out` choose.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "images" / "hollows.jpg"
SIDE, TITLE = 240, 26
COLUMNS = ("photograph", "with a lid", "hollow", "another light", "with a lid", "hollow")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("before", type=Path, help="run with --set initializer.hollows.max_hollows=0")
    parser.add_argument("after", type=Path, help="run with the default settings")
    parser.add_argument("--split", default="relight_0", help="the views under another light")
    parser.add_argument("--views", type=int, nargs="+", default=[3, 4])
    parser.add_argument("--out", type=Path, default=OUTPUT)
    given = parser.parse_args()
    for run, split in ((run, split) for run in (given.before, given.after) for split in ("test", given.split)):
        if not (run / "evaluation" / split).is_dir():
            parser.error(f"{run} was not evaluated; run: hir evaluate {run} --split {split}")
    sheet = Image.new("RGB", (len(COLUMNS) * SIDE, len(given.views) * SIDE + TITLE), (246, 245, 242))
    draw = ImageDraw.Draw(sheet)
    font = ImageFont.load_default(14)
    for i, name in enumerate(COLUMNS):
        draw.text((i * SIDE + 8, 5), name, fill=(70, 78, 96), font=font)
    for row, view in enumerate(given.views):
        for half, split in enumerate(("test", given.split)):
            files = [(given.after, "true"), (given.before, "fit"), (given.after, "fit")]
            for i, (run, kind) in enumerate(files):
                picture = Image.open(run / "evaluation" / split / f"{view:03d}_{kind}.png").convert("RGB")
                column = 3 * half + i
                sheet.paste(picture.resize((SIDE, SIDE), Image.Resampling.LANCZOS), (column * SIDE, TITLE + row * SIDE))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(given.out, quality=88)


if __name__ == "__main__":
    main()
