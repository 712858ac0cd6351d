"""The hypotheses of the model selection: complete explanations, each a kind of material under a kind of light."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

from hir_core.config import ReflectanceSettings
from hir_core.plugins.model_spec import MaterialKind, ModelSpec

KINDS: tuple[MaterialKind, ...] = ("diffuse", "dielectric", "metal", "mixed")
"""The kinds that are compared, the simplest first. `paper` is fitted by request only: it explains nothing that the
others do not."""
SIMPLICITY: tuple[MaterialKind, ...] = ("diffuse", "paper", "dielectric", "metal", "mixed")
FRAMES: tuple[Literal["world", "camera"], ...] = ("world", "camera")
"""The light is fixed in the world, or moves with the camera (turntable, flash); the more frequent one first."""
LIGHT = {"world": "light in the world", "camera": "light on the camera"}

INTERREFLECTIONS = 3
"""Reflections between parts of the object under a light in the world. In a hemispherical bowl of albedo 0.6 one leaves
out 6 % of the irradiance, three 1 %; each costs a product with one matrix."""


def hypothesis(
    kind: MaterialKind, frame: Literal["world", "camera"] = "world", light_is_known: bool = False
) -> ModelSpec:
    """The model of a kind of material under a kind of light, without maps.

    Under a light in the world it has indirect light from the start: without it albedos and lobes would absorb the light
    between parts of the object.
    """
    metallic = kind in ("metal", "mixed")
    return ModelSpec(
        brdf="metallic" if metallic else kind,  # type: ignore[arg-type]
        specular="none" if kind == "diffuse" else "uniform",
        metalness={"metal": "metal", "mixed": "map"}.get(kind, "none"),  # type: ignore[arg-type]
        bounces=INTERREFLECTIONS if frame == "world" else 0,
        light_frame=frame,
        light_is_known=light_is_known,
    )


def simplest_of(spec: ModelSpec) -> ModelSpec:
    """The diffuse model under the light of another one."""
    return replace(hypothesis("diffuse", spec.light_frame, spec.light_is_known), bounces=spec.bounces)


def hypotheses(settings: ReflectanceSettings) -> list[ModelSpec]:
    """The hypotheses that the settings admit, the simplest first; a known light is where its file says."""
    known = bool(settings.known_environment)
    frames = FRAMES if settings.light_frame == "auto" else (settings.light_frame,)
    if known and settings.light_frame == "auto":
        frames = ("world",)
    return [hypothesis(kind, frame, known) for frame in frames for kind in kinds_of(settings)]


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
    return FRAMES.index(spec.light_frame), SIMPLICITY.index(spec.kind)


def contains(general: ModelSpec, special: ModelSpec) -> bool:
    """Whether a hypothesis becomes another one where it has no metal, or no specular lobe.

    It then explains as much, whatever the truth: a tie says nothing against the special one.
    """
    wider: dict[str, tuple[str, ...]] = {
        "diffuse": ("paper", "dielectric", "mixed"),
        "dielectric": ("mixed",),
        "metal": ("mixed",),
    }
    return general.light_frame == special.light_frame and general.kind in wider.get(special.kind, ())


def described(spec: ModelSpec, beside: ModelSpec | None = None) -> str:
    """The kind of material and, unless it is that of `beside`, the light."""
    if beside is not None and beside.light_frame == spec.light_frame:
        return spec.kind
    return f"{spec.kind}, {LIGHT[spec.light_frame]}"


def forcing_settings(spec: ModelSpec) -> str:
    """The settings that leave this hypothesis alone."""
    material = {
        "diffuse": "reflectance.model=diffuse",
        "metal": "reflectance.brdf=metallic --set reflectance.metalness=metal",
        "mixed": "reflectance.brdf=metallic --set reflectance.metalness=map",
    }.get(spec.kind, f"reflectance.brdf={spec.kind}")
    return f"--set {material} --set reflectance.light_frame={spec.light_frame}"
