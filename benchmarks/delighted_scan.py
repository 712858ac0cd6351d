"""`hir delight` on made scans: a capture's true mesh with a texture that has the light baked in, and cameras as a
scanning program exports them.

    python -m benchmarks.delighted_scan CAPTURE… --workspace DIR [--cameras metashape] [--store FILE]
    python -m benchmarks.delighted_scan --table FILE

Makes DIR/NAME/scan.obj and DIR/NAME/photos/, runs the command in a process of its own, and evaluates the run under the
lights of the capture. One line is stored for each capture: seconds of the stages, PSNR of the new material and of the
baked texture (both scaled per channel), PSNR of the albedo, whether the exported .glb has the texture coordinates and
the triangles of the scan, with commit, date and machine.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
import trimesh
from hir_exporters.textures.bilinear import sample_bilinear
from hir_exporters.textures.image_files import write_png
from numpy.typing import NDArray

from benchmarks.hir_command import hir
from benchmarks.stored_rows import add_rows, provenance, stored_rows
from hir_core.capture import Camera, Capture
from hir_core.intake.reader_lookup import read_capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.mesh.texel_rasterization import TexelSurface, dilate, texel_surface
from hir_core.plugins.manager import PluginManager
from hir_core.scene import Mesh, Topology
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.atlas import unwrap_mesh

TEXTURE_SIDE = 1024
SURFACE_OFFSET = 1e-3
"""Of the start of a ray, as a share of the mesh's size."""
MIN_COSINE = 0.2
"""Between normal and view direction: photographs from the side are not baked."""
LIGHTS = ("relight_0", "relight_1")
EVALUATED_VIEWS = 6
TRUE_ALBEDO = "albedo_test"
"""The split of captures that have the true albedo."""
FILM_WIDTH_MM = 36.0
"""Of the camera whose focal length RealityScan states."""


def baked_texture(mesh: Mesh, capture: Capture, cameras: Sequence[Camera]) -> NDArray[np.float32]:
    """Mean linear colour (H, W, 3) of the photographs in each texel, as scanning programs blend them."""
    surface = texel_surface(mesh, TEXTURE_SIDE)
    positions = surface.position.numpy().astype(np.float64)
    normals = surface.normal.numpy().astype(np.float64)
    total, weights = np.zeros((len(positions), 3)), np.zeros(len(positions))
    size = float(np.ptp(mesh.positions.numpy(), axis=0).max())
    queries = MeshQueries(mesh.positions.numpy(), mesh.faces.numpy())
    for view, camera in zip(capture.views, cameras, strict=True):
        toward = camera.center - positions
        distance = np.linalg.norm(toward, axis=1)
        direction = toward / distance[:, None]
        cosine = (normals * direction).sum(axis=1)
        origin = positions + normals * SURFACE_OFFSET * size
        seen = np.flatnonzero(cosine > MIN_COSINE)
        seen = seen[~queries.occluded(origin[seen], direction[seen], reach=float(distance.max()))]
        at, _ = camera.project(positions[seen])
        total[seen] += sample_bilinear(view.pixels().color_linear, at[:, 0] - 0.5, at[:, 1] - 0.5)
        weights[seen] += 1
    return _texture(surface, total / np.maximum(weights, 1)[:, None])


def _texture(surface: TexelSurface, values: NDArray[np.float64]) -> NDArray[np.float32]:
    texture = torch.zeros(*surface.covered.shape, 3)
    texture[surface.covered] = torch.from_numpy(values.astype(np.float32))
    return dilate(texture, surface.covered, 8).numpy()


def write_scan(folder: Path, mesh: Mesh, texture: NDArray[np.float32]) -> None:
    """`scan.obj` with its material and its picture."""
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    encoded = linear_to_srgb(torch.from_numpy(texture).clamp(0, 1)).numpy()
    write_png(folder / "scan.png", encoded)
    (folder / "scan.mtl").write_text("newmtl scan\nmap_Kd scan.png\n", encoding="utf-8")
    lines = ["mtllib scan.mtl", "usemtl scan"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in mesh.positions.tolist()]
    lines += [f"vt {u:.9g} {1 - v:.9g}" for u, v in mesh.uvs.tolist()]
    corners = zip((mesh.faces + 1).tolist(), (mesh.topology.uv_faces + 1).tolist(), strict=True)
    lines += ["f " + " ".join(f"{v}/{t}" for v, t in zip(*face, strict=True)) for face in corners]
    (folder / "scan.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_xmp(folder: Path, cameras: Mapping[str, Camera]) -> None:
    """Sidecars of RealityScan."""
    for name, camera in cameras.items():
        (fx, _, cx), (_, _, cy), _ = camera.intrinsics.tolist()
        u, v = ((c - side / 2) / camera.width for c, side in ((cx, camera.width), (cy, camera.height)))
        rotation = " ".join(map(repr, camera.world_to_camera[:3, :3].ravel().tolist()))
        (folder / f"{name}.xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
            '<rdf:Description xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" xcr:DistortionModel="brown3" '
            f'xcr:FocalLength35mm="{fx / camera.width * FILM_WIDTH_MM!r}" xcr:PrincipalPointU="{u!r}" '
            f'xcr:PrincipalPointV="{v!r}"><xcr:Rotation>{rotation}</xcr:Rotation>'
            f"<xcr:Position>{' '.join(map(repr, camera.center.tolist()))}</xcr:Position>"
            "<xcr:DistortionCoeficients>0 0 0 0 0 0</xcr:DistortionCoeficients></rdf:Description></rdf:RDF>"
            "</x:xmpmeta>",
            encoding="utf-8",
        )


def write_metashape(folder: Path, cameras: Mapping[str, Camera]) -> None:
    """The cameras as an XML file of Metashape, with one sensor for each photograph."""
    sensors, entries = [], []
    for number, (name, camera) in enumerate(cameras.items()):
        (fx, _, cx), (_, _, cy), _ = camera.intrinsics.tolist()
        size = f'<resolution width="{camera.width}" height="{camera.height}"/>'
        offsets = f"<cx>{cx - camera.width / 2!r}</cx><cy>{cy - camera.height / 2!r}</cy>"
        lens = f'<calibration type="frame" class="adjusted">{size}<f>{fx!r}</f>{offsets}</calibration>'
        sensors.append(f'<sensor id="{number}" type="frame">{size}{lens}</sensor>')
        pose = " ".join(map(repr, np.linalg.inv(camera.world_to_camera).ravel().tolist()))
        entries.append(
            f'<camera id="{number}" sensor_id="{number}" label="{name}"><transform>{pose}</transform></camera>'
        )
    (folder / "cameras.xml").write_text(
        f'<document version="2.0.0"><chunk label="scan"><sensors>{"".join(sensors)}</sensors>'
        f"<cameras>{''.join(entries)}</cameras></chunk></document>",
        encoding="utf-8",
    )


CAMERA_FILES: dict[str, Callable[[Path, Mapping[str, Camera]], None]] = {
    "reality_capture": write_xmp,
    "metashape": write_metashape,
}


def make_scan(source: Path, folder: Path, program: str, plugins: PluginManager) -> None:
    """`scan.obj` and `photos/` of a capture with a true mesh, in the axes of its files; its masks are left out."""
    capture = read_capture(source, "train", plugins)
    source_from_world = np.linalg.inv(capture.world_from_source)
    cameras = [camera.transformed(source_from_world) for camera in capture.cameras]
    loaded = trimesh.load(source / "reference.obj", process=False, force="mesh")
    assert isinstance(loaded, trimesh.Trimesh)
    loaded.merge_vertices(merge_tex=True, merge_norm=True)
    faces = torch.from_numpy(np.asarray(loaded.faces, np.int64))
    mesh = Mesh(torch.from_numpy(np.asarray(loaded.vertices, np.float32)), Topology(faces))
    mesh, _ = unwrap_mesh(mesh, TEXTURE_SIDE)
    photos = folder / "photos"
    photos.mkdir(parents=True, exist_ok=True)
    for view in capture.views:
        encoded = linear_to_srgb(torch.from_numpy(view.pixels().color_linear).clamp(0, 1)).numpy()
        write_png(photos / f"{view.name}.png", encoded)
    CAMERA_FILES[program](photos, {view.name: camera for view, camera in zip(capture.views, cameras, strict=True)})
    write_scan(folder, mesh, baked_texture(mesh, capture, cameras))
    made = read_capture(photos, "train", plugins)
    back = np.linalg.inv(made.world_from_source)
    read = {view.name: camera.transformed(back) for view, camera in zip(made.views, made.cameras, strict=True)}
    for view, camera in zip(capture.views, cameras, strict=True):
        np.testing.assert_allclose(read[view.name].world_to_camera, camera.world_to_camera, atol=1e-6)
        np.testing.assert_allclose(read[view.name].intrinsics, camera.intrinsics, atol=1e-3)


def keeps_triangles(scan: Path, exported: Path) -> bool:
    """Whether all corners have the scan's texture coordinates, bit for bit in float32, triangle by triangle."""
    corners = []
    for file in (scan, exported):
        mesh = trimesh.load(file, process=False, force="mesh")
        assert isinstance(mesh, trimesh.Trimesh)
        corners.append(np.asarray(mesh.visual.uv, np.float32)[mesh.faces])  # type: ignore[union-attr]
    return corners[0].tobytes() == corners[1].tobytes()


def measured(source: Path, folder: Path, program: str, seed: int, plugins: PluginManager) -> dict[str, Any]:
    """The line of one capture; the scan is made where it is missing, an earlier run is replaced."""
    scan, run = folder / "scan.obj", folder / f"run_{seed}"
    if not scan.exists():
        make_scan(source, folder, program, plugins)
    shutil.rmtree(run, ignore_errors=True)
    seconds = hir("delight", scan, folder / "photos", "-o", run, "--seed", str(seed), "--set", 'export=["glb"]')
    for light in LIGHTS:
        hir("evaluate", run, source, "--split", light, "--views", str(EVALUATED_VIEWS), "-q")
    has_albedo = (source / f"transforms_{TRUE_ALBEDO}.json").exists()
    hir("evaluate", run, source, "--split", "test", "-q", *(("--albedo", TRUE_ALBEDO) if has_albedo else ()))
    document = json.loads((run / "run.json").read_text(encoding="utf-8"))
    stages = json.loads((run / "timings.json").read_text(encoding="utf-8"))["stages"]
    files = {split: run / "evaluation" / split / "metrics.json" for split in ("test", *LIGHTS)}
    metrics = {split: json.loads(file.read_text(encoding="utf-8")) for split, file in files.items()}
    return {
        "capture": source.name,
        "cameras": program,
        "seed": seed,
        "seconds": round(seconds, 1),
        "stage_seconds": {name: round(stage["seconds"], 1) for name, stage in stages.items()},
        "model": document["stages"]["reflectance"]["report"]["model"],
        "unseen": metrics["test"]["psnr"],
        "albedo": metrics["test"].get("albedo"),
        "relit": {light: metrics[light]["psnr_scaled"] for light in LIGHTS},
        "relit_unscaled": {light: metrics[light]["psnr"] for light in LIGHTS},
        "baked": {light: metrics[light]["scan_texture"]["psnr_scaled"] for light in LIGHTS},
        "keeps_triangles": keeps_triangles(scan, next((run / "exports").glob("*.glb"))),
        "command": "hir delight scan.obj photos -o RUN",
        **provenance(),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: seconds, and decibels of pixels of the object, scaled per channel but for unseen views."""
    lines = [
        "| capture | seconds | selected model | unseen | albedo | relit 0: baked | new | relit 1: baked | new |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in rows:
        relit = [f"{row[kind][light]['object']:.1f}" for light in LIGHTS for kind in ("baked", "relit")]
        albedo = "–" if row["albedo"] is None else f"{row['albedo']['psnr_scaled']:.1f}"
        decibels = [f"{row['unseen']['object']:.1f}", albedo, *relit]
        lines.append("| " + " | ".join([row["capture"], f"{row['seconds']:.0f}", row["model"], *decibels]) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--workspace", type=Path, help="folder of the scans and the runs")
    parser.add_argument("--cameras", choices=sorted(CAMERA_FILES), default="reality_capture")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--store", type=Path, help="file to which lines are added")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parser.parse_args()
    if options.table is not None:
        print(table(stored_rows(options.table)))
        return
    if not options.captures or options.workspace is None:
        parser.error("name captures and --workspace, or --table")
    plugins = PluginManager.discover()
    for source in options.captures:
        row = measured(source, options.workspace / source.name, options.cameras, options.seed, plugins)
        if options.store is None:
            print(json.dumps(row, indent=2))
        else:
            add_rows(options.store, [row])


if __name__ == "__main__":
    main()
