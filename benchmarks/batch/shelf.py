"""A shelf of small captures, and settings with which each takes seconds: for what is about batches, not about fits."""

from __future__ import annotations

import json
from pathlib import Path

from PIL import Image

SAMPLE = Path(__file__).resolve().parents[2] / "examples" / "sample_capture"

SETTINGS = (
    "geometry.iterations=5",
    "geometry.levels=1",
    "geometry.triangles=1500",
    "geometry.photographs=off",
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

WORDS = [word for setting in SETTINGS for word in ("--set", setting)]
"""The same for the command line."""


def small_captures(folder: Path, count: int, views: int = 10, side: int = 64, broken: int = 0) -> list[Path]:
    """Captures `cow00`, `cow01`, …: other views of the sample capture each, `side`² pixels; the last `broken` ones have
    a photograph that is cut off.
    """
    document = json.loads((SAMPLE / "transforms_train.json").read_text(encoding="utf-8"))
    frames, made = document["frames"], []
    for i in range(count):
        capture = folder / f"cow{i:02}"
        (capture / "train").mkdir(parents=True)
        chosen = [frames[(i + round(k * len(frames) / views)) % len(frames)] for k in range(views)]
        for frame in chosen:
            name = Path(frame["file_path"]).with_suffix(".png")
            with Image.open(SAMPLE / name) as photograph:
                photograph.resize((side, side), Image.Resampling.BOX).save(capture / name)
        text = json.dumps({key: value for key, value in document.items() if key != "environment"} | {"frames": chosen})
        (capture / "transforms_train.json").write_text(text, encoding="utf-8")
        made.append(capture)
    for capture in made[count - broken :]:
        photograph = min((capture / "train").iterdir())
        photograph.write_bytes(photograph.read_bytes()[:300])
    return made
