"""Renderers with one fault each, made of the built-in ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from hir_core.capture import Camera, Capture, View
from hir_core.plugins import Component, NoOptions
from hir_core.plugins.interfaces import GeometryRenderer, PreparedReflectance, ReflectanceRenderer
from hir_core.plugins.model_spec import ModelSpec
from hir_core.scene import EnvironmentMap, Material, Mesh, Scene
from hir_core.scene.silhouette_targets import SilhouetteTargets
from hir_plugins.geometry_renderers.contour import Contour
from hir_plugins.geometry_renderers.options import ContourOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.options import MitsubaGGXOptions
from hir_plugins.reflectance_renderers.mitsuba_ggx.renderer import MitsubaGGX
from hir_plugins.reflectance_renderers.transport_ggx.options import TransportGGXOptions
from hir_plugins.reflectance_renderers.transport_ggx.renderer import TransportGGX

HERE = __name__


class Outline(GeometryRenderer):
    """The sound one: `contour`."""

    def __init__(self, config: NoOptions) -> None:
        self.inner = Contour(ContourOptions())

    def prepare(self, views: Sequence[View], downsample: int = 1) -> SilhouetteTargets:
        return self.inner.prepare(views, downsample)

    def render(self, mesh: Mesh, cameras: Sequence[Camera]) -> Tensor:
        return self.inner.render(mesh, cameras)

    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Tensor, Tensor]:
        return self.inner.overlap(mesh, targets)


class TooBright(Outline):
    def render(self, mesh: Mesh, cameras: Sequence[Camera]) -> Tensor:
        return 1.02 * super().render(mesh, cameras)


class TooLarge(Outline):
    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Tensor, Tensor]:
        area, overlap = super().overlap(mesh, targets)
        return area + 0.07 * area.detach(), overlap


class HalfGradient(Outline):
    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Tensor, Tensor]:
        area, overlap = super().overlap(mesh, targets)
        return 0.5 * (area + area.detach()), overlap


class BetterInCompany(Outline):
    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Tensor, Tensor]:
        area, overlap = super().overlap(mesh, targets)
        return area * (1.002 if len(targets) > 2 else 1.0), overlap


class NoEmptyMesh(Outline):
    def overlap(self, mesh: Mesh, targets: SilhouetteTargets) -> tuple[Tensor, Tensor]:
        mesh.faces.max()  # of nothing there is no maximum
        return super().overlap(mesh, targets)


def geometry(implementation: type = Outline) -> Component:
    return Component(
        name="outline",
        target=f"{HERE}:{implementation.__name__}",
        summary="Contour, wrapped.",
        requires=("torch", "jaxtyping"),
        extra="reconstruct",
        traits=frozenset({"differentiable"}),
    )


BROKEN_GEOMETRY: dict[str, Component] = {
    "coverage_is_in_range": geometry(TooBright),
    "area_is_that_of_the_outline": geometry(TooLarge),
    "gradient_is_that_of_the_outline": geometry(HalfGradient),
    "batch_is_its_singles": geometry(BetterInCompany),
    "hard_meshes_stay_finite": geometry(NoEmptyMesh),
}


class Traced(ReflectanceRenderer):
    """The sound one: `mitsuba_ggx` with direct light."""

    def __init__(self, config: NoOptions) -> None:
        self.inner = MitsubaGGX(MitsubaGGXOptions(samples=64, render_samples=64, max_depth=2))

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        return Prepared(self, self.inner.prepare(scene, capture, downsample), capture)

    def render(self, scene: Scene, camera: Camera) -> Tensor:
        return self.inner.render(scene, camera)

    def changed(self, material: Material) -> Material:
        """What is shaded in the place of a material."""
        return material

    def factor(self, material: Material, light: EnvironmentMap, camera: Camera) -> Any:
        """What radiance is multiplied with."""
        return 1.0


class Prepared(PreparedReflectance):
    def __init__(self, renderer: Traced, inner: PreparedReflectance, capture: Capture) -> None:
        self.renderer, self.inner, self.capture = renderer, inner, capture

    def radiance(self, material: Material, environment: EnvironmentMap, pixels: Tensor) -> Tensor:
        factor = self.renderer.factor(material, environment, self.capture.cameras[0])
        return factor * self.inner.radiance(self.renderer.changed(material), environment, pixels)


class Transparent(Traced):
    def render(self, scene: Scene, camera: Camera) -> Tensor:
        return super().render(scene, camera) * 0.97


class Glowing(Traced):
    """White surfaces glow."""

    def factor(self, material: Material, light: EnvironmentMap, camera: Camera) -> Any:
        return 1.1 if float(material.diffuse_albedo.detach().max()) > 0.95 else 1.0


class OneWay(Traced):
    """A lobe alone is brighter from above."""

    def factor(self, material: Material, light: EnvironmentMap, camera: Camera) -> Any:
        return 1 + 0.1 * camera.center[1] if float(material.diffuse_albedo.detach().max()) == 0 else 1.0


class Tired(Traced):
    """More light, a little less effect."""

    def factor(self, material: Material, light: EnvironmentMap, camera: Camera) -> Any:
        return 1 - 1e-3 * light.radiance.mean()


class Biased(Traced):
    """Three percent too bright where the surface is dark and glossy."""

    def factor(self, material: Material, light: EnvironmentMap, camera: Camera) -> Any:
        dark = float(material.diffuse_albedo.detach().max()) < 0.48
        return 1.03 if dark and 0.11 < float(material.specular_albedo.detach().max()) < 0.3 else 1.0


def half_gradient(name: str) -> type[Traced]:
    """One whose gradient by a parameter is half of what it should be."""

    class Half(Traced):
        def changed(self, material: Material) -> Material:
            value = getattr(material, name)
            return replace(material, **{name: 0.5 * (value + value.detach())})  # type: ignore[arg-type]

    Half.__name__ = Half.__qualname__ = f"Half_{name}"
    return Half


HALVES = {name: half_gradient(name) for name in ("diffuse_albedo", "specular_albedo", "roughness")}
globals().update({half.__name__: half for half in HALVES.values()})


class Unturned(Traced):
    """Leaves the rotation of the light out."""

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        return PreparedUnturned(self, self.inner.prepare(scene, capture, downsample), capture)


class PreparedUnturned(Prepared):
    def radiance(self, material: Material, environment: EnvironmentMap, pixels: Tensor) -> Tensor:
        return super().radiance(material, replace(environment, to_world=None), pixels)


class HalfLight(Traced):
    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        return HalfLit(self, self.inner.prepare(scene, capture, downsample), capture)


class HalfLit(Prepared):
    def radiance(self, material: Material, environment: EnvironmentMap, pixels: Tensor) -> Tensor:
        half = 0.5 * (environment.radiance + environment.radiance.detach())
        return super().radiance(material, replace(environment, radiance=half), pixels)


class WithoutLamp(Traced):
    """Declares the trait `camera_lamp` and shades the distant light alone."""

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        return PreparedWithoutLamp(self, self.inner.prepare(scene, capture, downsample), capture)


class PreparedWithoutLamp(Prepared):
    def radiance(self, material: Material, environment: EnvironmentMap, pixels: Tensor) -> Tensor:
        return super().radiance(material, replace(environment, lamp=None), pixels)


class WithPointLamp(Traced):
    """Shades every lamp as a point."""

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        return PreparedWithPointLamp(self, self.inner.prepare(scene, capture, downsample), capture)


class PreparedWithPointLamp(Prepared):
    def radiance(self, material: Material, environment: EnvironmentMap, pixels: Tensor) -> Tensor:
        lamp = environment.lamp and replace(environment.lamp, radius=torch.zeros(()))
        return super().radiance(material, replace(environment, lamp=lamp), pixels)


def with_lamp(implementation: type) -> Component:
    sound = reflectance(implementation)
    return replace(sound, name="lit_by_lamp", traits=sound.traits | {"camera_lamp"})


def reflectance(implementation: type = Traced) -> Component:
    return Component(
        name="traced",
        target=f"{HERE}:{implementation.__name__}",
        summary="The path tracer, wrapped.",
        requires=("torch", "jaxtyping", "mitsuba"),
        extra="reconstruct",
        traits=frozenset({"material", "environment", "stochastic"}),
    )


class EquallyExposed(ReflectanceRenderer):
    """The fast renderer, whose solver declares the trait `exposures` and fits equal ones."""

    def __init__(self, config: NoOptions) -> None:
        self.inner = TransportGGX(TransportGGXOptions(vertices=0, cache_cells=800, steps=60))

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        solver = self.inner.prepare(scene, capture, downsample)
        fit = solver.fit

        def fit_equal(spec: ModelSpec, *rest: Any) -> Any:
            return fit(replace(spec, exposures="equal"), *rest)

        solver.fit = fit_equal  # type: ignore[method-assign]
        return solver

    def render(self, scene: Scene, camera: Camera) -> Tensor:
        return self.inner.render(scene, camera)


class Exposed(EquallyExposed):
    """The sound one."""

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        return self.inner.prepare(scene, capture, downsample)


class Continuing(EquallyExposed):
    """Each fit goes on from the one before, also where it should start anew."""

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        solver = self.inner.prepare(scene, capture, downsample)
        fit, earlier = solver.fit, []

        def fit_on(spec: ModelSpec, initial: Any, *rest: Any) -> Any:
            earlier.append(fit(spec, initial or next(iter(earlier[-1:]), None), *rest))
            return earlier[-1]

        solver.fit = fit_on  # type: ignore[method-assign]
        return solver


class OneLight(EquallyExposed):
    """Takes have no lights of their own."""

    def prepare(self, scene: Scene, capture: Capture, downsample: int = 1) -> PreparedReflectance:
        views = tuple(replace(view, take="") for view in capture.views)
        return self.inner.prepare(scene, replace(capture, views=views), downsample)


def of_takes(implementation: type) -> Component:
    return replace(reflectance(implementation), name="of_takes", traits=frozenset({"solver", "takes", "lambertian"}))


def solving(implementation: type) -> Component:
    return replace(reflectance(implementation), name="solving", traits=frozenset({"solver", "exposures", "lambertian"}))


BROKEN_REFLECTANCE: dict[str, Component] = {
    "radiance_is_finite_and_in_place": reflectance(Transparent),
    "white_furnace": reflectance(Glowing),
    "reciprocity": reflectance(OneWay),
    "light_has_its_frame": reflectance(Unturned),
    "linear_in_light": reflectance(Tired),
    **{f"gradient_by_{name}": reflectance(half) for name, half in HALVES.items()},
    "gradient_by_light": reflectance(HalfLight),
    "agrees_with_the_reference": reflectance(Biased),
    "fits_depend_on_their_arguments": of_takes(Continuing),
    "exposures_are_fitted": solving(EquallyExposed),
    "each_take_has_its_light": of_takes(OneLight),
    "lamp_is_near_the_camera": with_lamp(WithoutLamp),
    "lamp_is_as_large_as_its_radius": with_lamp(WithPointLamp),
}
