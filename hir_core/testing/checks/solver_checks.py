"""Contracts of solvers, which fit material and light by a method of their own."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from hir_core.testing.checks.reflectance_samples import SIZE, capture_of, mean_over_seeds, pixel_grid
from hir_core.testing.contract import Subject, contract, require
from hir_core.testing.exercise import seeded

if TYPE_CHECKING:
    from torch import Tensor

    from hir_core.capture import Capture
    from hir_core.plugins.interfaces import ReflectanceSolver
    from hir_core.plugins.model_spec import ModelSpec
    from hir_core.scene import Scene


@contract("reflectance_renderer", traits={"solver"}, slow=True)
def fits_depend_on_their_arguments(subject: Subject) -> None:
    """Six photographs of a matt sphere. A short fit has the same errors (0.1 %) when it is the first, after a fit of
    another model, and, where `concurrent_fits` is true, beside that fit on another thread. `errors` and
    `errors_between_lights`, where it is not None, are one finite number, not negative, for each view, in their order.
    """
    from hir_core.plugins.model_spec import ModelSpec
    from hir_core.scene import Scene
    from hir_core.testing.scenes import constant_material, looking_at, sphere, uneven_light

    scene = Scene(sphere(24, 36), constant_material("paper", 0.4, 0.0, 0.5), uneven_light(16))
    angles = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    capture = capture_of([looking_at((4 * np.sin(a), np.cos(2 * a), 4 * np.cos(a)), SIZE) for a in angles])
    photographs = _exposed(subject, scene, capture, np.ones((6, 3)))
    training, held_out = range(4), [4, 5]

    def prepared() -> ReflectanceSolver[Any, Any]:
        seeded(0)
        return subject.create().prepare(scene, photographs)  # type: ignore[no-any-return]

    def judged(solver: ReflectanceSolver[Any, Any], spec: ModelSpec, views: Sequence[int] = held_out) -> np.ndarray:
        fit = solver.fit(spec, None, training, 0.2, lambda share: None)
        errors, between_lights = solver.errors(fit, views), solver.errors_between_lights(fit, views)
        found = {"errors": errors, "errors_between_lights": errors if between_lights is None else between_lights}
        for name, values in found.items():
            require(np.shape(values) == (len(views),), f"`{name}` of {len(views)} views: {np.shape(values)}")
            require(bool((np.isfinite(values) & (values >= 0)).all()), f"`{name}` are {np.asarray(values).tolist()}")
        return np.concatenate(list(found.values()))

    solver = prepared()
    admitted = [solver.supported(ModelSpec(light_frame=frame)) for frame in ("world", "camera")]  # type: ignore[arg-type]
    first, *others = [spec for spec in admitted if spec is not None]
    alone = judged(solver, first)
    turned = judged(solver, first, held_out[::-1])
    require(
        np.allclose(turned.reshape(2, 2)[:, ::-1].ravel(), alone, rtol=1e-3),
        f"errors of views in reverse order are {turned.tolist()}, in order {alone.tolist()}",
    )
    for other in others:
        solver = prepared()
        judged(solver, other)
        after = judged(solver, first)
        require(
            np.allclose(after, alone, rtol=1e-3),
            f"after a fit of {other.name!r} the errors are {after.tolist()}, alone {alone.tolist()}",
        )
        if solver.concurrent_fits:
            solver = prepared()
            with ThreadPoolExecutor(2) as threads:
                beside, _ = threads.map(partial(judged, solver), (first, other))
            require(
                np.allclose(beside, alone, rtol=1e-3),
                f"beside a fit of {other.name!r} the errors are {beside.tolist()}, alone {alone.tolist()}; let "
                "`concurrent_fits` be False",
            )


@contract("reflectance_renderer", traits={"solver", "exposures"}, slow=True)
def exposures_are_fitted(subject: Subject) -> None:
    """Of eight photographs of a matt sphere, with brightness from 0.6 to 1.5 and different white balance, a model with
    fitted exposures finds the factors (15 %), and one with `recorded` exposures takes `View.recorded_exposure`. A
    photograph that the fit did not use is compared at the factors that suit it: its error is below a quarter of that
    with equal exposures. `exposures` of a fit, where they are not None, are the factors that it found.
    """
    from hir_core.plugins.model_spec import ModelSpec
    from hir_core.scene import Scene
    from hir_core.testing.scenes import constant_material, looking_at, sphere, uneven_light

    material, light = constant_material("paper", 0.4, 0.0, 0.5), uneven_light(16)
    scene = Scene(sphere(24, 36), material, light)
    angles = np.linspace(0, 2 * np.pi, 8, endpoint=False)
    heights = np.array([1.0, -1.0, 2.0, 0.0, 1.5, -0.5, 2.5, 0.5])
    capture = capture_of(
        [looking_at((4 * np.sin(a), y, 4 * np.cos(a)), SIZE) for a, y in zip(angles, heights, strict=True)]
    )
    brightness = np.array([1.0, 1.4, 0.7, 1.2, 0.6, 1.5, 0.9, 1.1])
    balance = np.array([[1.1, 1, 0.9], [0.9, 1, 1.1]])[[0, 1, 1, 0, 0, 1, 0, 1]]

    factors = brightness[:, None] * balance
    everything = range(len(factors))

    def solved(kind: str, given: np.ndarray, views: Sequence[int]) -> tuple[ReflectanceSolver[Any, Any], Any]:
        solver = subject.create().prepare(scene, _exposed(subject, scene, capture, given))
        seeded(0)
        spec = ModelSpec(exposures=kind)  # type: ignore[arg-type]
        return solver, solver.fit(spec, None, views, 1.0, lambda share: None)

    for kind, given in (("fitted", factors), ("recorded", brightness[:, None] * np.ones(3))):
        solver, fit = solved(kind, given, everything)
        exposures = solver.scene(fit, everything, lambda share: None).exposures
        require(exposures is not None, f"`Solved.exposures` is None for {kind} exposures")
        assert exposures is not None
        worst = _furthest(exposures.detach().cpu().double().numpy(), given)
        require(worst < 0.15, f"with {kind} exposures a factor is {100 * worst:.0f} % from the true one")
    errors = {}
    for kind in ("equal", "fitted"):
        used = everything[:-1]
        solver, fit = solved(kind, factors, used)
        errors[kind] = float(solver.errors(fit, [everything[-1]])[0])
        found = solver.exposures(fit, used)
        if kind == "equal":
            require(found is None, "`exposures` of a fit with equal exposures are not None")
        elif found is not None:
            require(np.shape(found) == (len(used), 3), f"`exposures` of {len(used)} views: {np.shape(found)}")
            worst = _furthest(found, factors[: len(used)])
            require(worst < 0.15, f"`exposures` of a fit: a factor is {100 * worst:.0f} % from the true one")
    require(
        errors["fitted"] < errors["equal"] / 4,
        f"the error of a photograph that was not used is {errors['fitted']:.2e} with fitted exposures, "
        f"{errors['equal']:.2e} with equal ones",
    )


def _furthest(factors: np.ndarray, true: np.ndarray) -> float:
    """The largest relative error of factors, whose mean brightness and white balance are free."""
    difference = np.log(factors) - np.log(true)
    return float(np.abs(np.expm1(difference - difference.mean(axis=0))).max())


@contract("reflectance_renderer", traits={"solver", "takes"}, slow=True)
def each_take_has_its_light(subject: Subject) -> None:
    """A sphere is photographed in two takes, under two lights whose bright sides and colours differ. The photographs of
    both takes are explained with an error below a tenth of that of the same photographs without takes, and each light
    of `Scene.take_radiance` is nearer to the true light of its take than to the other one.
    """
    from hir_core.plugins.model_spec import ModelSpec
    from hir_core.scene import Scene
    from hir_core.testing.captures import StoredPixels
    from hir_core.testing.scenes import constant_material, looking_at, sphere, uneven_light

    first = uneven_light(16)
    tint = first.radiance.new_tensor([1.3, 1.0, 0.6])
    second = replace(first, radiance=first.radiance.roll(16, dims=1).flip(0) * tint)
    lights = {"standing": first, "upside down": second}
    scene = Scene(sphere(24, 36), constant_material("paper", 0.4, 0.0, 0.5), first)
    angles = np.linspace(0, 2 * np.pi, 6, endpoint=False)
    eyes = [(4 * np.sin(a), 1.5 * np.cos(3 * a), 4 * np.cos(a)) for a in angles]
    capture = capture_of([looking_at(eye, SIZE) for eye in (*eyes, *eyes)])
    prepared = subject.create().prepare(scene, capture)
    assert scene.material is not None
    views = []
    for i, view in enumerate(capture.views):
        name = list(lights)[i // len(eyes)]
        pixels = pixel_grid()
        pixels[:, 0] = i
        shown, _ = mean_over_seeds(subject, lambda p=pixels, n=name: prepared.radiance(scene.material, lights[n], p))  # type: ignore[misc]
        color = 0.5 * shown.cpu().numpy().reshape(SIZE, SIZE, 3)
        stored = StoredPixels(color.astype(np.float32), (color.sum(axis=2) > 0).astype(np.float32))
        views.append(replace(view, read=stored, take=name))
    errors = {}
    for labelled in (True, False):
        own = replace(capture, views=tuple(v if labelled else replace(v, take="") for v in views))
        solver: ReflectanceSolver[Any, Any] = subject.create().prepare(scene, own)  # type: ignore[assignment]
        seeded(0)
        everything = range(len(views))
        fit = solver.fit(ModelSpec(), None, everything, 1.0, lambda share: None)
        errors[labelled] = float(np.mean(solver.errors(fit, everything)))
        if not labelled:
            break
        found = solver.scene(fit, everything, lambda share: None).scene
        require(list(found.take_radiance) == list(lights), f"`Scene.take_radiance` has {list(found.take_radiance)}")
        for name, light in found.take_radiance.items():
            wrong = next(other for other in lights if other != name)
            near, far = (_light_distance(light, lights[each].radiance) for each in (name, wrong))
            require(near < far, f"the light of the take {name!r} is nearer to that of {wrong!r}: {near:.3f}, {far:.3f}")
    require(
        errors[True] < errors[False] / 10,
        f"the mean squared error is {errors[True]:.2e} with a light a take, {errors[False]:.2e} with one",
    )


def _light_distance(found: Tensor, truth: Tensor) -> float:
    """Mean difference of two lights of the same size, each divided by its mean, after a blur that matt surfaces see."""
    import torch

    def blurred(light: Tensor) -> Tensor:
        small = torch.nn.functional.adaptive_avg_pool2d(light.detach().cpu().permute(2, 0, 1)[None].double(), (4, 8))
        return small / small.mean()

    return float((blurred(found) - blurred(truth)).abs().mean())


def _exposed(subject: Subject, scene: Scene, capture: Capture, factors: np.ndarray) -> Capture:
    """Photographs of a scene by the renderer itself, times factors; green is recorded."""
    from hir_core.testing.captures import StoredPixels

    prepared = subject.create().prepare(scene, capture)
    views = []
    for i, (view, factor) in enumerate(zip(capture.views, factors, strict=True)):
        pixels = pixel_grid()
        pixels[:, 0] = i
        assert scene.material is not None and scene.environment is not None
        radiance = partial(prepared.radiance, scene.material, scene.environment, pixels)
        shown, _ = mean_over_seeds(subject, radiance)
        color = shown.cpu().numpy().reshape(SIZE, SIZE, 3)
        mask = (color.sum(axis=2) > 0).astype(np.float32)
        stored = StoredPixels((0.5 * color * factor).astype(np.float32), mask)
        views.append(replace(view, read=stored, recorded_exposure=0.01 * float(factor[1])))
    return replace(capture, views=tuple(views))
