"""The light of each take of a run, beside the scene of its reflectance stage. Read without torch, for `hir export`."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
from hir_exporters.textures.image_files import read_exr
from numpy.typing import NDArray

from hir_core.errors import InputError
from hir_core.files.json_documents import read_json

TAKES: Final = "takes"
"""Name of the entry of scene.json that lists the takes in the order of their files."""


def take_array_name(number: int) -> str:
    """Name of the array, and of the image, with the radiance of the light of a take; the first take is 0."""
    return f"take_{number}.radiance"


def read_take_lights(folder: Path) -> dict[str, NDArray[np.float32]]:
    """Radiance (H, W, 3) of the light of each take by its name, from the `scene` folder of a stage.

    Empty for a scene of one light and where there is no scene. `InputError` where a file is missing or damaged.
    """
    if not (folder / "scene.json").is_file():
        return {}
    lights = {}
    for number, name in enumerate(_take_names(read_json(folder / "scene.json"), folder)):
        path = folder / f"{take_array_name(number)}.exr"
        if not path.is_file():
            raise InputError(f"{folder} is not a complete scene of a stage ({path.name}); run without --resume")
        lights[name] = np.ascontiguousarray(read_exr(path, channels=3))
    return lights


def _take_names(document: dict[str, Any], folder: Path) -> list[str]:
    takes = document.get(TAKES, [])  # scenes of one light have none
    if not isinstance(takes, list) or not all(isinstance(name, str) for name in takes):
        raise InputError(
            f"{folder} is not a complete scene of a stage (its takes are no list of names); run without --resume"
        )
    return takes
