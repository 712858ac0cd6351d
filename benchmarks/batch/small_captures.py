"""Small captures, and settings with which each is reconstructed in seconds, for studies of batches."""

from __future__ import annotations

import json
from pathlib import Path

from PIL import Image

SAMPLE = Path(__file__).resolve().parents[2] / "examples" / "sample_capture"

SETTINGS = (
    "geometry.iterations=5",
    "geometry.levels=1",
    "geometry.triangles=1500",
    "geometry.photo_consistency=off",
    "atlas.texture_size=64",
    "reflectance.model=diffuse",
    "reflectance.light_frame=world",
    "reflectance.environment_height=8",
    "reflectance.environment_width=16",
    "initializer.visual_hull.max_resolution=48",
    "initializer.stereo.max_resolution=48",
    "reflectance_renderer.transport_ggx.steps=20",
    "reflectance_renderer.transport_ggx.cache_cells=500",
    "reflectance_renderer.transport_ggx.vertices=2000",
    "reflectance_renderer.transport_ggx.samples=4",
    "export=['glb']",
    "device=cpu",
)

SETTINGS_ARGUMENTS = [argument for setting in SETTINGS for argument in ("--set", setting)]
"""The settings as command-line arguments."""


def make_small_captures(folder: Path, count: int, views: int = 10, side: int = 64, broken: int = 0) -> list[Path]:
    """Captures `cow00`, `cow01`, …, each with other views of the sample capture at `side`² pixels.

    The last `broken` captures have a truncated photograph.
    """
    document = json.loads((SAMPLE / "transforms_train.json").read_text(encoding="utf-8"))
    frames, captures = document["frames"], []
    for i in range(count):
        capture = folder / f"cow{i:02}"
        (capture / "train").mkdir(parents=True)
        selected = [frames[(i + round(k * len(frames) / views)) % len(frames)] for k in range(views)]
        for frame in selected:
            name = Path(frame["file_path"]).with_suffix(".png")
            with Image.open(SAMPLE / name) as photograph:
                photograph.resize((side, side), Image.Resampling.BOX).save(capture / name)
        text = json.dumps(
            {key: value for key, value in document.items() if key != "environment"} | {"frames": selected}
        )
        (capture / "transforms_train.json").write_text(text, encoding="utf-8")
        captures.append(capture)
    for capture in captures[count - broken :]:
        file = min((capture / "train").iterdir())
        file.write_bytes(file.read_bytes()[:300])
    return captures
