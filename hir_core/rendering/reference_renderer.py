"""The reference renderer: the one that measures and shows every result, whichever renderer fitted it."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray

from hir_core.capture import Camera
from hir_core.errors import PluginError
from hir_core.scene import EnvironmentMap, Scene

if TYPE_CHECKING:
    from hir_exporters.asset import AssetEnvironment

    from hir_core.plugins.interfaces import ReflectanceRenderer
    from hir_core.plugins.manager import PluginManager


DIRECT_DEPTH = 2
"""`max_depth` for direct light alone, as Mitsuba counts it."""


def reference_renderer(
    plugins: PluginManager,
    name: str = "",
    options: Mapping[str, Any] | None = None,
    bounces: int | None = None,
    max_samples: int | None = None,
    light: EnvironmentMap | AssetEnvironment | None = None,
) -> tuple[str, ReflectanceRenderer]:
    """Name and instance of the renderer `name`; without a name, of the installed one with the trait `reference`.

    `bounces` is the number of interreflections in the run's model. It sets the renderer's option `max_depth`, where
    there is one and `options` do not set it: the albedo of a fit without interreflections already contains them, so
    they must not be added again. `max_samples` limits the paths per pixel, where there is an option `render_samples`.
    `light` is that of the scenes to be rendered. `PluginError` where no installed renderer has the trait, and where the
    renderer does not shade the light (`check_light`).
    """
    if not name:
        references = [r for r in plugins.components("reflectance_renderer") if "reference" in r.component.traits]
        if not references:
            raise PluginError("no reflectance renderer has the trait 'reference'; name one with --renderer")
        name = references[0].component.name
    check_light(plugins, name, light)
    chosen = dict(options or {})
    known = getattr(plugins.find("reflectance_renderer", name).component.config, "__dataclass_fields__", {})
    if bounces is not None and "max_depth" in known:
        chosen.setdefault("max_depth", DIRECT_DEPTH + bounces)
    if max_samples is not None and "render_samples" in known:
        chosen.setdefault("render_samples", min(known["render_samples"].default, max_samples))
    return name, plugins.create("reflectance_renderer", name, chosen)


def check_light(plugins: PluginManager, renderer: str, light: EnvironmentMap | AssetEnvironment | None) -> None:
    """`PluginError` where a light has a lamp near the camera and the renderer would leave it out."""
    if light is None or light.lamp is None:
        return
    if "camera_lamp" not in plugins.find("reflectance_renderer", renderer).component.traits:
        raise PluginError(
            f"the reflectance renderer {renderer!r} does not shade the lamp near the camera of the photographs: it "
            "lacks the trait 'camera_lamp'; name another renderer, or fit without a lamp: "
            "--set reflectance.light_frame=camera"
        )


def render_view(renderer: ReflectanceRenderer, scene: Scene, camera: Camera, label: str) -> NDArray[np.float32]:
    """Linear premultiplied RGBA (H, W, 4); equal labels have equal noise, whatever was rendered before."""
    torch.manual_seed(zlib.crc32(label.encode()))
    with torch.no_grad():
        image = renderer.render(scene, camera)
    return np.nan_to_num(image.detach().cpu().numpy().astype(np.float32), nan=0.0, posinf=0.0, neginf=0.0)
