"""A capture small enough that a whole run takes seconds, and a run of it that several tests look at."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hir_exporters.textures.image_files import read_ldr, write_png

from hir_core.pipeline import Run, reconstruct

SAMPLE = Path(__file__).resolve().parents[2] / "examples" / "sample_capture"

QUICK = (
    "geometry.iterations=20",
    "geometry.levels=1",
    "geometry.triangles=1500",
    "atlas.texture_size=64",
    "reflectance.model=diffuse",
    "reflectance.light_frame=world",
    "reflectance.environment_height=8",
    "reflectance.environment_width=16",
    "initializer.visual_hull.max_resolution=48",
    "initializer.stereo.max_resolution=48",
    "reflectance_renderer.transport_ggx.steps=20",
    "reflectance_renderer.transport_ggx.cells=500",
    "reflectance_renderer.transport_ggx.vertices=2000",
    "reflectance_renderer.transport_ggx.samples=4",
)
"""Settings that are fast rather than good."""


def make_tiny(folder: Path, train: int = 10, test: int = 2) -> Path:
    """Every fourth pixel of a few views of the sample capture, with its lights."""
    for split, count in (("train", train), ("test", test), ("relight_0", 1)):
        document = json.loads((SAMPLE / f"transforms_{split}.json").read_text())
        frames = document["frames"]
        document["frames"] = [frames[round(i * (len(frames) - 1) / max(count - 1, 1))] for i in range(count)]
        (folder / split).mkdir(parents=True)
        for frame in document["frames"]:
            name = Path(frame["file_path"]).with_suffix(".png")
            picture = read_ldr(SAMPLE / name)
            blocks = picture.reshape(64, 4, 64, 4, 4)
            write_png(folder / name, blocks.mean(axis=(1, 3)).astype(np.float32))
        (folder / f"transforms_{split}.json").write_text(json.dumps(document))
    for light in SAMPLE.glob("*.hdr"):
        shutil.copy(light, folder / light.name)
    (folder / "reference.obj").write_text("v 0 0 0\n")
    return folder


@pytest.fixture(scope="session")
def tiny_capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """10 + 2 views of 64×64; tests must not change it."""
    return make_tiny(tmp_path_factory.mktemp("captures") / "tiny")


@pytest.fixture(scope="session")
def quick() -> Callable[..., Run]:
    """`reconstruct` with the quick settings."""

    def run(capture: Path, folder: Path, *assignments: str, **more: object) -> Run:
        return reconstruct(capture, folder, assignments=(*QUICK, *assignments), device="cpu", **more)  # type: ignore[arg-type]

    return run


@pytest.fixture(scope="session")
def finished(tiny_capture: Path, tmp_path_factory: pytest.TempPathFactory, quick: Callable[..., Run]) -> Run:
    """A finished run; tests must not change it."""
    return quick(tiny_capture, tmp_path_factory.mktemp("runs") / "tiny", deterministic=True)
