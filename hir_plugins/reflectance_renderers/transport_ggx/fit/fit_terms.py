"""Regularizers inside a fit: each term sees the parameters as the material and the light of a scene.

A term with the trait `vertex_maps` sees the values at the vertices of the refined surface. Any other term of the
material sees textures of about as many texels as there are vertices, interpolated from them.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, final

import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.mesh.texel_rasterization import TexelSurface, dilate, texel_surface, texture_of_vertices
from hir_core.optimization.term_gradients import parts_of, value_and_gradients, with_parts
from hir_core.plugins.interfaces import WeightedTerm
from hir_core.scene import Material, Mesh, Scene, Topology
from hir_plugins.reflectance_renderers.transport_ggx.fit.closed_form_albedo import AlbedoRefiner
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Parameters
from hir_plugins.reflectance_renderers.transport_ggx.fit.proximal_step import proximal_step
from hir_plugins.reflectance_renderers.transport_ggx.operator.take_lights import light_of_each_take
from hir_plugins.reflectance_renderers.transport_ggx.operator.visible_surface import Surface, refined_mesh

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import Energy

PADDING_TEXELS = 2
"""Width of the border around charts that repeats their edge."""
LAG_STEPS = 5
"""A term with the trait `lagged` is evaluated every so many steps. In between its `near` is used. One without that acts
only where it is evaluated, with its gradient times this number: a gradient that acts again oscillates around the
minimum of an absolute value. The number divides the interval of checkpoints: a resumed fit takes the same gradients."""


@dataclass(frozen=True, eq=False)
class FitTerms:
    """The regularizers of a solver, and the scene whose mesh, texture size and light they see."""

    terms: Sequence[WeightedTerm]
    scene: Scene
    surface: Surface
    takes: int = 1
    """Number of lights, one below another in the parameters."""

    def prepared(self, start: Parameters, model: str, huber_srgb: float) -> PreparedTerms:
        """For one fit, from its start values; `huber_srgb` is the residual from which its loss is linear."""
        shown = {kind: self._shown(kind, start, model) for kind in {_view_of(term) for term in self.terms}}
        with warnings.catch_warnings():
            # the core warns once, about the model that was selected
            warnings.simplefilter("ignore", UserWarning)
            energies = [term.prepare(_detached(shown[_view_of(term)])) for term in self.terms]
        return PreparedTerms(self, energies, model, huber_srgb)

    def of_textures(self, scene: Scene, huber_srgb: float) -> AlbedoRefiner | None:
        """What refines the solved texture of `scene`, a diffuse albedo or the base colour of a `metallic` material.

        None where no term depends on the material.
        """
        terms = [term for term in self.terms if "material" in term.traits]
        material = scene.material
        if not terms or material is None or material.diffuse_albedo.ndim != 3:
            return None
        shape = material.diffuse_albedo.shape
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            energies = [(term, huber_srgb * term.weight, term.prepare(_detached(scene))) for term in terms]

        def total(albedo: Float[Tensor, "N 3"], lagged: bool) -> Float[Tensor, ""]:
            shown = replace(scene, material=_with_solved(material, albedo.reshape(shape)))
            chosen = (weight * energy(shown) for term, weight, energy in energies if _is_lagged(term) == lagged)
            return sum(chosen, albedo.new_zeros(()))

        return _refiner(terms, total)

    def _shown(self, view: str, parameters: Parameters, model: str, take: int = 0) -> Scene:
        """The parameters as a scene under the light of one take; differentiable in them."""
        light = self.scene.environment
        assert light is not None and self.scene.material is not None
        light = replace(light, radiance=light_of_each_take(parameters.radiance, self.takes)[take])
        if view == "light":
            return replace(self.scene, environment=light)
        material = material_at_vertices(parameters, model)
        if view == "vertices":
            return Scene(self._vertex_mesh, material, light)
        scene = Scene(self.scene.mesh, material, light)
        maps = {name: self._texture(value) for name, value in parts_of(scene).items() if name != "radiance"}
        return with_parts(scene, maps)

    def _texture(self, values: Tensor) -> Tensor:
        if values.ndim == 1:
            return values
        return dilate(texture_of_vertices(self._mesh, values, self._texels), self._texels.covered, PADDING_TEXELS)

    @cached_property
    def _mesh(self) -> Mesh:
        return refined_mesh(self.surface)

    @cached_property
    def _vertex_mesh(self) -> Mesh:
        return Mesh(self.surface.positions, Topology(self.surface.faces))

    @cached_property
    def _texels(self) -> TexelSurface:
        assert self.scene.material is not None
        texture = self.scene.material.diffuse_albedo
        height, width = texture.shape[:2] if texture.ndim == 3 else (1024, 1024)
        vertices = len(self.surface.positions)
        while height * width >= 4 * vertices and height % 2 == width % 2 == 0:
            height, width = height // 2, width // 2
        return texel_surface(self._mesh, (int(height), int(width)))


@final
class PreparedTerms:
    """The weighted terms of one fit as functions of its parameters."""

    def __init__(self, terms: FitTerms, energies: Sequence[Energy], model: str, huber_srgb: float) -> None:
        self._terms, self._energies, self._model, self._huber = terms, energies, model, huber_srgb
        self._lagged: dict[str, _Near | _Linear] = {}
        self._of_roughness: set[str] | None = None

    def __call__(self, parameters: Parameters, step: int) -> dict[str, Float[Tensor, ""]]:
        """Each term times its weight, by name. A lagged one has been evaluated some steps before."""
        takes = {(_view_of(term), take) for term in self._terms.terms for take in self._takes_of(term)}
        shown = {(view, take): self._terms._shown(view, parameters, self._model, take) for view, take in sorted(takes)}
        values = {}
        for term, energy in zip(self._terms.terms, self._energies, strict=True):
            of_takes = []
            for take in self._takes_of(term):
                scene, key = shown[_view_of(term), take], f"{term.name} {take}"
                lagged = _is_lagged(term)
                of_takes.append(self._lagged_value(key, energy, scene, step) if lagged else energy(scene))
            value = of_takes[0] if len(of_takes) == 1 else torch.stack(of_takes).mean()
            values[f"regularizer {term.name}"] = self._huber * term.weight * value
        return values

    def _takes_of(self, term: WeightedTerm) -> range:
        """The takes whose lights a term sees: one that depends on the light all, another one the first."""
        depends = "environment" in term.traits or "material" not in term.traits
        return range(self._terms.takes if depends else 1)

    def of_widths(self, parameters: Parameters, step: int) -> Callable[[Parameters], float]:
        """The sum of the terms that depend on α, as a function of parameters that differ from these in the width."""
        parts: list[tuple[WeightedTerm, Energy]] = []
        for term, energy in zip(self._terms.terms, self._energies, strict=True):
            if _is_lagged(term):
                energy = self._evaluated(f"{term.name} 0", energy, self._shown_to(term, parameters), step).at
            parts.append((term, energy))
        if self._of_roughness is None:
            slopes = {term.name: value_and_gradients(e, self._shown_to(term, parameters))[1] for term, e in parts}
            self._of_roughness = {name for name, found in slopes.items() if "roughness" in found}
        chosen = [(term, energy) for term, energy in parts if term.name in self._of_roughness]

        def total(moved: Parameters) -> float:
            with torch.no_grad():
                return sum(
                    self._huber * term.weight * float(energy(self._shown_to(term, moved))) for term, energy in chosen
                )

        return total

    def _shown_to(self, term: WeightedTerm, parameters: Parameters) -> Scene:
        return self._terms._shown(_view_of(term), parameters, self._model)

    def albedo_refiner(self, parameters: Parameters) -> AlbedoRefiner | None:
        """What refines the solved albedo at vertices, all else fixed; None where no term depends on the material."""
        chosen = [
            (term, energy)
            for term, energy in zip(self._terms.terms, self._energies, strict=True)
            if "material" in term.traits
        ]
        if not chosen:
            return None

        def total(albedo: Float[Tensor, "N 3"], lagged: bool) -> Float[Tensor, ""]:
            at = replace(parameters, diffuse=torch.logit(albedo.clamp(1e-6, 1 - 1e-6)))
            values = (
                self._huber * term.weight * energy(self._shown_to(term, at))
                for term, energy in chosen
                if _is_lagged(term) == lagged
            )
            return sum(values, albedo.new_zeros(()))

        return _refiner([term for term, _ in chosen], total)

    def _lagged_value(self, name: str, energy: Energy, scene: Scene, step: int) -> Float[Tensor, ""]:
        last = self._evaluated(name, energy, scene, step)
        value = last.at(scene)
        if isinstance(last, _Near):
            return value
        factor = LAG_STEPS if last.step == step else 0
        return value.detach() + factor * (value - value.detach())

    def _evaluated(self, name: str, energy: Energy, scene: Scene, step: int) -> _Near | _Linear:
        """A lagged term near the scene of its last evaluation, every few steps near `scene`."""
        known = self._lagged.get(name)
        if known is None or (step % LAG_STEPS == 0 and known.step != step):
            near: Callable[[Scene], Energy] | None = getattr(energy, "near", None)
            if near is not None:
                known = self._lagged[name] = _Near(step, near(_detached(scene)))
                return known
            value, slopes = value_and_gradients(energy, scene)
            at = {part: tensor.detach().clone() for part, tensor in parts_of(scene).items() if part in slopes}
            known = self._lagged[name] = _Linear(step, value.detach(), at, slopes)
        return known


@dataclass(frozen=True, eq=False)
class _Near:
    """What a term says of itself near the scene of a step."""

    step: int
    at: Energy


@dataclass(frozen=True, eq=False)
class _Linear:
    """A term near the scene of a step, by its gradient there."""

    step: int
    value: Float[Tensor, ""]
    parts: dict[str, Tensor]
    slopes: dict[str, Tensor]

    def at(self, scene: Scene) -> Float[Tensor, ""]:
        """The linear function."""
        shown, total = parts_of(scene), self.value
        for part, slope in self.slopes.items():
            total = total + ((shown[part] - self.parts[part]) * slope).sum()
        return total


def material_at_vertices(parameters: Parameters, model: str) -> Material:
    """The material of parameters, with values (V, C) at the vertices where they vary."""
    if parameters.specular is None or parameters.width is None:
        none = parameters.diffuse.new_zeros(3)
        return Material("paper", parameters.diffuse_albedo, none, torch.ones_like(none[:1]))
    diffuse, alpha = parameters.diffuse_albedo, _one_or_all(parameters.alpha)
    specular = _one_or_all(parameters.specular_albedo.expand(-1, 3))
    if parameters.metalness is None:
        return Material("paper" if model == "paper" else "dielectric", diffuse, specular, alpha)
    f0 = float(parameters.dielectric_f0.detach().mean())
    metalness = _one_or_all(parameters.metal_share)
    return Material("metallic", diffuse, specular, alpha, metalness=metalness, dielectric_f0=f0)


def _with_solved(material: Material, texture: Float[Tensor, "H W 3"]) -> Material:
    if material.metalness is None:
        return replace(material, diffuse_albedo=texture)
    return Material.metallic(texture, material.metalness, material.roughness, dielectric_f0=material.dielectric_f0)


def _one_or_all(values: Float[Tensor, "#V C"]) -> Tensor:
    return values[0] if len(values) == 1 else values


def _is_lagged(term: WeightedTerm) -> bool:
    return "lagged" in term.traits


def _refiner(terms: Sequence[WeightedTerm], total: Callable[[Tensor, bool], Tensor]) -> AlbedoRefiner:
    """The proximal step of terms; `total(albedo, lagged)` is the sum of those that are lagged, or of the others."""
    slow = (lambda albedo: total(albedo, True)) if any(map(_is_lagged, terms)) else None
    return lambda albedo, curvature: proximal_step(albedo, curvature, lambda x: total(x, False), slow)


def _view_of(term: WeightedTerm) -> str:
    """What a term sees: `light`, `vertices` or `textures`."""
    if "material" not in term.traits:
        return "light"
    return "vertices" if "vertex_maps" in term.traits else "textures"


def _detached(scene: Scene) -> Scene:
    return with_parts(scene, {name: part.detach().clone() for name, part in parts_of(scene).items()})
