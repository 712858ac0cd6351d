"""Material parameters that a user gives for a mesh: image files or constants."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hir_exporters.conventions import srgb_to_linear
from hir_exporters.errors import InputError
from hir_exporters.textures.image_files import read_hdr, read_ldr

Array = NDArray[np.floating]


@dataclass(frozen=True)
class MaterialOverrides:
    """Metallic-roughness parameters as files or constants. None: the value of the mesh's file, else the default."""

    base_color: Path | tuple[float, float, float] | None = None
    """sRGB image (linear if .exr or .hdr), or linear RGB; grey 0.5 by default."""
    roughness: Path | float | None = None
    """Perceptual roughness, the square root of the GGX width; 0.5 by default."""
    metallic: Path | float | None = None
    """0 by default."""
    normal: Path | None = None
    """Tangent space normal map, green up."""
    normal_scale: float = 1.0
    """Factor of x and y of its vectors, as glTF's `normalTexture.scale`."""


_VALUE_SYNTAX: Final = {"base_color": "R,G,B", "roughness": "NUMBER", "metallic": "NUMBER"}
"""How a constant is written in place of a file."""


def parse_material_overrides(options: Mapping[str, str]) -> MaterialOverrides:
    """The overrides of command-line options by name (`base_color`, `roughness`, `metallic`, `normal`)."""
    values: dict[str, Any] = {name: parse_material_override(name, text) for name, text in options.items()}
    return MaterialOverrides(**values)


def parse_material_override(name: str, text: str) -> Path | float | tuple[float, float, float]:
    """Parses an option of the command line: a file, a number or a colour. Raises `InputError` naming the option."""
    if name != "normal":
        parts = text.split(",")
        try:
            numbers = tuple(float(part) for part in parts)
        except ValueError:
            numbers = ()
        if numbers and len(numbers) == (3 if name == "base_color" else 1):
            return (numbers[0], numbers[1], numbers[2]) if name == "base_color" else numbers[0]
    file = Path(text)
    if not file.is_file():
        constant = f" or {_VALUE_SYNTAX[name]}" if name in _VALUE_SYNTAX else ""
        problem = "is no file" if file.exists() else "does not exist"
        raise InputError(f"{text} for {name.replace('_', ' ')} {problem}; give an image file{constant}")
    return file


def load_pixels(path: Path) -> tuple[Array, bool]:
    """Pixels (H, W, C) of an image, and whether they are linear."""
    if path.suffix.lower() in (".exr", ".hdr"):
        return read_hdr(path), True
    return read_ldr(path), False


def load_color(value: Path | tuple[float, float, float]) -> Array:
    """Linear colour (H, W, 3) of an image, or (3,) of a constant."""
    if not isinstance(value, Path):
        return _in_unit_range(value, "base_color")
    pixels, linear = load_pixels(value)
    pixels = pixels if pixels.shape[2] >= 3 else np.repeat(pixels[..., :1], 3, axis=2)
    return pixels[..., :3] if linear else srgb_to_linear(pixels[..., :3])


def load_scalar(value: Path | float, name: str) -> Array:
    """Roughness or metalness (H, W) of an image, or () of a constant."""
    if not isinstance(value, Path):
        return _in_unit_range(value, name)
    pixels, _ = load_pixels(value)
    # In a packed image (occlusion, roughness, metalness) the channel of glTF.
    channel = {"roughness": 1, "metallic": 2}[name] if pixels.shape[2] >= 3 else 0
    return np.ascontiguousarray(pixels[..., channel])


def _in_unit_range(value: float | tuple[float, float, float], name: str) -> Array:
    numbers = np.asarray(value, np.float32)
    if not (np.isfinite(numbers).all() and numbers.min() >= 0 and numbers.max() <= 1):
        raise InputError(f"{name} is {value}; it must be from 0 to 1")
    return numbers


def load_normal_map(path: Path, scale: float = 1.0) -> NDArray[np.float32]:
    """Unit vectors (H, W, 3) of a normal map, green up, whose x and y are multiplied by `scale` first."""
    pixels, linear = load_pixels(path)
    if pixels.shape[2] < 3:
        raise InputError(f"{path} is a grey image; a normal map has three channels")
    vectors = np.asarray(pixels[..., :3] if linear else pixels[..., :3] * 2 - 1, np.float32)
    vectors = vectors * np.array([scale, scale, 1], np.float32)
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-3, vectors / np.maximum(length, 1e-3), np.array([0, 0, 1], np.float32))
