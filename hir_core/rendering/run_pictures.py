"""`hir render`: pictures of a finished run."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import write_exr, write_png

from hir_core.capture import Array, Camera, EnvironmentSource
from hir_core.errors import InputError
from hir_core.files.file_names import file_stem
from hir_core.metrics import unassociate
from hir_core.rendering.reference_renderer import (
    light_of,
    open_for_rendering,
    parse_light,
    reference_renderer,
    render_view,
)
from hir_core.run.run_directory import RunDirectory

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager


def render_pictures(
    directory: RunDirectory,
    plugins: PluginManager,
    folder: Path,
    views: Sequence[str] = (),
    orbit: int = 0,
    elevation: float = 20.0,
    size: int = 512,
    relight: str = "",
    renderer: str = "",
    options: dict[str, Any] | None = None,
    exr: bool = False,
) -> Iterator[Path]:
    """Writes one PNG (sRGB, unassociated alpha) after the other into `folder` and yields its path."""
    run = open_for_rendering(directory)
    cameras = {}
    known = run.cameras()
    for name in views:
        if name not in known:
            raise InputError(f"{directory.path} has no view {name!r}; it has: {', '.join(list(known)[:8])}, …")
        cameras[file_stem(name)] = known[name]
    cameras |= {f"orbit_{i:03d}": camera for i, camera in enumerate(orbit_cameras(orbit, elevation, size))}
    scene = run.scene
    if relight:
        path, strength = parse_light(relight)
        scene = run.lit_by(light_of(EnvironmentSource(path, strength), np.eye(4)))
    _, chosen = reference_renderer(plugins, renderer, options, run.bounces)
    for name, camera in cameras.items():
        image = render_view(chosen, scene, camera, name)
        color, coverage = unassociate(image)
        encoded = np.asarray(linear_to_srgb(np.clip(color, 0, 1)), dtype=np.float32)
        write_png(folder / f"{name}.png", np.concatenate([encoded, coverage[..., None]], axis=-1))
        if exr:
            write_exr(folder / f"{name}.exr", image)
        yield folder / f"{name}.png"


def orbit_cameras(count: int, elevation_deg: float, size: int, distance: float = 3.2) -> list[Camera]:
    """`count` square cameras around the object of radius 1 at the origin, the first at +Z, going towards +X."""
    # the sphere of radius 1 just fits: half the field of view is asin(1 / distance), with a tenth to spare
    focal = size / 2 / (1.1 * np.tan(np.arcsin(1 / distance)))
    intrinsics = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1.0]])
    cameras = []
    for angle in np.arange(count) * (2 * np.pi / max(count, 1)):
        tilt = np.radians(elevation_deg)
        place = distance * np.array([np.sin(angle) * np.cos(tilt), np.sin(tilt), np.cos(angle) * np.cos(tilt)])
        cameras.append(Camera(intrinsics, look_at(place), size, size))
    return cameras


def look_at(place: Array) -> Array:
    """4×4 world_to_camera of a camera at `place` (3,) that looks at the origin, +Y up in its picture."""
    forward = -place / np.linalg.norm(place)
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    pose[:3, 3] = -pose[:3, :3] @ place
    return pose
