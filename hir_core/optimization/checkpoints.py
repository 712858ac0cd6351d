"""The state of an optimisation on disk: plain arrays, complete or not there, read back bit for bit."""

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
    """What a loop changes beside its parameters and must find again after an interruption."""

    def state(self) -> Arrays:
        """All of it, as arrays."""
        ...

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Takes over what `state` gave."""
        ...


class Together:
    """Several as one."""

    def __init__(self, **parts: Stateful) -> None:
        self._parts = parts

    def state(self) -> Arrays:
        """The state of every part, under its name."""
        return {f"{name}/{key}": value for name, part in self._parts.items() for key, value in part.state().items()}

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Gives every part what is its."""
        for name, part in self._parts.items():
            part.restore(below(state, name))


def save_checkpoint(
    path: Path, optimizer: torch.optim.Optimizer, step: int, more: Mapping[str, NDArray[Any]] | None = None
) -> None:
    """Writes parameters, the optimizer's state, torch's random numbers, the next step and `more`."""
    arrays: Arrays = {"step": np.asarray(step), "random": torch.get_rng_state().numpy()}
    arrays |= {f"more/{name}": value for name, value in (more or {}).items()}
    for i, parameter in enumerate(parameters_of(optimizer)):
        arrays[f"parameter/{i}"] = parameter.detach().cpu().numpy()
        for name, value in optimizer.state.get(parameter, {}).items():
            arrays[f"state/{i}/{name}"] = (
                value.detach().cpu().numpy() if isinstance(value, Tensor) else np.asarray(value)
            )
    write_arrays(path, arrays)


def load_checkpoint(path: Path, optimizer: torch.optim.Optimizer) -> tuple[int, Arrays] | None:
    """Restores what `save_checkpoint` wrote; the next step and `more`. None, with nothing changed, where none fits."""
    arrays = read_arrays(path)
    parameters = parameters_of(optimizer)
    shapes = [arrays[f"parameter/{i}"].shape for i in range(len(parameters)) if f"parameter/{i}" in arrays]
    if not {"step", "random"} <= set(arrays) or shapes != [tuple(p.shape) for p in parameters]:
        return None
    for i, parameter in enumerate(parameters):
        with torch.no_grad():
            parameter.copy_(torch.from_numpy(arrays[f"parameter/{i}"]))
        state: dict[str, Any] = {}
        for name, array in below(arrays, f"state/{i}").items():
            value = torch.from_numpy(np.array(array))
            # Adam keeps its count of steps on the CPU
            state[name] = value if value.ndim == 0 else value.to(parameter.device)
        if state:
            optimizer.state[parameter] = state
    torch.set_rng_state(torch.from_numpy(arrays["random"].copy()))
    return int(arrays["step"]), below(arrays, "more")


def write_arrays(path: Path, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Named arrays into one file, which is complete or not there."""
    with atomic_write(path) as stream:
        np.savez(stream, **arrays)  # type: ignore[arg-type]


def read_arrays(path: Path) -> Arrays:
    """What `write_arrays` wrote; nothing where there is no such file or it is damaged."""
    try:
        return array_files.read_arrays(path)
    except InputError:
        return {}


def below(arrays: Mapping[str, NDArray[Any]], name: str) -> Arrays:
    """The arrays whose names begin with `name/`, without that."""
    return {key[len(name) + 1 :]: value for key, value in arrays.items() if key.startswith(f"{name}/")}


def parameters_of(optimizer: torch.optim.Optimizer) -> list[Tensor]:
    """All that it moves."""
    return [p for group in optimizer.param_groups for p in group["params"]]
