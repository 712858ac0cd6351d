"""One use of a component on small input: what contracts of every kind are checked on."""

from __future__ import annotations

import hashlib
import os
import random
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Exercise:
    """Input that is handed to a component, and the call that turns it into arrays."""

    inputs: Mapping[str, Any]
    run: Callable[[], Mapping[str, np.ndarray]]


def seeded(seed: int) -> None:
    """The generators that the core seeds before each stage."""
    random.seed(seed)
    np.random.seed(seed)
    if "torch" in sys.modules:
        sys.modules["torch"].manual_seed(seed)


def generator_states() -> dict[str, str]:
    """A hash of the state of each generator that the core seeds."""
    states: dict[str, object] = {"random": random.getstate(), "numpy.random": np.random.get_state()}
    if "torch" in sys.modules:
        states["torch"] = sys.modules["torch"].get_rng_state()
    return {name: digest(state) for name, state in states.items()}


def process_state() -> dict[str, object]:
    """Settings of the process that all components share."""
    state: dict[str, object] = {"the working directory": os.getcwd(), "numpy.geterr()": dict(np.geterr())}
    if "torch" in sys.modules:
        torch = sys.modules["torch"]
        state["torch.get_default_dtype()"] = torch.get_default_dtype()
        state["torch.get_num_threads()"] = torch.get_num_threads()
        state["torch.is_grad_enabled()"] = torch.is_grad_enabled()
        state["torch.are_deterministic_algorithms_enabled()"] = torch.are_deterministic_algorithms_enabled()
    return state


def digest(value: Any) -> str:
    """A hash of all that an input holds: tensors, arrays, nested dataclasses, the files of a folder."""
    state = hashlib.blake2b(digest_size=16)
    _feed(state, value)
    return state.hexdigest()


def _feed(state: Any, value: Any) -> None:
    if hasattr(value, "detach"):
        value = value.detach().cpu().numpy()
    if isinstance(value, np.ndarray):
        state.update(str((value.shape, value.dtype)).encode() + np.ascontiguousarray(value).tobytes())
    elif is_dataclass(value) and not isinstance(value, type):
        for field in fields(value):
            state.update(field.name.encode())
            _feed(state, getattr(value, field.name))
    elif isinstance(value, Mapping):
        for key in value:
            state.update(str(key).encode())
            _feed(state, value[key])
    elif isinstance(value, list | tuple):
        state.update(str(len(value)).encode())
        for item in value:
            _feed(state, item)
    elif isinstance(value, Path) and value.is_dir():
        for file in sorted(value.rglob("*")):
            state.update(str(file.relative_to(value)).encode())
            if file.is_file():
                state.update(file.read_bytes())
    elif isinstance(value, Path) and value.is_file():
        state.update(value.read_bytes())
    else:
        state.update(repr(value).encode() if not callable(value) else b"callable")
