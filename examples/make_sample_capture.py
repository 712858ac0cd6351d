"""Makes examples/sample_capture: fewer and smaller views of a NeRF-synthetic style capture, with smaller lights.

python examples/make_sample_capture.py CAPTURE DESTINATION
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from hir_exporters.conventions import latlong_solid_angles, linear_to_srgb, srgb_to_linear
from hir_exporters.textures.image_files import encode_png, quantize, read_hdr, read_ldr, write_hdr
from numpy.typing import NDArray

SPLITS = {"train": 24, "test": 6, "relight_0": 2}
SIZE = 256
LIGHT = (64, 128)


def spread(places: NDArray[np.float64], count: int) -> list[int]:
    """Indices of `count` positions by farthest-point sampling, starting at the highest."""
    chosen = [int(places[:, 2].argmax())]
    while len(chosen) < count:
        distance = np.linalg.norm(places[:, None] - places[chosen][None], axis=2).min(axis=1)
        chosen.append(int(distance.argmax()))
    return sorted(chosen)


def block_mean(image: NDArray[np.floating], factor: int) -> NDArray[np.floating]:
    height, width = image.shape[0] // factor, image.shape[1] // factor
    return image.reshape(height, factor, width, factor, -1).mean(axis=(1, 3))


def shrink_picture(pixels: NDArray[np.float32], size: int) -> NDArray[np.float64]:
    """Averages colour times coverage in linear light: no dark edges, no background in the colour."""
    factor = pixels.shape[0] // size
    alpha = block_mean(pixels[..., 3:].astype(np.float64), factor)
    premultiplied = block_mean(srgb_to_linear(pixels[..., :3].astype(np.float64)) * pixels[..., 3:], factor)
    straight = np.where(alpha > 0, premultiplied / np.where(alpha > 0, alpha, 1), 0)
    return np.concatenate([linear_to_srgb(straight), alpha], axis=2)


def shrink_light(radiance: NDArray[np.float32], height: int, width: int) -> NDArray[np.float64]:
    """Means over solid angle: the light of each block of pixels is kept."""
    weights = np.broadcast_to(latlong_solid_angles(*radiance.shape[:2]), radiance.shape[:2])[..., None]
    factor = radiance.shape[0] // height
    assert radiance.shape[:2] == (height * factor, width * factor)
    return block_mean(radiance * weights, factor) / block_mean(weights, factor)


def main(source: Path, destination: Path) -> None:
    lights: dict[bytes, str] = {}
    destination.mkdir(parents=True, exist_ok=True)
    for split, count in SPLITS.items():
        table = json.loads((source / f"transforms_{split}.json").read_text())
        places = np.array([frame["transform_matrix"] for frame in table["frames"]])[:, :3, 3]
        table["frames"] = [table["frames"][i] for i in spread(places, count)]
        (destination / split).mkdir(exist_ok=True)
        for frame in table["frames"]:
            pixels = shrink_picture(read_ldr(source / (frame["file_path"] + ".png")), SIZE)
            (destination / (frame["file_path"] + ".png")).write_bytes(encode_png(quantize(pixels)))
        light = source / table["environment"]["file_path"]
        # splits under the same light name one file, because another name would mean another light
        name = lights.setdefault(light.read_bytes(), light.name)
        write_hdr(destination / name, shrink_light(read_hdr(light), *LIGHT))
        table["environment"]["file_path"] = name
        (destination / f"transforms_{split}.json").write_text(json.dumps(table, indent=1) + "\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
