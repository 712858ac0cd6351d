"""Copies a capture in the format of NeRF's synthetic scenes; each training photograph gets an exposure of its own.

    python -m benchmarks.changed_exposures CAPTURE OUTPUT [--stops 1] [--white-balance 0.15] [--record] [--seed 0]

Brightness changes by a factor of 2^(-stops…stops), red and blue by 1 ± white_balance; what exceeds 1 is clipped. With
`--record` the exposure time that belongs to the brightness stands in the EXIF data. Other splits stay as they are.
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.textures.pillow_images import open_image
from PIL import Image

EXIF_TABLE = 0x8769
F_NUMBER, ISO, SECONDS = 8.0, 100, 1 / 60
"""In the EXIF data of a photograph whose brightness does not change."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("output", type=Path)
    parser.add_argument("--stops", type=float, default=1.0, help="largest change of brightness")
    parser.add_argument("--white-balance", type=float, default=0.15, help="largest change of red and blue")
    parser.add_argument("--record", action="store_true", help="write exposure times into EXIF data")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    shutil.copytree(given.capture, given.output)
    document = json.loads((given.output / "transforms_train.json").read_text())
    rng = np.random.default_rng(given.seed)
    factors = {}
    for frame in document["frames"]:
        path = given.output / frame["file_path"]
        path = path if path.suffix else path.with_suffix(".png")
        brightness = float(np.exp2(rng.uniform(-given.stops, given.stops)))
        red, blue = 1 + rng.uniform(-given.white_balance, given.white_balance, 2)
        factors[path.name] = [brightness * red, brightness, brightness * blue]
        _change(path, np.array(factors[path.name]), SECONDS * brightness if given.record else None)
    (given.output / "factors.json").write_text(json.dumps(factors, indent=1))


def _change(path: Path, factors: np.ndarray, seconds: float | None) -> None:
    with open_image(path) as image:
        pixels = np.asarray(image).astype(np.float32) / 255
    pixels[..., :3] = linear_to_srgb(np.clip(srgb_to_linear(pixels[..., :3]) * factors, 0, 1))
    changed = Image.fromarray(np.round(pixels * 255).astype(np.uint8))
    exif = Image.Exif()
    if seconds is not None:
        exif[EXIF_TABLE] = {0x829A: seconds, 0x829D: F_NUMBER, 0x8827: ISO}
    changed.save(path, exif=exif)


if __name__ == "__main__":
    main()
