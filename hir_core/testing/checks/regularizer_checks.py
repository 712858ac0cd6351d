"""Contracts of regularizers."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hir_core.errors import StageError
from hir_core.plugins.registration import a_value
from hir_core.testing.contract import BrokenContract, Subject, contract, require
from hir_core.testing.exercise import Exercise, seeded

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.scene import Scene

STEP = 1e-6
"""Of central differences in float64: their error is about 1e-9 of a smooth function's."""


def exercise(subject: Subject, device: str) -> Exercise:
    """Value and gradients on a scene of noise."""
    import torch

    from hir_core.testing.scenes import bumpy_scene

    scene = bumpy_scene().to(device)
    at = _moved(scene)

    def run() -> dict[str, np.ndarray]:
        with torch.no_grad():  # autograd refuses operations that write into a leaf; here they show in `at`
            subject.create().prepare(scene)(at)
        value, gradients = _value_and_gradients(subject, scene, at)
        return {"the value": value.cpu().numpy(), **{n: g.cpu().numpy() for n, g in gradients.items()}}

    return Exercise({"scene": scene, "the scene of a call": at}, run)


def _moved(scene: Scene, seed: int = 1) -> Scene:
    """The same triangles and textures a little elsewhere, as after some steps of a fit."""
    import torch

    from hir_core.testing.scenes import leaves, with_leaves

    generator = torch.Generator().manual_seed(seed)
    values = {}
    for name, leaf in leaves(scene).items():
        noise = torch.rand(leaf.shape, generator=generator, dtype=torch.float64).to(leaf)
        values[name] = leaf + 0.02 * noise
    return with_leaves(scene, values)


def _value_and_gradients(subject: Subject, start: Scene, at: Scene) -> tuple[Tensor, dict[str, Tensor]]:
    """The term prepared for `start` and its gradients at `at`, for every leaf that it depends on."""
    import torch

    from hir_core.testing.scenes import leaves, with_leaves

    tracked = {name: leaf.detach().clone().requires_grad_() for name, leaf in leaves(at).items()}
    value = subject.create().prepare(start)(with_leaves(at, tracked))
    if not (isinstance(value, torch.Tensor) and value.requires_grad):
        return value, {}
    found = torch.autograd.grad(value, list(tracked.values()), allow_unused=True)
    return value.detach(), {name: g for name, g in zip(tracked, found, strict=True) if g is not None}


def _require_function_of_the_scene(energy: object, scene: Scene) -> None:
    require(callable(energy), f"prepare returns {a_value(energy)}; return a function of the scene")
    assert callable(energy)
    try:
        inspect.signature(energy).bind(scene)
    except TypeError as error:
        raise BrokenContract(
            f"the function that prepare returns cannot be called with the scene alone: {error}; write def energy(scene)"
        ) from error
    except ValueError:
        return  # of a callable that is written in C


@contract("regularizer", first=True)
def term_is_a_finite_scalar(subject: Subject) -> None:
    """The term is a tensor without dimensions, finite, and at least 0 unless the trait `signed` is declared."""
    import torch

    from hir_core.testing.scenes import bumpy_scene

    for seed in range(4):
        scene = bumpy_scene(seed=seed)
        energy = subject.create().prepare(scene)
        _require_function_of_the_scene(energy, scene)
        value = energy(_moved(scene, seed + 10))
        require(isinstance(value, torch.Tensor), f"the term is {type(value).__name__}, not a tensor")
        require(value.ndim == 0, f"the term has the shape {tuple(value.shape)}; sum or average it to one number")
        require(
            torch.isfinite(value),
            f"the term is {float(value)} on a scene of noise; a division by 0, or a root or logarithm of a negative "
            "number "
            "gives this: clamp what goes into it",
        )
        if not subject.has("signed"):
            require(
                float(value) >= 0,
                f"the term is {float(value):.6g} on a scene of noise; it must be ≥ 0, or declare the trait 'signed'",
            )


@contract("regularizer", traits={"differentiable"}, unless={"stop_gradient"})
def gradient_is_that_of_the_value(subject: Subject) -> None:
    """In float64 the gradient agrees with central differences along random directions within 1e-4, for all that the
    term depends on: positions, textures, light.
    """
    import torch

    from hir_core.testing.scenes import bumpy_scene, leaves, with_leaves

    start = bumpy_scene(torch.float64)
    at = _moved(start)
    _, gradients = _value_and_gradients(subject, start, at)
    require(
        gradients,
        "the term is detached from the scene: it carries no gradient at all; .detach(), .item(), .numpy(), "
        "torch.tensor(…) "
        "and torch.no_grad() end a gradient",
    )
    values = leaves(at)
    energy = subject.create().prepare(start)
    generator = torch.Generator().manual_seed(3)
    moving = []
    for name, leaf in values.items():
        direction = torch.randn(leaf.shape, generator=generator, dtype=torch.float64) * float(leaf.abs().max())
        ends = []
        for sign in (1, -1):
            moved = {**values, name: leaf + sign * STEP * direction}
            seeded(0)
            ends.append(float(energy(with_leaves(at, moved))))
        difference = (ends[0] - ends[1]) / (2 * STEP)
        analytic = float((gradients[name] * direction).sum()) if name in gradients else 0.0
        rounding = 1e-15 * max(map(abs, ends)) / STEP
        moving.append(abs(difference) > 10 * rounding)
        require(
            abs(analytic - difference) <= 1e-4 * max(abs(difference), abs(analytic)) + 10 * rounding,
            f"along a random direction of {name} the gradient says {analytic:.8g}, differences {difference:.8g}; a "
            "part of "
            "the term is detached, or a backward() of your own is wrong",
        )
    require(any(moving), "nothing that a fit moves changes the term: neither positions nor textures nor light")


@contract("regularizer")
def traits_name_what_it_reads(subject: Subject) -> None:
    """A term that depends on a map of the material has the trait `material`, and one that depends on the light the
    trait `environment`: a solver shows a term only what its traits name. With its default options, a term that has one
    of these traits depends on material or light.
    """
    from hir_core.optimization.term_gradients import MAPS

    read = {"material": _read_parts(subject, MAPS), "environment": _read_parts(subject, ("radiance",))}
    for trait, parts in read.items():
        require(
            subject.has(trait) or not parts,
            f"it depends on {' and '.join(parts)} and lacks the trait {trait!r}, so that a solver would never show it "
            f"a change; add {trait!r} to traits",
        )
    declared = [trait for trait in read if subject.has(trait)]
    require(
        not declared or any(read.values()),
        f"it has the trait {' and '.join(map(repr, declared))}, and changes with neither material nor light; remove "
        "the trait",
    )


def _read_parts(subject: Subject, names: Sequence[str]) -> list[str]:
    """Those parts of a scene, of a dielectric or a metallic material, that change the value of the term."""
    import torch

    from hir_core.optimization.term_gradients import parts_of, with_parts
    from hir_core.testing.scenes import bumpy_scene, metallic

    found = []
    for start in (bumpy_scene(torch.float64), metallic(bumpy_scene(torch.float64))):
        energy = subject.create().prepare(start)
        at, elsewhere = _moved(start), _moved(start, 2)
        seeded(0)
        value = float(energy(at))
        for name, part in parts_of(elsewhere).items():
            seeded(0)
            if name in names and float(energy(with_parts(at, {name: part}))) != value:
                found.append(name)
    return sorted(set(found))


@contract("regularizer")
def linear_in_weight(subject: Subject) -> None:
    """The core multiplies the term by `weight`: three times the weight is three times the term, at each call. The
    options have no `weight` of their own, which would never arrive.
    """
    from hir_core.optimization.weighted_energies import prepare_energies
    from hir_core.run.stage_context import StageContext
    from hir_core.testing.scenes import bumpy_scene

    options = getattr(subject.component.config, "__dataclass_fields__", {})
    require("weight" not in options, "the options have a field 'weight'; the core takes that key for itself")
    scene, context = bumpy_scene(), StageContext(subject.plugins, Path())
    name, values = subject.component.name, []
    for weight in (1.0, 3.0):
        seeded(0)
        energies = prepare_energies(scene, {name: {**subject.options, "weight": weight}}, context.plugins)
        values.append([float(energies(_moved(scene))[name]) for _ in range(3)])
    once, thrice = values
    require(
        np.allclose(thrice, 3 * np.array(once), rtol=1e-4, atol=0) and np.allclose(once, once[0], rtol=1e-5, atol=0),
        f"with weight 1 three calls give {once}, with weight 3 {thrice}",
    )


@contract("regularizer", traits={"rigid_invariant"})
def rigid_motion_changes_nothing(subject: Subject) -> None:
    """Turning and moving mesh and start together leaves the term as it is (to 1e-6 in float64)."""
    for turned, value, plain in _transformed(subject, scale=1.0):
        require(
            abs(turned - plain) <= 1e-6 * abs(plain),
            f"the term is {plain:.8g}, {value} {turned:.8g}; measure from the scene itself, such as from its "
            "centre, not "
            "along the axes of the world, or remove the trait 'rigid_invariant'",
        )


@contract("regularizer", traits={"scale_invariant"})
def scale_changes_nothing(subject: Subject) -> None:
    """Scaling mesh and start together by a thousand either way leaves the term as it is (to 1e-6 in float64)."""
    for scale in (1e-3, 1e3):
        for scaled, value, plain in _transformed(subject, scale):
            require(abs(scaled - plain) <= 1e-6 * abs(plain), f"the term is {plain:.8g}, {value} {scaled:.8g}")


def _transformed(subject: Subject, scale: float) -> Iterator[tuple[float, str, float]]:
    import torch

    from hir_core.testing.scenes import bumpy_scene

    rotation = torch.linalg.qr(torch.randn(3, 3, generator=torch.Generator().manual_seed(5), dtype=torch.float64))[0]
    rotation = rotation * torch.sign(torch.linalg.det(rotation))
    push = torch.tensor([3.0, -2.0, 5.0], dtype=torch.float64) if scale == 1 else torch.zeros(3, dtype=torch.float64)
    how = "turned and moved" if scale == 1 else f"scaled by {scale:g}"
    start = bumpy_scene(torch.float64)
    at = _moved(start)

    def carried(scene: Scene) -> Scene:
        turned = scene.mesh.positions @ rotation.T if scale == 1 else scene.mesh.positions
        return replace(scene, mesh=scene.mesh.with_positions(scale * turned + push))

    seeded(0)
    plain = float(subject.create().prepare(start)(at))
    seeded(0)
    yield float(subject.create().prepare(carried(start))(carried(at))), how, plain


@contract("regularizer")
def smallest_on_its_ideal(subject: Subject) -> None:
    """On the scene that it documents as its ideal (`testing="module:function"`, `function(scene) -> scene`) the term
    is not larger than on any scene near it, and its gradient is finite.
    """
    import torch

    from hir_core.scene import Scene
    from hir_core.testing.scenes import bumpy_scene

    require(
        subject.testing is not None,
        "testing names no function; write one that returns the scene which the term "
        "likes best, such as a flat mesh or a constant texture",
    )
    assert subject.testing is not None
    ideal: Scene = subject.testing(bumpy_scene(torch.float64))
    require(isinstance(ideal, Scene), f"testing returns {a_value(ideal)}; return the scene that the term likes best")
    energy = subject.create().prepare(ideal)
    seeded(0)
    least = float(energy(ideal))
    require(np.isfinite(least), f"on its ideal the term is {least}")
    above = []
    for change, near in _near(subject, ideal, energy):
        seeded(0)
        value = float(energy(near))
        above.append(value > least)
        require(
            value >= least - 1e-9 * (1 + abs(least)),
            f"on its ideal the term is {least:.8g}, and {value:.8g} with {change}; let testing return the scene of "
            "the least value, or mend the term",
        )
    require(
        any(above),
        f"the term is {least:.8g} on its ideal and on every scene near it; where it is flat, take an ideal at the "
        "border, from "
        "which a small change raises it",
    )


def _near(subject: Subject, ideal: Scene, energy: Callable[[Scene], Tensor]) -> Iterator[tuple[str, Scene]]:
    """Scenes near the ideal, each with what was changed: noise in all, one part larger or smaller everywhere, and one
    part moved down its gradient.
    """
    import torch

    from hir_core.testing.scenes import leaves, with_leaves

    generator = torch.Generator().manual_seed(2)
    start = leaves(ideal)

    def allowed(name: str, value: Tensor) -> Tensor:
        return value if name == "positions" else value.clamp(min=1e-3, max=None if name == "radiance" else 1.0)

    slopes: dict[str, Tensor] = {}
    if subject.has("differentiable") and not subject.has("stop_gradient"):
        slopes = _value_and_gradients(subject, ideal, ideal)[1]
    for name, slope in slopes.items():
        bad = int((~torch.isfinite(slope)).sum())
        require(
            bad == 0,
            f"on its ideal {bad} values of the gradient by {name} are not finite, so that a fit that comes near it "
            "fails; a root, a norm or a division at 0 gives this: add a small number inside of the root, or clamp",
        )
    for size in (1e-3, 1e-2, 1e-1):
        noisy = {}
        for name, leaf in start.items():
            noise = torch.randn(leaf.shape, generator=generator, dtype=torch.float64).to(leaf)
            noisy[name] = allowed(name, leaf + size * noise)
        yield f"noise of {size:g} in all parts", with_leaves(ideal, noisy)
        for name, leaf in start.items():
            for sign in (1, -1):
                moved = allowed(name, leaf + sign * size)
                yield f"{name} changed by {sign * size:+g} everywhere", with_leaves(ideal, {**start, name: moved})
        for name, slope in slopes.items():
            longest = slope.abs().max()
            if longest > 0:
                moved = allowed(name, start[name] - size * slope / longest)
                yield f"{name} moved down its gradient by {size:g}", with_leaves(ideal, {**start, name: moved})


@contract("regularizer")
def hard_scenes_stay_finite(subject: Subject) -> None:
    """On degenerate meshes, extreme scales, textures of one texel, constant maps (at vertices too, with the trait
    `vertex_maps`), black materials and suns, value and gradients are finite. What a term cannot work on at all is a
    `StageError` that says what it needs.
    """
    import torch

    from hir_core.scene import Scene
    from hir_core.testing.scenes import constants_at_vertices, hard_scenes, sphere

    scenes = [*hard_scenes(), ("a mesh without material", Scene(sphere()))]
    if subject.has("vertex_maps"):
        scenes.append(("constant maps at vertices", constants_at_vertices()))
    for name, scene in scenes:
        try:
            value, gradients = _value_and_gradients(subject, scene, scene)
        except StageError as error:
            require(len(str(error)) > 20, f"on {name} it raises StageError({str(error)!r}), which says nothing")
            continue
        except Exception as error:
            require(False, f"on {name} it raises {type(error).__name__}: {error}")
            continue
        require(torch.isfinite(value).all(), f"on {name} the term is {float(value)}")
        for leaf, gradient in gradients.items():
            bad = int((~torch.isfinite(gradient)).sum())
            require(
                bad == 0,
                f"on {name} {bad} values of the gradient by {leaf} are not finite; a root, a norm or a division at 0 "
                "gives this: add a small number inside of the root, or clamp",
            )


@contract("regularizer", traits={"vertex_maps"})
def takes_maps_at_vertices(subject: Subject) -> None:
    """With maps (V, C) at the vertices of a mesh without texture coordinates the term is finite, and in float64 its
    gradient agrees with central differences within 1e-4.
    """
    import torch

    from hir_core.optimization.term_gradients import parts_of, value_and_gradients, with_parts
    from hir_core.scene import Mesh, Topology
    from hir_core.testing.scenes import bumpy_scene

    textured = bumpy_scene(torch.float64)
    assert textured.material is not None
    generator = torch.Generator().manual_seed(4)
    mesh = Mesh(textured.mesh.positions, Topology(textured.mesh.faces))
    count = len(mesh.positions)

    def noise(channels: int) -> Tensor:
        return 0.2 + 0.5 * torch.rand(count, channels, generator=generator, dtype=torch.float64)

    material = replace(textured.material, diffuse_albedo=noise(3), specular_albedo=noise(3), roughness=noise(1))
    scene = replace(textured, mesh=mesh, material=material)
    energy = subject.create().prepare(scene)
    changed = {name: part + 0.01 * noise(1)[0] for name, part in parts_of(scene).items()}
    value, gradients = value_and_gradients(energy, with_parts(scene, changed))
    require(torch.isfinite(value), f"with maps at vertices the term is {float(value)}")
    for name, gradient in gradients.items():
        direction = torch.randn(gradient.shape, generator=generator, dtype=torch.float64)
        ends = [
            float(energy(with_parts(scene, {**changed, name: changed[name] + sign * STEP * direction})))
            for sign in (1, -1)
        ]
        difference, analytic = (ends[0] - ends[1]) / (2 * STEP), float((gradient * direction).sum())
        rounding = 1e-15 * max(map(abs, ends)) / STEP
        require(
            abs(analytic - difference) <= 1e-4 * max(abs(difference), abs(analytic)) + 10 * rounding,
            f"with maps at vertices the gradient by {name} says {analytic:.8g}, differences {difference:.8g}",
        )


@contract("regularizer", traits={"lagged"})
def near_has_value_and_gradient_of_the_term(subject: Subject) -> None:
    """Where `prepare` returns an object with `near`, `near(scene)` has the value (to 1e-6) and the gradient (to 1e-4)
    of the term at that scene, in float64, and both are finite elsewhere.
    """
    import torch

    from hir_core.optimization.term_gradients import parts_of, value_and_gradients
    from hir_core.testing.scenes import bumpy_scene

    start = bumpy_scene(torch.float64)
    energy = subject.create().prepare(start)
    if not hasattr(energy, "near"):
        return
    at = _moved(start)
    seeded(0)
    approximation = energy.near(at)
    seeded(0)
    value, gradients = value_and_gradients(energy, at)
    near_value, near_gradients = value_and_gradients(approximation, at)
    require(
        torch.isfinite(near_value) and abs(near_value - value) <= 1e-6 * abs(value),
        f"the term is {float(value):.8g}, its `near` at the same scene {float(near_value):.8g}",
    )
    for name, part in parts_of(at).items():
        exact = gradients.get(name, torch.zeros_like(part))
        error = (near_gradients.get(name, torch.zeros_like(part)) - exact).norm()
        share = float(error / exact.norm().clamp_min(1e-30))
        require(
            error <= 1e-4 * exact.norm(),
            f"the gradient of `near` by {name} differs from the term's by {share:.3g} of its length at the scene for "
            "which it was made; a part of `near` is detached, or linear around other values",
        )
    moved_value, moved_gradients = value_and_gradients(approximation, _moved(at, 2))
    require(
        torch.isfinite(moved_value) and all(bool(torch.isfinite(g).all()) for g in moved_gradients.values()),
        "`near` is not finite a little beside the scene for which it was made",
    )
