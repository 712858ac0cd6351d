"""Captures made smaller, for studies of the number of views and of their size."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.images import read_ldr, write_png
from numpy.typing import NDArray

from hir_core.evaluation import spread

SPLITS = ("train", "test", "relight_0", "relight_1", "albedo_test")


def made_smaller(source: Path, folder: Path, views: int, side: int) -> Path:
    """A copy of a NeRF-synthetic capture with `views` train views, spread over its own, of at most `side` pixels.

    All other splits, lights and the true mesh stay whole but for their size. A folder that is there already is taken.
    """
    done = folder / "made.json"
    if done.is_file():
        return folder
    for split in SPLITS:
        path = source / f"transforms_{split}.json"
        if not path.is_file():
            continue
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if split == "train":
            document["frames"] = [document["frames"][i] for i in spread(len(document["frames"]), views)]
        for frame in document["frames"]:
            copy_picture(source, folder, frame, side)
        (folder / path.name).write_text(json.dumps(document, indent=1), encoding="utf-8")
    for other in (*source.glob("*.hdr"), *source.glob("reference.obj")):
        shutil.copy(other, folder / other.name)
    done.write_text(json.dumps({"source": source.name, "views": views, "side": side}), encoding="utf-8")
    return folder


def copy_picture(source: Path, folder: Path, frame: Mapping[str, Any], side: int) -> None:
    """One photograph, reduced by means of whole blocks of light."""
    name = Path(frame["file_path"]).with_suffix(".png")
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    picture = read_ldr(source / name)
    factor = picture.shape[0] // side
    if factor <= 1:
        shutil.copy(source / name, folder / name)
    else:
        write_png(folder / name, reduced(picture, factor))


def reduced(picture: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """sRGB with straight alpha (H, W, 4) at 1/`factor`: colours are averaged as light, each as far as it covers."""
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    blocks = picture[: height * factor, : width * factor].reshape(height, factor, width, factor, 4)
    alpha = blocks[..., 3:]
    light = (np.asarray(srgb_to_linear(blocks[..., :3])) * alpha).sum(axis=(1, 3))
    covered = alpha.sum(axis=(1, 3))
    color = linear_to_srgb(np.where(covered > 0, light / np.maximum(covered, 1e-9), 0.0))
    return np.concatenate([color, covered / factor**2], axis=2).astype(np.float32)
