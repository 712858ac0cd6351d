"""Composes docs/images/wireframes.jpg from finished runs: `python tools/make_wireframe_picture.py RUN…`.

A row a run: a photograph, the first mesh and the fitted one from the same camera, then their triangles from nearer.
`--out` and `--views` (numbers of training views, one a run) choose.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from hir_core.capture import Array, Camera
from hir_core.intake.reader_lookup import read_capture
from hir_core.metrics import composite
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.photographs import masked_photograph
from hir_core.run.capture_store import restore_capture
from hir_core.run.run_directory import RunDirectory, open_run
from hir_core.scene import Mesh
from hir_core.scene.scene_store import load_stage_scene

OUTPUT = Path(__file__).resolve().parent.parent / "docs" / "images" / "wireframes.jpg"
SIDE = 280
SAMPLES = 3
PAPER = np.array([246, 245, 242], np.float32) / 255
INK = np.array([70, 78, 96], np.float32) / 255
LINE_PX = 0.9
ZOOM = 3.5
NAMES = ("a photograph", "first mesh", "fitted mesh", "first, nearer", "fitted, nearer")


def drawn(mesh: Mesh, camera: Camera, lines: bool) -> NDArray[np.float32]:
    """The mesh over the background (H, W, 3), lit from the camera; with `lines`, triangle edges are drawn."""
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    positions, faces = mesh.positions.detach().cpu().numpy(), mesh.faces.cpu().numpy()
    scene.add_triangles(positions.astype(np.float32), faces.astype(np.uint32))
    offsets = (np.arange(SAMPLES) + 0.5) / SAMPLES
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    total = np.zeros((camera.height, camera.width, 3), np.float32)
    for dy in offsets:
        for dx in offsets:
            pixels = np.stack([columns + dx, rows + dy], axis=-1).reshape(-1, 2)
            origins, directions = camera.rays(pixels)
            rays = np.concatenate([np.broadcast_to(origins, directions.shape), directions], axis=1)
            hit = scene.cast_rays(open3d.core.Tensor(rays.astype(np.float32)))
            shade = _shaded(hit, positions, faces, directions, camera, lines)
            total += shade.reshape(total.shape)
    return total / SAMPLES**2


def _shaded(
    hit: dict[str, object], positions: Array, faces: NDArray[np.int64], directions: Array, camera: Camera, lines: bool
) -> NDArray[np.float32]:
    t, face, uv, normal = (
        hit[name].numpy()  # type: ignore[attr-defined]
        for name in ("t_hit", "primitive_ids", "primitive_uvs", "primitive_normals")
    )
    met = np.isfinite(t)
    face = np.where(met, face, 0).astype(np.int64)
    corner = positions[faces[face]]
    weights = np.stack([1 - uv.sum(axis=1), uv[:, 0], uv[:, 1]], axis=1)
    normal_length = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    # distance to the nearest edge: barycentric weight times the height over that edge
    edges = np.linalg.norm(np.roll(corner, 1, axis=1) - np.roll(corner, 2, axis=1), axis=2)
    distance = (weights * normal_length[:, None] / np.maximum(edges, 1e-12)).min(axis=1)
    pixel = np.where(met, t, 1.0) / camera.intrinsics[0, 0]
    line = lines * np.clip(1.2 - distance / (LINE_PX * 0.5 * pixel), 0, 1)[:, None] * 0.55
    facing = np.abs((normal * directions).sum(axis=1))[:, None]
    color = (0.35 + 0.6 * facing) * np.float32([1.0, 0.985, 0.96])
    return np.where(met[:, None], color * (1 - line) + INK * line, PAPER).astype(np.float32)


def row(folder: str, number: int | None, plugins: PluginManager) -> list[Image.Image]:
    """The tiles of a run."""
    directory: RunDirectory = open_run(folder)
    found = directory.read_run()["capture"]
    capture = read_capture(Path(found["path"]), "train", plugins, found["reader"])
    capture = restore_capture(capture, directory.stage("initializer"))
    view = capture.views[len(capture.views) // 3 if number is None else number]
    assert view.camera is not None
    factor = max(1, min(view.camera.width, view.camera.height) // SIDE)
    camera = view.camera.downsampled(factor)
    photograph = masked_photograph(view)
    tiles = [composite(photograph.color_linear, photograph.mask) + PAPER * (1 - photograph.mask[..., None])]
    first, fitted = (
        load_stage_scene(directory.stage(stage) / "scene", "cpu").mesh for stage in ("initializer", "geometry")
    )
    near = nearer(camera, fitted)
    tiles += [
        drawn(first, camera, False),
        drawn(fitted, camera, False),
        drawn(first, near, True),
        drawn(fitted, near, True),
    ]
    return [_square(tile) for tile in tiles]


def nearer(camera: Camera, mesh: Mesh) -> Camera:
    """The same camera looking `ZOOM` times closer at the middle of the mesh."""
    ((x, y),) = camera.project(mesh.positions.detach().cpu().numpy().astype(np.float64).mean(axis=0, keepdims=True))[0]
    zoom = np.array([[ZOOM, 0, SIDE / 2 - ZOOM * x], [0, ZOOM, SIDE / 2 - ZOOM * y], [0, 0, 1]])
    return replace(camera, intrinsics=zoom @ camera.intrinsics, width=SIDE, height=SIDE)


def _square(tile: NDArray[np.float32]) -> Image.Image:
    image = Image.fromarray(np.round(np.clip(tile, 0, 1) * 255).astype(np.uint8))
    side = min(image.size)
    left, top = (image.width - side) // 2, (image.height - side) // 2
    return image.crop((left, top, left + side, top + side)).resize((SIDE, SIDE), Image.Resampling.LANCZOS)


def main() -> None:
    """Writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+")
    parser.add_argument("--out", type=Path, default=OUTPUT)
    parser.add_argument("--views", type=int, nargs="*", default=[])
    options = parser.parse_args()
    plugins = PluginManager.discover()
    views: list[int | None] = [*options.views, *[None] * len(options.runs)]
    rows = [row(folder, number, plugins) for folder, number in zip(options.runs, views, strict=False)]
    gap, caption = 10, 26
    size = (len(NAMES) * (SIDE + gap) - gap, len(rows) * (SIDE + gap) - gap + caption)
    sheet = Image.new("RGB", size, tuple(int(c) for c in PAPER * 255))
    draw = ImageDraw.Draw(sheet)
    for j, tiles in enumerate(rows):
        for i, tile in enumerate(tiles):
            sheet.paste(tile, (i * (SIDE + gap), j * (SIDE + gap)))
    for i, name in enumerate(NAMES):
        place = (i * (SIDE + gap) + SIDE // 2, size[1] - caption // 2)
        draw.text(place, name, fill=(90, 92, 98), font=ImageFont.load_default(15), anchor="mm")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(options.out, quality=88)


if __name__ == "__main__":
    main()
