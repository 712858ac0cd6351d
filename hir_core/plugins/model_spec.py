"""A candidate of model selection: which terms of the reflectance model are fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

from hir_core.capture.photograph_exposures import Exposures

MaterialKind: TypeAlias = Literal["diffuse", "paper", "dielectric", "metal", "mixed"]
"""What a model says the surface is made of; `mixed` is metal in one place and dielectric in another."""

LightKind: TypeAlias = Literal["world", "camera", "lamp"]
"""The kinds of light: distant and fixed in the world; distant and moving with the camera; a lamp near the camera
beside a distant light that is fixed in the world."""


@dataclass(frozen=True)
class ModelSpec:
    """The terms of a reflectance model: its BRDF, which parameters vary over the surface, and the kind of light.

    A `metallic` BRDF always has a base colour for each vertex and one F0 for the dielectric part: `specular` is
    `uniform` and `colored` is false. Other combinations raise `ValueError`.
    """

    brdf: Literal["diffuse", "paper", "dielectric", "metallic"] = "diffuse"
    specular: Literal["none", "uniform", "map"] = "none"
    roughness: Literal["uniform", "map"] = "uniform"
    colored: bool = False
    """Is the specular albedo ρs an RGB colour, as metals need, or one number?"""
    normals: Literal["mesh", "map"] = "mesh"
    """`map`: shading normals differ from the mesh's, for relief that is finer than its triangles."""
    bounces: int = 0
    """Indirect light: number of reflections between parts of the surface."""
    light_frame: Literal["world", "camera"] = "world"
    light_is_known: bool = False
    """The light of the prepared scene is given and is not fitted; a lamp is."""
    per_texel: Literal["none", "albedo", "brdf"] = "none"
    """What is solved for each texel, from the pixels that observe it, after the fit at vertices: nothing, its albedo
    alone, or its albedo, specular lobe and normal."""
    exposures: Exposures = "equal"
    """How bright the photographs are beside each other; see `Exposures`."""
    metalness: Literal["none", "metal", "map"] = "none"
    """Of the `metallic` BRDF: `metal` is 1 everywhere, `map` varies over the surface. `none` for every other BRDF."""
    lamp: bool = False
    """Is there a lamp near the camera, beside a light that is fixed in the world? See `CameraLamp`."""

    def __post_init__(self) -> None:
        if (self.brdf == "metallic") != (self.metalness != "none"):
            raise ValueError(f"metalness={self.metalness!r} contradicts brdf={self.brdf!r}; only `metallic` has one")
        if self.brdf == "metallic" and (self.specular != "uniform" or self.colored):
            raise ValueError("a `metallic` model has specular='uniform' and no colour of its own in F0")
        if self.lamp and self.light_frame == "camera":
            raise ValueError("a model with a lamp has its distant light in the world: light_frame='world'")

    @property
    def kind(self) -> MaterialKind:
        """What the model says the surface is made of."""
        if self.brdf == "metallic":
            return "metal" if self.metalness == "metal" else "mixed"
        return self.brdf

    @property
    def light(self) -> LightKind:
        """The kind of light."""
        return "lamp" if self.lamp else self.light_frame

    @property
    def mapped(self) -> bool:
        """Does any parameter other than the diffuse albedo or the base colour vary between vertices?"""
        return "map" in (self.specular, self.roughness, self.normals, self.metalness)

    @property
    def name(self) -> str:
        """The name in reports and in run.json."""
        if self.brdf == "diffuse":
            parts = ["diffuse"]
        elif self.brdf == "metallic":
            parts = ["metal" if self.metalness == "metal" else "metal and dielectric"]
        else:
            parts = [self.brdf, "specular map" if self.specular == "map" else "specular"]
            if self.colored:
                parts.append("coloured")
        if self.brdf != "diffuse" and self.roughness == "map":
            parts.append("roughness map")
        if self.normals == "map":
            parts.append("normal map")
        if self.light_frame == "camera":
            parts.append("light on camera")
        if self.lamp:
            parts.append("lamp near the camera")
        if self.bounces:
            parts.append(f"{self.bounces} bounce" + "s" * (self.bounces > 1))
        if self.exposures != "equal":
            parts.append(f"{self.exposures} exposures")
        if self.per_texel != "none":
            parts.append("per-texel BRDF" if self.per_texel == "brdf" else "per-texel albedo")
        return ", ".join(parts)
