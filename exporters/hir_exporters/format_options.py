"""Options of each file format. The module imports nothing else, so that plugin descriptors can import it.

A value of a wrong type or out of range raises `ValueError` with one sentence when the options are constructed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from operator import index
from typing import Any, Final, Literal, get_args, get_origin, get_type_hints

RANGE: Final = "range"
"""Key of a field's metadata: smallest and largest value of it, or of each of its values."""


def _number(default: Any, low: float, high: float) -> Any:
    """A field whose value, or each of whose values, is from `low` to `high`."""
    return field(default=default, metadata={RANGE: (low, high)})


@dataclass(frozen=True)
class CheckedOptions:
    """Base of the options: checks the type and range of each field."""

    def __post_init__(self) -> None:
        hints = get_type_hints(type(self))
        for option in fields(self):
            value = getattr(self, option.name)
            low, high = option.metadata.get(RANGE, (-math.inf, math.inf))
            object.__setattr__(self, option.name, _checked(option.name, value, hints[option.name], low, high))


def _checked(name: str, value: Any, hint: Any, low: float, high: float) -> Any:
    """The value, or `ValueError`. `hint` is bool, int, float, a tuple of these, or a `Literal`."""
    kind = get_origin(hint)
    if kind is Literal:
        if not isinstance(value, str) or value not in get_args(hint):
            raise ValueError(f"{name} is {_shown(value)}; it is one of {', '.join(map(repr, get_args(hint)))}")
        return value
    if kind is tuple:
        if isinstance(value, str | bytes | dict | set | frozenset) or not hasattr(value, "__iter__"):
            raise ValueError(f"{name} is {_shown(value)}; it is a list of numbers from {low:.10g} to {high:.10g}")
        return tuple(_checked(name, entry, get_args(hint)[0], low, high) for entry in value)
    if hint is bool:
        if not isinstance(value, bool):
            raise ValueError(f"{name} is {_shown(value)}; it is True or False")
        return value
    return _checked_number(name, value, hint is int, low, high)


def _checked_number(name: str, value: Any, whole: bool, low: float, high: float) -> float:
    try:
        if isinstance(value, bool | str | bytes):
            raise TypeError
        number = index(value) if whole else float(value)
    except (TypeError, ValueError, OverflowError):
        needed = f"a{' whole' if whole else ''} number from {low:.10g} to {high:.10g}"
        raise ValueError(f"{name} is {_shown(value)}; it is {needed}") from None
    if not low <= number <= high:
        raise ValueError(f"{name} is {_shown(value)}; it must be from {low:.10g} to {high:.10g}")
    return number


def _shown(value: Any) -> str:
    """A value in a message of one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 80 else f"{text[:79]}…"


DEFAULT_LIGHTS: Final = 8
"""Babylon.js uses one uniform block for each light, and WebGL guarantees 12 of them."""


DEFAULT_HULLS: Final = 16


def _only_with_collision(collision: bool, hulls: int) -> None:
    """Raises `ValueError` where a number of hulls is set and none are written."""
    if not collision and hulls != DEFAULT_HULLS:
        raise ValueError(f"collision_hulls is {hulls}, but no collision shapes are written; set collision, too")


def _only_for_engine(options: CheckedOptions, *names: str) -> None:
    """Raises `ValueError` where an option of profile engine is set for another profile."""
    defaults = {option.name: option.default for option in fields(options)}
    for name in names:
        if getattr(options, "profile", "engine") != "engine" and getattr(options, name) != defaults[name]:
            raise ValueError(f"{name} is {getattr(options, name)!r}, but only profile engine has lights; set it, too")


@dataclass(frozen=True)
class GltfConfig(CheckedOptions):
    """Options of .glb and .gltf."""

    profile: Literal["khr", "blender", "metalrough", "unity-legacy", "engine"] = "khr"
    """How the material is encoded: with the ratified extensions (khr), as Blender reads them, as core
    metallic-roughness, or as specular-glossiness for Unity's glTFast (unity-legacy). engine: as khr, but for the
    shading of three.js, Babylon.js and Filament: the brightest parts of the light become lights in the file, the rest
    of the light is NAME_glb_residual.hdr, and the base colour of metals is changed for multiple scattering."""
    lights: int = _number(DEFAULT_LIGHTS, 1, 64)
    """Largest number of lights of profile engine. Babylon.js renders no more than 8 to 12 on many devices."""
    light_type: Literal["directional", "point"] = "directional"
    """Lights of profile engine (KHR_lights_punctual). point: point lights at 100 times the object's size, for Filament,
    which has one directional light at most."""
    budget: Literal["none", "quicklook", "phone", "web", "desktop"] = "none"
    """Limits of a target on triangles, texture size and bytes (phone 5 MB, web 3 MB, desktop 40 MB): meshes and
    textures above them are reduced, images become JPEG, WebP or KTX2, and the report says so."""
    max_texture_size: int = _number(4096, 1, 1 << 16)
    """Larger textures are reduced to this many pixels a side."""
    image_format: Literal["png", "jpeg", "webp", "ktx2"] = "png"
    """JPEG is smaller and loses detail; normal maps and alpha stay PNG. WebP (EXT_texture_webp) is smaller still:
    linear maps are lossless, and a fallback of at most 512 pixels is for readers without the extension. KTX2
    (KHR_texture_basisu, beside the same fallback) stays compressed in the memory of a GPU: colour is ETC1S, linear maps
    are UASTC. It needs node and the npm package ktx2-encoder; HIR_NODE_MODULES names the folder that has it."""
    jpeg_quality: int = _number(92, 1, 95)
    """Of JPEG, WebP and ETC1S in KTX2, 1 to 95."""
    tangents: Literal["auto", "always", "never"] = "auto"
    """Whether tangents are written; auto: where there is a normal map."""
    lods: tuple[int, ...] = _number((), 1, 1 << 31)
    """Triangle counts of further levels of detail, written beside the file as NAME_lod1, NAME_lod2 and so on. Each has
    textures of half the size of the one before, down to 256 pixels."""
    lod_layout: Literal["files", "msft_lod"] = "files"
    """msft_lod: all levels in the one file, with shared textures (MSFT_lod, which Babylon.js reads; others show the
    finest level)."""
    lod_normals: bool = True
    """Bake the normals of the full mesh into a normal map for each level of detail."""
    quantize: bool = False
    """KHR_mesh_quantization: 16-bit positions, 8-bit normals and tangents, 16-bit UVs. Readers without the extension
    cannot open the file."""
    compression: Literal["none", "draco", "meshopt"] = "none"
    """KHR_draco_mesh_compression (library DracoPy) or EXT_meshopt_compression (library meshopt), both in
    `hir[compress]`. Readers without the extension cannot open the file."""
    environment: bool = True
    """Write the environment beside the file as NAME.hdr."""
    image_based_light: bool = False
    """EXT_lights_image_based: also write the prefiltered environment into the file, for Babylon.js."""

    thumbnail: bool = False
    """Write NAME_thumbnail.png beside the file: the whole asset in its own light, 512 pixels a side (1 to 2 s)."""
    xmp: bool = False
    """KHR_xmp_json_ld: also write title, program, capture and what is known of the material as XMP."""
    collision: Literal["none", "unreal", "godot"] = "none"
    """Add convex hulls for collisions (library coacd in `hir[collision]`; up to minutes), named for Unreal
    (UCX_NAME_00) or Godot (NAME_00-convcolonly). Other programs show them as meshes."""
    collision_hulls: int = _number(DEFAULT_HULLS, 1, 256)
    """Largest number of convex hulls."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _only_for_engine(self, "lights", "light_type")
        _only_with_collision(self.collision != "none", self.collision_hulls)


@dataclass(frozen=True)
class UsdConfig(CheckedOptions):
    """Options of .usda and .usdc."""

    profile: Literal["unaltered", "engine"] = "unaltered"
    """engine: the layer with the light has distant lights for the brightest parts of the light, and a dome light with
    NAME_usda_residual.hdr for the rest. The material is unaltered."""
    lights: int = _number(DEFAULT_LIGHTS, 1, 64)
    """Largest number of distant lights of profile engine."""
    workflow: Literal["auto", "metallic", "specular"] = "auto"
    """Workflow of UsdPreviewSurface; auto: metallic, which every importer reads, unless specular is clearly closer."""
    budget: Literal["none", "quicklook", "phone", "web", "desktop"] = "none"
    """Limits of a target on triangles, texture size and bytes (phone 5 MB, web 3 MB, desktop 40 MB): meshes and
    textures above them are reduced, images become JPEG or WebP, and the report says so."""
    max_texture_size: int = _number(4096, 1, 1 << 16)
    """Larger textures are reduced to this many pixels a side."""
    image_format: Literal["png", "jpeg"] = "png"
    """JPEG is smaller and loses detail; normal maps stay PNG."""
    jpeg_quality: int = _number(92, 1, 95)
    """1 to 95."""
    meters_per_unit: float = _number(1.0, 1e-9, 1e9)
    """Metadata of the file; positions are not scaled."""
    environment: bool = True
    """Write the environment as NAME.hdr and NAME_usda_lit.usda (usdc and usdz likewise), a layer that adds a dome light
    to the asset."""
    materialx: bool = False
    """Write NAME_usda_openpbr.usda, a layer that adds the material as OpenPBR in MaterialX. Not for .usdz."""
    subsets: bool = True
    """Write the face subsets `observed` and `unobserved`, where the asset says which texels a view observed."""

    thumbnail: bool = False
    """Add a picture of the whole asset in its own light, 512 pixels a side, and name it in the asset's information
    (AssetPreviewsAPI); as NAME_thumbnail.png beside the file, in .usdz inside of it (1 to 2 s)."""
    collision: bool = False
    """Add convex hulls as collision shapes of UsdPhysics (library coacd in `hir[collision]`; up to minutes)."""
    collision_hulls: int = _number(DEFAULT_HULLS, 1, 256)
    """Largest number of convex hulls."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _only_for_engine(self, "lights")
        _only_with_collision(self.collision, self.collision_hulls)


@dataclass(frozen=True)
class UsdzConfig(UsdConfig):
    """Options of .usdz, a package for AR Quick Look and other USD readers."""

    workflow: Literal["auto", "metallic", "specular"] = "metallic"
    budget: Literal["none", "quicklook", "phone", "web", "desktop"] = "quicklook"
    max_texture_size: int = _number(2048, 1, 1 << 16)
    subsets: bool = False


@dataclass(frozen=True)
class ObjConfig(CheckedOptions):
    """Options of .obj with .mtl."""

    max_texture_size: int = _number(4096, 1, 1 << 16)
    """Larger textures are reduced to this many pixels a side."""


@dataclass(frozen=True)
class HarmonicsConfig(CheckedOptions):
    """Options of the environment as nine spherical harmonics."""

    profile: Literal["unaltered", "engine"] = "unaltered"
    """engine: what remains of the light beside the lights in a file of glb.profile=engine."""
    lights: int = _number(DEFAULT_LIGHTS, 1, 64)
    """Largest number of these lights, as in glb.lights."""

    def __post_init__(self) -> None:
        super().__post_init__()
        _only_for_engine(self, "lights")


@dataclass(frozen=True)
class EnvironmentConfig(HarmonicsConfig):
    """Options of the environment as a lat-long image, .hdr or .exr."""

    height: int = _number(0, 0, 1 << 14)
    """Rows of the image, which is twice as wide; 0 keeps the asset's resolution."""


@dataclass(frozen=True)
class CubemapConfig(HarmonicsConfig):
    """Options of the environment as a prefiltered cubemap, .ktx."""

    size: int = _number(256, 16, 4096)
    """Side of the first level in pixels, a power of two; the last level, 16 pixels, is for roughness 1."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.size & (self.size - 1):
            raise ValueError(f"size is {self.size}; it must be a power of two from 16 to 4096")
