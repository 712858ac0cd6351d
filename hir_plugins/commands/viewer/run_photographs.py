"""The photographs of a run and their cameras, in the form that the viewer's page compares the asset with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hir_exporters.scene_format import load_scene

from hir_core.files.contained_files import regular_file_within
from hir_core.files.file_names import file_stem
from hir_core.run.capture_store import read_cameras


@dataclass(frozen=True)
class PagePhotograph:
    """An undistorted photograph over black, and its camera in three.js' convention (it looks along -z, y up)."""

    name: str
    png: bytes
    width: int
    height: int
    fov_y_deg: float
    offset: tuple[float, float]
    """Image centre minus principal point (x, y), pixels."""
    camera_to_world: tuple[float, ...]
    """The 4×4 matrix column by column, (16,)."""


def first_camera_direction(run: Path) -> list[float] | None:
    """From the middle of the asset's bounding box to the run's first camera (3,); None if `run` is no run directory."""
    if not (run / "capture" / "cameras.json").is_file() or not (run / "scene" / "scene.json").is_file():
        return None
    cameras = read_cameras(run / "capture" / "cameras.json")
    positions = load_scene(run / "scene").mesh.positions
    middle = (positions.min(axis=0) + positions.max(axis=0)) / 2
    first = next(iter(cameras.values()), None)
    return None if first is None else [float(x) for x in first.center - middle]


def run_photographs(run: Path) -> list[PagePhotograph]:
    """The photographs that the run's report stores; empty if `run` is no run directory or has no report."""
    if not (run / "capture" / "cameras.json").is_file() or not (run / "report").is_dir():
        return []
    photographs = []
    for name, camera in read_cameras(run / "capture" / "cameras.json").items():
        file = run / "report" / f"{file_stem(name)}_true.png"
        if not file.is_file():
            continue
        regular_file_within(run, file)
        camera_to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1, -1, 1])
        focal, center = camera.intrinsics[1, 1], camera.intrinsics[:2, 2]
        photographs.append(
            PagePhotograph(
                name=name,
                png=file.read_bytes(),
                width=camera.width,
                height=camera.height,
                fov_y_deg=float(np.degrees(2 * np.arctan(camera.height / (2 * focal)))),
                offset=(camera.width / 2 - float(center[0]), camera.height / 2 - float(center[1])),
                camera_to_world=tuple(camera_to_world.T.reshape(-1).tolist()),
            )
        )
    return photographs
