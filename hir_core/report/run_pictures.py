"""`hir render`: renders of a finished run from its own cameras or from an orbit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import write_exr, write_png

from hir_core.capture import EnvironmentSource
from hir_core.errors import InputError
from hir_core.files.file_names import file_stem
from hir_core.files.light_setting import parse_light_file
from hir_core.metrics import unassociate
from hir_core.rendering.light_files import load_light
from hir_core.rendering.orbit_cameras import orbit_cameras
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.run.finished_run import open_finished_run
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
    options: Mapping[str, Any] | None = None,
    exr: bool = False,
) -> Iterator[Path]:
    """Writes PNGs (sRGB, unassociated alpha) into `folder`, one by one, and yields the paths of all files.

    `views` are names of the run's photographs; `orbit` is a number of cameras around the object at `elevation` degrees,
    with `size`² pixels. `exr` adds linear premultiplied files. `InputError` where a view does not exist.
    """
    run = open_finished_run(directory)
    cameras, takes = {}, {}
    run_cameras = run.cameras()
    run_takes = {}
    if views and run.scene.take_radiance:
        run_takes = {v.name: v.take for v in run.views_of_split(run.capture_path, "train", plugins).views}
    for name in views:
        if name not in run_cameras:
            raise InputError(
                f"{directory.path} has no view {name!r}; its views are: {', '.join(list(run_cameras)[:8])}"
                + (", …" if len(run_cameras) > 8 else "")
            )
        cameras[file_stem(name)] = run_cameras[name]
        if run_takes:
            takes[file_stem(name)] = run_takes[name]
    cameras |= {f"orbit_{i:03d}": camera for i, camera in enumerate(orbit_cameras(orbit, elevation, size))}
    scene = run.scene
    if relight:
        path, strength = parse_light_file(relight)
        device = str(scene.mesh.positions.device)
        scene = run.with_light(load_light(EnvironmentSource(path, strength), np.eye(4), device))
    _, path_tracer = reference_renderer(plugins, renderer, options, run.bounces, light=scene.environment)
    in_take = cache(scene.in_take)
    for name, camera in cameras.items():
        take = takes.get(name)
        image = render_view(path_tracer, scene if take is None else in_take(take), camera, name)
        color, coverage = unassociate(image)
        encoded = np.asarray(linear_to_srgb(np.clip(color, 0, 1)), dtype=np.float32)
        write_png(folder / f"{name}.png", np.concatenate([encoded, coverage[..., None]], axis=-1))
        if exr:
            write_exr(folder / f"{name}.exr", image)
        yield folder / f"{name}.png"
        if exr:
            yield folder / f"{name}.exr"
