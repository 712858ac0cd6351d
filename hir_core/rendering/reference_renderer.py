"""Opens a finished run for looking at it: the scene in the working frame, the renderer, cameras, lights."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from hir_exporters.scene_format import load_scene
from hir_exporters.textures.image_files import read_hdr
from numpy.typing import NDArray

from hir_core.capture import Array, Camera, Capture, EnvironmentSource
from hir_core.capture.capture_store import read_cameras
from hir_core.errors import InputError, PluginError
from hir_core.intake.reader_lookup import read_capture
from hir_core.run.run_directory import RunDirectory
from hir_core.scene import EnvironmentMap, Scene
from hir_core.scene.asset_conversion import scene_from_asset
from hir_core.scene.frames import move_scene

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import ReflectanceRenderer
    from hir_core.plugins.manager import PluginManager


DIRECT_DEPTH = 2
"""`max_depth` of direct light alone, in Mitsuba's count."""


@dataclass(frozen=True)
class OpenRun:
    """A finished run in its working frame (object at the origin, radius 1), whatever scale its files have."""

    directory: RunDirectory
    document: dict[str, Any]
    scene: Scene
    working_from_asset: Array
    asset_from_source: Array

    @property
    def bounces(self) -> int | None:
        """Reflections between parts of the object that the fit modelled; None where its stage does not say."""
        report = self.document.get("stages", {}).get("reflectance", {}).get("report", {})
        bounces = report.get("bounces")
        return bounces if isinstance(bounces, int) else None

    @property
    def capture_path(self) -> Path:
        """The folder of photographs that the run was made from."""
        return Path(self.document["capture"]["path"])

    def cameras(self) -> dict[str, Camera]:
        """The run's own cameras by view name, in the working frame."""
        found = read_cameras(self.directory.cameras)
        return {name: camera.transformed(self.working_from_asset) for name, camera in found.items()}

    def read(self, path: Path, split: str, plugins: PluginManager) -> Capture:
        """A split of a capture, moved from its own axes to the working frame."""
        reader = self.document["capture"].get("reader", "auto") if path == self.capture_path else "auto"
        capture = read_capture(path, split, plugins, reader)
        working_from_source = self.working_from_asset @ self.asset_from_source
        return capture.transformed(working_from_source @ np.linalg.inv(capture.world_from_source))

    def lit_by(self, light: EnvironmentMap) -> Scene:
        """The scene under another light."""
        return replace(self.scene, environment=light)


def open_for_rendering(directory: RunDirectory, device: str = "cpu") -> OpenRun:
    """Reads run.json and scene/; an error where the run has no finished scene."""
    document = directory.read_run()
    if not directory.scene.is_dir():
        raise InputError(f"{directory.path} has no finished scene; finish it with: hir reconstruct … --resume")
    try:
        asset_from_working = np.array(document["asset_from_working"], dtype=np.float64).reshape(4, 4)
        asset_from_source = np.array(document["asset_from_source"], dtype=np.float64).reshape(4, 4)
        working_from_asset = np.linalg.inv(asset_from_working)
    except (KeyError, TypeError, ValueError, np.linalg.LinAlgError) as error:
        raise InputError(f"{directory.path / 'run.json'}: the frames of the run are malformed ({error})") from error
    scene = move_scene(scene_from_asset(load_scene(directory.scene)), working_from_asset)
    return OpenRun(directory, document, scene.to(device), working_from_asset, asset_from_source)


def reference_renderer(
    plugins: PluginManager,
    name: str = "",
    options: dict[str, Any] | None = None,
    bounces: int | None = None,
    most_samples: int | None = None,
) -> tuple[str, ReflectanceRenderer]:
    """The renderer of that name, else the installed one with the trait `reference`.

    `bounces` are the reflections that the run's model has: where the renderer's options have a `max_depth`, and none is
    given, light is reflected as often. A fit of direct light has taken further reflections into its albedo already.
    At most `most_samples` go through a pixel of a picture, where the renderer's options have `render_samples`.
    """
    if not name:
        found = [r for r in plugins.components("reflectance_renderer") if "reference" in r.component.traits]
        if not found:
            raise PluginError("no reflectance renderer has the trait 'reference'; name one with --renderer")
        name = found[0].component.name
    given = dict(options or {})
    known = getattr(plugins.find("reflectance_renderer", name).component.config, "__dataclass_fields__", {})
    if bounces is not None and "max_depth" in known:
        given.setdefault("max_depth", DIRECT_DEPTH + bounces)
    if most_samples is not None and "render_samples" in known:
        given.setdefault("render_samples", min(known["render_samples"].default, most_samples))
    return name, plugins.create("reflectance_renderer", name, given)


def render_view(renderer: ReflectanceRenderer, scene: Scene, camera: Camera, label: str) -> NDArray[np.float32]:
    """Linear premultiplied RGBA (H, W, 4); the same noise for the same `label`, whatever was rendered before."""
    torch.manual_seed(zlib.crc32(label.encode()))
    with torch.no_grad():
        image = renderer.render(scene, camera)
    return np.nan_to_num(image.detach().cpu().numpy().astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)


def light_of(source: EnvironmentSource, world_from_source: Array, device: str = "cpu") -> EnvironmentMap:
    """The light that a capture names, in the world that `world_from_source` leads to, strength included."""
    radiance = read_hdr(source.path) * np.float32(source.strength)
    linear = world_from_source[:3, :3]
    rotation = linear / np.cbrt(np.linalg.det(linear))
    to_world = rotation @ np.asarray(source.source_from_environment, dtype=np.float64)
    return EnvironmentMap(
        torch.from_numpy(np.ascontiguousarray(radiance)).to(device),
        torch.from_numpy(to_world.astype(np.float32)).to(device),
        "world",
    )


def same_light(a: EnvironmentSource | None, b: EnvironmentSource | None) -> bool:
    """Do two splits name the same light? Files are compared by what they hold, for captures copy them."""
    if a is None or b is None:
        return a is b
    return (
        a.strength == b.strength
        and np.allclose(a.source_from_environment, b.source_from_environment)
        and (a.path == b.path or a.path.read_bytes() == b.path.read_bytes())
    )


def parse_light(text: str) -> tuple[Path, float]:
    """`FILE` or `FILE*STRENGTH`."""
    name, star, strength = text.rpartition("*")
    if not star:
        return Path(text), 1.0
    try:
        value = float(strength)
    except ValueError:
        raise InputError(f"{text!r}: after * comes the light's strength, a number, such as studio.hdr*0.5") from None
    if not (np.isfinite(value) and value >= 0):
        raise InputError(f"{text!r}: the light's strength must be a finite number of at least 0")
    return Path(name), value
