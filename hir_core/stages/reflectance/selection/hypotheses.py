"""The hypotheses of the model selection: complete explanations, each a kind of material under a kind of light."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from hir_core.config import ReflectanceSettings
from hir_core.plugins.model_spec import LightKind, MaterialKind, ModelSpec

KINDS: tuple[MaterialKind, ...] = ("diffuse", "dielectric", "metal", "mixed")
"""The kinds that are compared, the simplest first. `paper` is fitted by request only: it explains nothing that the
others do not."""
SIMPLICITY: tuple[MaterialKind, ...] = ("diffuse", "paper", "dielectric", "metal", "mixed")
FRAMES: tuple[Literal["world", "camera"], ...] = ("world", "camera")
"""The light is fixed in the world, or moves with the camera (turntable); the more frequent one first."""
LIGHTS: tuple[LightKind, ...] = (*FRAMES, "lamp")
"""The kinds of light, the simplest first."""
LIGHT = {"world": "light in the world", "camera": "light on the camera", "lamp": "lamp near the camera"}

INTERREFLECTIONS = 3
"""Reflections between parts of the object under a light in the world. In a hemispherical bowl of albedo 0.6 one leaves
out 6 % of the irradiance, three 1 %; each costs a product with one matrix."""


def hypothesis(kind: MaterialKind, light: LightKind = "world", light_is_known: bool = False) -> ModelSpec:
    """The model of a kind of material under a kind of light, without maps.

    Under a light in the world it has indirect light from the start: without it albedos and lobes would absorb the light
    between parts of the object.
    """
    metallic = kind in ("metal", "mixed")
    return ModelSpec(
        brdf="metallic" if metallic else kind,  # type: ignore[arg-type]
        specular="none" if kind == "diffuse" else "uniform",
        metalness={"metal": "metal", "mixed": "map"}.get(kind, "none"),  # type: ignore[arg-type]
        bounces=0 if light == "camera" else INTERREFLECTIONS,
        light_frame="camera" if light == "camera" else "world",
        light_is_known=light_is_known,
        lamp=light == "lamp",
    )


def simplest_of(spec: ModelSpec) -> ModelSpec:
    """The diffuse model under the light of another one."""
    return replace(hypothesis("diffuse", spec.light, spec.light_is_known), bounces=spec.bounces)


def hypotheses(settings: ReflectanceSettings) -> list[ModelSpec]:
    """The hypotheses that the settings admit, the simplest first; a known light is where its file says.

    Those with a lamp near the camera are among them where the settings name it; else see `lamp_hypotheses`.
    """
    known = bool(settings.known_environment)
    lights: tuple[LightKind, ...] = FRAMES if settings.light_frame == "auto" else (settings.light_frame,)
    if known and settings.light_frame == "auto":
        lights = ("world",)
    return [hypothesis(kind, light, known) for light in lights for kind in kinds_of(settings)]


def lamp_hypotheses(settings: ReflectanceSettings) -> list[ModelSpec]:
    """Those with a lamp near the camera that `auto` adds where the first of them is ahead (`lamp_selection.py`)."""
    if settings.light_frame != "auto" or settings.known_environment:
        return []
    return [hypothesis(kind, "lamp") for kind in kinds_of(settings)]


def kinds_of(settings: ReflectanceSettings) -> tuple[MaterialKind, ...]:
    """The kinds of material that `reflectance.brdf` and `reflectance.metalness` admit."""
    if settings.brdf == "auto":
        return KINDS
    if settings.brdf != "metallic":
        return (settings.brdf,)
    metallic: dict[str, tuple[MaterialKind, ...]] = {"auto": ("metal", "mixed"), "metal": ("metal",), "map": ("mixed",)}
    return metallic[settings.metalness]


def complexity(spec: ModelSpec) -> tuple[int, int]:
    """Order of hypotheses: in a tie the lower one is selected."""
    return LIGHTS.index(spec.light), SIMPLICITY.index(spec.kind)


def contains(general: ModelSpec, special: ModelSpec) -> bool:
    """Whether a hypothesis becomes another one where it has no metal, no specular lobe, or a lamp that is dark.

    It then explains as much, whatever the truth: a tie says nothing against the special one.
    """
    wider: dict[str, tuple[str, ...]] = {
        "diffuse": ("paper", "dielectric", "mixed"),
        "dielectric": ("mixed",),
        "metal": ("mixed",),
    }
    kinds = wider.get(special.kind, ())
    if general.lamp and special.light == "world":
        kinds = (special.kind, *kinds)
    elif general.light != special.light:
        return False
    return general.kind in kinds


def described(spec: ModelSpec, beside: ModelSpec | None = None) -> str:
    """The kind of material and, unless it is that of `beside`, the light."""
    if beside is not None and beside.light == spec.light:
        return spec.kind
    return f"{spec.kind}, {LIGHT[spec.light]}"


def forcing_settings(spec: ModelSpec) -> str:
    """The settings that leave this hypothesis alone."""
    material = {
        "diffuse": "reflectance.model=diffuse",
        "metal": "reflectance.brdf=metallic --set reflectance.metalness=metal",
        "mixed": "reflectance.brdf=metallic --set reflectance.metalness=map",
    }.get(spec.kind, f"reflectance.brdf={spec.kind}")
    return f"--set {material} --set reflectance.light_frame={spec.light}"
