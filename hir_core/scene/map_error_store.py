"""Standard errors of maps on disk, beside the scene of their stage."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hir_core.errors import InputError
from hir_core.files.array_files import read_arrays, write_arrays
from hir_core.scene.map_errors import MapErrors

FILE = "map_errors.npz"
_MAP, _CONSTANT, _VARIATION = "map.", "constant.", "variation."


def save_map_errors(errors: MapErrors, folder: Path) -> None:
    """Writes them into the folder of the stage."""
    arrays: dict[str, NDArray[Any]] = {"base_color": errors.base_color, "condition": errors.condition}
    arrays |= {_MAP + name: values for name, values in errors.maps.items()}
    arrays |= {_CONSTANT + name: np.array([value], np.float64) for name, value in errors.constants.items()}
    arrays |= {_VARIATION + name: values for name, values in errors.variation.items()}
    write_arrays(folder / FILE, arrays)


def load_map_errors(folder: Path) -> MapErrors | None:
    """What `save_map_errors` wrote; None where the stage has none, `InputError` where the file is damaged."""
    if not (folder / FILE).exists():
        return None
    arrays = read_arrays(folder / FILE)
    try:
        constants = {name: float(each[0]) for name, each in _named(arrays, _CONSTANT).items()}
        maps, variation = _named(arrays, _MAP), _named(arrays, _VARIATION)
        return MapErrors(arrays["base_color"], maps, constants, arrays["condition"], variation)
    except (KeyError, IndexError) as error:
        raise InputError(f"{folder / FILE} is damaged ({error}); run without --resume") from error


def _named(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    """The arrays whose names begin with `prefix`, by the rest of their names."""
    return {name.removeprefix(prefix): each for name, each in arrays.items() if name.startswith(prefix)}
