"""Composes a picture of meshes and their normals: `python tools/make_normals_picture.py OUT --runs BEFORE AFTER …`.

A row a pair of runs of one capture, which may end with the geometry stage: a photograph, the mesh of each run, and the
colours of its normals, in the camera's axes: red is right, green is up, blue is towards the camera. `--views` (numbers
of training views, one a pair) chooses.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from hir_core.capture import Camera, View
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.metrics import composite
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.photographs import masked_photograph
from hir_core.run.capture_store import restore_capture
from hir_core.run.run_directory import open_run
from hir_core.scene import Mesh
from hir_core.scene.scene_store import load_stage_scene

SIDE, GAP, CAPTION = 240, 8, 26
SAMPLES = 3
"""Rays of a pixel along each image axis."""
MARGIN = 1.06
"""Width of a picture, as a multiple of the object's."""
PAPER_COLOR, INK = (246, 245, 242), (90, 92, 98)
PAPER = np.array(PAPER_COLOR, np.float32) / 255
NAMES = ("a photograph", "before", "after", "normals, before", "normals, after")

Picture = NDArray[np.float32]


def shown_view(run: Path, number: int | None, plugins: PluginManager) -> View:
    """A training view with the camera and the mask that the run has."""
    directory = open_run(run)
    found = directory.read_run()["capture"]
    capture = read_capture(Path(found["path"]), "train", plugins, found["reader"])
    capture = restore_capture(capture, directory.stage("initializer"))
    return capture.views[len(capture.views) // 3 if number is None else number]


def fitted_mesh(run: Path) -> Mesh:
    """Of the geometry stage."""
    return load_stage_scene(open_run(run).stage("geometry") / "scene", "cpu").mesh


def drawn(mesh: Mesh, camera: Camera) -> tuple[Picture, Picture]:
    """The flat triangles, lit from the camera, and the colours of their normals (SIDE, SIDE, 3)."""
    positions, faces = mesh.positions.detach().cpu().numpy().astype(np.float64), mesh.faces.cpu().numpy()
    a, b, c = positions[faces].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    x, y = np.meshgrid(*[(np.arange(SIDE * SAMPLES) + 0.5) / SAMPLES] * 2)
    origins, directions = camera.rays(np.stack([x.ravel(), y.ravel()], axis=1))
    face = MeshQueries(positions.astype(np.float32), faces).first_faces(origins, directions)
    hit = face >= 0
    normal, direction = normals[face[hit]], np.broadcast_to(directions, (len(face), 3))[hit]
    in_camera = normal @ camera.world_to_camera[:3, :3].T * np.array([1, -1, -1])
    lit, colored = (np.tile(PAPER, (len(face), 1)) for _ in range(2))
    lit[hit] = (0.3 + 0.65 * np.abs((normal * direction).sum(axis=1)))[:, None]
    colored[hit] = 0.5 + 0.5 * in_camera
    return _reduced(lit), _reduced(colored)


def row(runs: tuple[Path, Path], number: int | None, plugins: PluginManager) -> list[Image.Image]:
    """The pictures of a pair of runs."""
    view = shown_view(runs[0], number, plugins)
    assert view.camera is not None
    photograph = masked_photograph(view)
    picture = composite(photograph.color_linear, photograph.mask) + PAPER * (1 - photograph.mask[..., None])
    rows, columns = (np.flatnonzero((photograph.mask > 0.5).any(axis=axis)) for axis in (1, 0))
    side = MARGIN * max(np.ptp(rows), np.ptp(columns))
    left, top = (float(each.min() + each.max()) / 2 - side / 2 for each in (columns, rows))
    image = Image.fromarray(np.round(np.clip(picture, 0, 1) * 255).astype(np.uint8))
    square = Image.new("RGB", (round(side), round(side)), PAPER_COLOR)
    square.paste(image, (-round(left), -round(top)))
    pictures = [square.resize((SIDE, SIDE), Image.Resampling.LANCZOS)]
    zoom = np.array([[SIDE / side, 0, -left * SIDE / side], [0, SIDE / side, -top * SIDE / side], [0, 0, 1]])
    lit, colored = [], []
    for run in runs:
        # each run may have estimated the cameras itself
        camera = shown_view(run, number, plugins).camera
        assert camera is not None
        near = replace(camera, intrinsics=zoom @ camera.intrinsics, width=SIDE, height=SIDE)
        shaded, of_normals = drawn(fitted_mesh(run), near)
        lit.append(shaded)
        colored.append(of_normals)
    return pictures + [Image.fromarray(np.round(np.clip(each, 0, 1) * 255).astype(np.uint8)) for each in lit + colored]


def main() -> None:
    """Writes the picture."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--runs", type=Path, nargs="+", required=True, metavar="RUN", help="BEFORE AFTER of each row")
    parser.add_argument("--views", type=int, nargs="*", default=[])
    given = parser.parse_args()
    if len(given.runs) % 2:
        parser.error("give two runs for each row")
    plugins = PluginManager.discover()
    pairs = list(zip(given.runs[::2], given.runs[1::2], strict=True))
    numbers: list[int | None] = [*given.views, *[None] * len(pairs)]
    rows = [row(pair, number, plugins) for pair, number in zip(pairs, numbers, strict=False)]
    size = (len(NAMES) * (SIDE + GAP) - GAP, len(rows) * (SIDE + GAP) - GAP + CAPTION)
    sheet = Image.new("RGB", size, PAPER_COLOR)
    draw = ImageDraw.Draw(sheet)
    for j, pictures in enumerate(rows):
        for i, each in enumerate(pictures):
            sheet.paste(each, (i * (SIDE + GAP), j * (SIDE + GAP)))
    for i, name in enumerate(NAMES):
        place = (i * (SIDE + GAP) + SIDE // 2, size[1] - CAPTION // 2)
        draw.text(place, name, fill=INK, font=ImageFont.load_default(15), anchor="mm")
    given.out.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(given.out, quality=88)


def _reduced(fine: NDArray[np.float64] | Picture) -> Picture:
    """(SIDE, SIDE, 3) from rays (N, 3)."""
    return np.asarray(fine.reshape(SIDE, SAMPLES, SIDE, SAMPLES, 3).mean(axis=(1, 3)), np.float32)


if __name__ == "__main__":
    main()
