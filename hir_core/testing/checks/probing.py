"""Contracts of all kinds that compute: inputs and process are not changed, seeds, threads and devices agree."""

from __future__ import annotations

import os
from collections.abc import Mapping
from importlib import import_module
from typing import Final

import numpy as np

from hir_core.testing.contract import NotApplicable, Subject, contract, require
from hir_core.testing.exercise import Exercise, digest, generator_states, process_state, seeded

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


@contract(*CHECK_MODULES, first=True)
def inputs_stay_as_they_are(subject: Subject) -> None:
    """Scenes, captures, masks and files are read, never changed: other code uses the same objects."""
    exercise = _exercise(subject)
    before = {name: digest(value) for name, value in exercise.inputs.items()}
    raised: Exception | None = None
    try:
        subject.memory.setdefault("exercised", _run(exercise))
        subject.memory.setdefault("generators after seed 0", generator_states())
    except Exception as error:
        raised = error
    changed = [name for name, value in exercise.inputs.items() if digest(value) != before[name]]
    require(
        not changed,
        f"the call changed its input: {', '.join(changed)}; change a copy, such as one of dataclasses.replace, and "
        "use no "
        "operation that writes into a tensor (those whose names end in _)",
    )
    if raised is not None:
        raise NotApplicable(f"the component raises {type(raised).__name__}, which another contract names") from raised


@contract(*CHECK_MODULES)
def process_stays_as_it_is(subject: Subject) -> None:
    """The component seeds no generator of `random`, numpy or torch, for the core and other components draw from them:
    after another seed they are in another state. It does not change the working directory, torch's number of threads or
    default type, or numpy's handling of errors.
    """
    exercise = _exercise(subject)
    if "generators after seed 0" not in subject.memory:
        _run(exercise)
        subject.memory["generators after seed 0"] = generator_states()
    seeded(1)
    before = process_state()
    try:
        exercise.run()
        after, generators = process_state(), generator_states()
    finally:
        _restore(before)
    equal = [name for name, state in generators.items() if state == subject.memory["generators after seed 0"][name]]
    require(
        not equal,
        f"the generator of {', '.join(equal)} is in one state whatever the seed was, so the component seeds it; "
        "draw from "
        "a generator of your own, such as torch.Generator().manual_seed(config.seed) with an option seed_of_run()",
    )
    changed = [f"{name} from {before[name]} to {after[name]}" for name in before if after[name] != before[name]]
    require(not changed, f"it changes {'; '.join(changed)}; put it back before the call returns")


def _restore(state: Mapping[str, object]) -> None:
    """What a component changed must not reach the next one."""
    os.chdir(str(state["the working directory"]))
    np.seterr(**state["numpy.geterr()"])  # type: ignore[arg-type]
    if "torch.get_default_dtype()" in state:
        import torch

        torch.set_default_dtype(state["torch.get_default_dtype()"])  # type: ignore[arg-type]
        torch.set_num_threads(int(str(state["torch.get_num_threads()"])))
        torch.set_grad_enabled(bool(state["torch.is_grad_enabled()"]))


@contract(*CHECK_MODULES)
def same_seed_same_result(subject: Subject) -> None:
    """With the generators of `random`, numpy and torch seeded alike, two uses give the same (to 1e-5)."""
    first = subject.memory.get("exercised") or _run(_exercise(subject))
    second = _run(_exercise(subject))
    advice = "two runs of one seed; something else than the seed decides, such as the time or the order of a set"
    for name, value in first.items():
        require(value.shape == second[name].shape, f"{name} has the shape {value.shape}, then {second[name].shape}")
        if value.dtype.kind == "f":
            size = float(np.abs(value).max()) if value.size else 0.0
            difference = float(np.abs(value - second[name]).max()) if value.size else 0.0
            require(difference <= 1e-5 * size, f"{name} differs by {difference:.3g} of {size:.3g} between {advice}")
        else:
            require((value == second[name]).all(), f"{name} differs between {advice}")


@contract(*ON_DEVICES)
def thread_counts_agree(subject: Subject) -> None:
    """With one thread of torch and with three the component gives the same (to 1e-3 of the largest value)."""
    import torch

    exercise, count = _exercise(subject), torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        first = _run(exercise)
        torch.set_num_threads(3)
        second = _run(exercise)
    finally:
        torch.set_num_threads(count)
    _require_agreement(first, second, "one thread and three; add up what threads compute in an order that is fixed")


@contract(*ON_DEVICES)
def devices_agree(subject: Subject) -> None:
    """On a CUDA device the component gives what it gives on the processor (to 1e-3 of the largest value)."""
    import torch

    if not torch.cuda.is_available():
        raise NotApplicable("torch sees no CUDA device here")
    if subject.has("stochastic"):
        raise NotApplicable("its noise differs between devices; agreement with the reference is checked instead")
    first, second = _run(_exercise(subject)), _run(_exercise(subject, "cuda"))
    _require_agreement(first, second, "processor and CUDA")


def _require_agreement(first: Mapping[str, np.ndarray], second: Mapping[str, np.ndarray], between: str) -> None:
    for name, value in first.items():
        size, difference = float(np.abs(value).max()), float(np.abs(value - second[name]).max())
        require(difference <= 1e-3 * size, f"{name} differs by {difference:.3g} of {size:.3g} between {between}")
