"""The state of an optimisation on disk: plain arrays, written atomically, read back bit for bit."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from hir_exporters.files.atomic import atomic_write
from numpy.typing import NDArray
from torch import Tensor

from hir_core.errors import InputError
from hir_core.files import array_files

Arrays = dict[str, NDArray[Any]]


class Stateful(Protocol):
    """What a loop changes besides its parameters, and must restore after an interruption."""

    def state(self) -> Arrays:
        """The state as named arrays."""
        ...

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Sets the state to what `state` returned."""
        ...


class CombinedState:
    """Several states as one."""

    def __init__(self, **parts: Stateful) -> None:
        self._parts = parts

    def state(self) -> Arrays:
        """The arrays of every part, with its name as prefix."""
        return {f"{name}/{key}": value for name, part in self._parts.items() for key, value in part.state().items()}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Restores every part from the arrays with its prefix."""
        for name, part in self._parts.items():
            part.restore(arrays_under(state, name))


def save_checkpoint(
    path: Path, optimizer: torch.optim.Optimizer, step: int, extra: Mapping[str, NDArray[Any]] | None = None
) -> None:
    """Writes parameters, the optimizer's state, the state of torch's random generator, the next step and `extra`."""
    arrays: Arrays = {"step": np.asarray(step), "random": torch.get_rng_state().numpy()}
    arrays |= {f"extra/{name}": value for name, value in (extra or {}).items()}
    for i, parameter in enumerate(optimized_tensors(optimizer)):
        arrays[f"parameter/{i}"] = parameter.detach().cpu().numpy()
        for name, value in optimizer.state.get(parameter, {}).items():
            arrays[f"state/{i}/{name}"] = (
                value.detach().cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)
            )
    write_arrays(path, arrays)


def load_checkpoint(path: Path, optimizer: torch.optim.Optimizer) -> tuple[int, Arrays] | None:
    """Restores what `save_checkpoint` wrote; returns the next step and `extra`.

    Returns None and changes nothing if there is no checkpoint, if it is damaged or if its shapes differ.
    """
    arrays = read_arrays(path)
    parameters = optimized_tensors(optimizer)
    shapes = [arrays[f"parameter/{i}"].shape for i in range(len(parameters)) if f"parameter/{i}" in arrays]
    if not {"step", "random"} <= set(arrays) or shapes != [tuple(p.shape) for p in parameters]:
        return None
    for i, parameter in enumerate(parameters):
        with torch.no_grad():
            parameter.copy_(torch.from_numpy(arrays[f"parameter/{i}"]))
        state: dict[str, Any] = {}
        for name, array in arrays_under(arrays, f"state/{i}").items():
            value = torch.from_numpy(np.array(array))
            # Adam stores its step count on the CPU
            state[name] = value if value.ndim == 0 else value.to(parameter.device)
        if state:
            optimizer.state[parameter] = state
    torch.set_rng_state(torch.from_numpy(arrays["random"].copy()))
    return int(arrays["step"]), arrays_under(arrays, "extra")


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Writes named arrays into one file, atomically."""
    with atomic_write(path) as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def read_arrays(path: Path) -> Arrays:
    """What `write_arrays` wrote; empty if the file is missing or damaged."""
    try:
        return array_files.read_arrays(path)
    except InputError:
        return {}


def arrays_under(arrays: Mapping[str, NDArray[Any]], prefix: str) -> Arrays:
    """The arrays whose names begin with `prefix/`, without the prefix."""
    return {key[len(prefix) + 1 :]: value for key, value in arrays.items() if key.startswith(f"{prefix}/")}


def optimized_tensors(optimizer: torch.optim.Optimizer) -> list[Tensor]:
    """All tensors that an optimizer changes."""
    return [p for group in optimizer.param_groups for p in group["params"]]
