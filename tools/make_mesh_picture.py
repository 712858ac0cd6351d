"""Composes a picture of meshes: `python tools/make_mesh_picture.py CAPTURE OUT --mesh LABEL FILE … [--views 0 1]`.

A row a view: the photograph, then each mesh in that view, lit by a lamp beside the camera. CAPTURE has
transforms_train.json or another file that `hir` reads; each FILE is a mesh in the capture's axes.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import trimesh
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from hir_core.capture import Camera
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.manager import PluginManager

SIDE, TITLE = 260, 26
PAPER, INK = (246, 245, 242), (70, 78, 96)
LAMP = np.array([0.45, -0.45, -0.77])
"""Direction towards the lamp in the camera's axes (x right, y down, z forward)."""


def lit(mesh: trimesh.Trimesh, camera: Camera) -> NDArray[np.uint8]:
    """(SIDE, SIDE, 3): the flat triangles in grey."""
    queries = MeshQueries(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces))
    x, y = (np.arange(SIDE) + 0.5) * camera.width / SIDE, (np.arange(SIDE) + 0.5) * camera.height / SIDE
    origins, directions = camera.rays(np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2))
    face = queries.first_faces(origins, directions)
    hit = face >= 0
    normal = np.asarray(mesh.face_normals)[face[hit]]
    toward = LAMP @ camera.world_to_camera[:3, :3]
    picture = np.tile(np.array(PAPER, np.uint8), (SIDE * SIDE, 1))
    value = linear_to_srgb(0.06 + 0.7 * np.abs(normal @ toward) ** 1.5)
    picture[hit] = (255 * np.clip(value, 0, 1)).astype(np.uint8)[:, None]
    return picture.reshape(SIDE, SIDE, 3)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--mesh", nargs=2, action="append", required=True, metavar=("LABEL", "FILE"))
    parser.add_argument("--views", type=int, nargs="+", default=[0, 1])
    given = parser.parse_args()
    views = read_capture(given.capture, "train", PluginManager.discover()).views
    columns = ["photograph", *(label for label, _ in given.mesh)]
    meshes = [trimesh.load_mesh(file, process=False) for _, file in given.mesh]
    sheet = Image.new("RGB", (len(columns) * SIDE, len(given.views) * SIDE + TITLE), PAPER)
    draw, font = ImageDraw.Draw(sheet), ImageFont.load_default(14)
    for i, name in enumerate(columns):
        draw.text((i * SIDE + 8, 5), name, fill=INK, font=font)
    for row, index in enumerate(given.views):
        view = views[index]
        if view.camera is None:
            parser.error(f"view {index} of {given.capture} has no camera")
        pixels = view.pixels(1)
        color = linear_to_srgb(np.clip(pixels.color_linear, 0, 1))
        if pixels.mask is not None:
            mask = pixels.mask[..., None]
            color = color * mask + np.array(PAPER) / 255 * (1 - mask)
        photograph = Image.fromarray((255 * color).astype(np.uint8)).resize((SIDE, SIDE), Image.Resampling.LANCZOS)
        pictures = [photograph, *(Image.fromarray(lit(mesh, view.camera)) for mesh in meshes)]
        for column, picture in enumerate(pictures):
            sheet.paste(picture, (column * SIDE, TITLE + row * SIDE))
    given.out.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(given.out, quality=88)


if __name__ == "__main__":
    main()
