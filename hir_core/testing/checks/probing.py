"""Contracts of all kinds that compute: inputs are not changed, results depend on the seed, devices agree."""

from __future__ import annotations

from importlib import import_module
from typing import Final

import numpy as np

from hir_core.testing.contract import NotApplicable, Subject, contract, require
from hir_core.testing.exercise import Exercise, digest, seeded

CHECK_MODULES: Final = {
    "capture_reader": "capture_reader_checks",
    "mask_source": "mask_source_checks",
    "initializer": "initializer_checks",
    "geometry_renderer": "geometry_renderer_checks",
    "reflectance_renderer": "reflectance_renderer_checks",
    "regularizer": "regularizer_checks",
}
ON_DEVICES: Final = ("geometry_renderer", "reflectance_renderer", "regularizer")


def _exercise(subject: Subject, device: str = "cpu") -> Exercise:
    module = import_module(f"hir_core.testing.checks.{CHECK_MODULES[subject.kind]}")
    exercise: Exercise = module.exercise(subject, device)
    return exercise


def _run(exercise: Exercise) -> dict[str, np.ndarray]:
    seeded(0)
    return {name: np.asarray(value) for name, value in exercise.run().items()}


@contract(*CHECK_MODULES)
def inputs_stay_as_they_are(subject: Subject) -> None:
    """Scenes, captures, masks and files are read, never changed: other code uses the same objects."""
    exercise = _exercise(subject)
    before = {name: digest(value) for name, value in exercise.inputs.items()}
    subject.memory.setdefault("exercised", _run(exercise))
    changed = [name for name, value in exercise.inputs.items() if digest(value) != before[name]]
    require(not changed, f"the call changed its input: {', '.join(changed)}")


@contract(*CHECK_MODULES)
def same_seed_same_result(subject: Subject) -> None:
    """With the generators of `random`, numpy and torch seeded alike, two uses give the same (to 1e-5)."""
    first = subject.memory.get("exercised") or _run(_exercise(subject))
    second = _run(_exercise(subject))
    for name, value in first.items():
        require(value.shape == second[name].shape, f"{name} has the shape {value.shape}, then {second[name].shape}")
        if value.dtype.kind == "f":
            size = float(np.abs(value).max()) if value.size else 0.0
            difference = float(np.abs(value - second[name]).max()) if value.size else 0.0
            require(
                difference <= 1e-5 * size,
                f"{name} differs by {difference:.3g} of {size:.3g} between two runs of one seed",
            )
        else:
            require((value == second[name]).all(), f"{name} differs between two runs of one seed")


@contract(*ON_DEVICES)
def devices_agree(subject: Subject) -> None:
    """On a CUDA device the component gives what it gives on the processor (to 1e-3 of the largest value)."""
    import torch

    if not torch.cuda.is_available():
        raise NotApplicable("torch sees no CUDA device here")
    if subject.has("stochastic"):
        raise NotApplicable("its noise differs between devices; agreement with the reference is checked instead")
    first, second = _run(_exercise(subject)), _run(_exercise(subject, "cuda"))
    for name, value in first.items():
        size, difference = float(np.abs(value).max()), float(np.abs(value - second[name]).max())
        require(
            difference <= 1e-3 * size, f"{name} differs by {difference:.3g} of {size:.3g} between processor and CUDA"
        )
