"""A candidate of model selection: which terms of the reflectance model are fitted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class ModelSpec:
    """One model of the ladder."""

    brdf: Literal["diffuse", "paper", "dielectric"] = "diffuse"
    specular: Literal["none", "uniform", "map"] = "none"
    roughness: Literal["uniform", "map"] = "uniform"
    colored: bool = False
    """Is ρs a colour, as metals need, or one number?"""
    normals: Literal["mesh", "map"] = "mesh"
    """Are normals bent from the mesh's, by dents that are finer than its triangles?"""
    bounces: int = 0
    """Indirect light: times that light is reflected between parts of the surface."""
    light_frame: Literal["world", "camera"] = "world"
    texels: Literal["none", "albedo", "lobes"] = "none"
    """What every texel is given of its own, from its photographs, when the rest is fitted: its albedo alone, or albedo,
    lobe and normal."""

    @property
    def mapped(self) -> bool:
        """Does anything but the albedo vary between vertices?"""
        return "map" in (self.specular, self.roughness, self.normals)

    @property
    def name(self) -> str:
        """What reports call it."""
        if self.brdf == "diffuse":
            parts = ["diffuse"]
        else:
            parts = [self.brdf, "specular map" if self.specular == "map" else "specular"]
            if self.colored:
                parts.append("coloured")
            if self.roughness == "map":
                parts.append("roughness map")
        if self.normals == "map":
            parts.append("normal map")
        if self.light_frame == "camera":
            parts.append("light on camera")
        if self.bounces:
            parts.append(f"{self.bounces} bounce" + "s" * (self.bounces > 1))
        if self.texels != "none":
            parts.append(f"{self.texels} in texels")
        return ", ".join(parts)
