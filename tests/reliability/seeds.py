"""Small valid files: the seeds of the fuzzers."""

from __future__ import annotations

import io
import json
import os
import platform
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial, AssetMesh
from hir_exporters.scene_format import save_scene
from hir_exporters.textures.image_files import encode_png

from hir_core.capture import Camera, Capture, CoordinateFrames, OrientedPoints, Pixels, View
from hir_core.plugins.progress import MODEL_FITTED, MODELS_COMPARED
from hir_core.run.capture_store import save_capture
from hir_plugins.commands.batch.scheduling.manifest import FORMAT, VERSION, manifest_bytes
from hir_plugins.commands.bench.results.bench_result import Result, Row, Timing

ROOT = Path(__file__).resolve().parents[2]
MESHES = ("obj", "ply", "stl", "off", "glb")
"""Mesh formats of `mesh_file`; `trimesh` reads all of them."""
ASSETS = ("obj", "ply", "glb", "gltf")
_K = np.array([[80.0, 0, 32], [0, 80, 24], [0, 0, 1]])
_POSE = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]])


def corpus(target: str) -> list[bytes]:
    """Broken files of others for a target of meshes, from the folder of test data where there is one."""
    shared = Path(os.environ.get("HIR_SHARED", ROOT.parent / "shared")) / "hostile"
    kind = target.rpartition("_")[2]
    if not target.startswith(("mesh_", "asset_")) or not shared.is_dir():
        return []
    files = [p for p in shared.rglob(f"*.{kind}") if p.stat().st_size < 1 << 20]
    return [path.read_bytes() for path in sorted(files)]


def asset() -> Asset:
    """A square with two textures under a light."""
    mesh = AssetMesh(
        positions=np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32),
        normals=np.tile(np.array([[0, 0, 1]], np.float32), (4, 1)),
        uvs=np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32),
        faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    texture = np.random.default_rng(0).random((4, 4, 3)).astype(np.float32)
    material = AssetMaterial("dielectric", texture, np.full(3, 0.04, np.float32), texture[..., 0] * 0.5 + 0.2)
    return Asset(mesh, material, AssetEnvironment(np.ones((2, 4, 3), np.float32)), {"generator": "test"}, "square")


def scene(folder: Path) -> None:
    """A scene folder."""
    folder.rmdir()
    save_scene(asset(), folder)


def run(folder: Path) -> None:
    """A finished run without its pictures."""
    from hir_core.run.run_directory import STAGE_NAMES, RunDirectory, StageRecord

    directory = RunDirectory(folder)
    stages: dict[str, dict[str, object]] = {
        name: {"report": {"triangles": 12, "iou": 0.9, "warnings": []}, "warnings": ["thin"]} for name in STAGE_NAMES
    }
    frames = CoordinateFrames.identity().as_document()
    stages["initializer"]["report"] = {"views": 3, "frames": frames}
    stages["export"]["report"] = {
        "glb": {"files": ["it.glb"], "residuals": {}, "verified": {"brdf": 0.01, "psnr": {"object": 60.0}}}
    }
    directory.write_run(
        {
            "capture": {
                "path": "/nowhere",
                "name": "it",
                "reader": "photos",
                "split": "train",
                "views": 3,
                "fingerprint": "f",
            },
            "settings": {"preset": "fast", "geometry": {"triangles": 0}},
            "seed": 0,
            "versions": {"hir": "0"},
            "plugins": ["exporter glb"],
            "plugin_problems": [],
            "stages": stages,
            "metrics": {
                "test": {
                    "psnr": {"frame": 30.0, "object": 25.0},
                    "psnr_scaled": {"frame": 30.0, "object": 25.0},
                    "views": [],
                }
            },
        }
    )
    fitted, compared = MODEL_FITTED, MODELS_COMPARED
    ended = [[fitted, 0.5], [compared, 0.5], [fitted, 0.9], [compared, 0.9], [fitted, 1.2], [fitted, 1.6]]
    timed = {
        "geometry": {"seconds": 1.0},
        "reflectance": {"seconds": 2.0, "progress": [[0, 0.1], [10, 1.9]], "milestones": ended},
    }
    directory.write_timings({"machine": {"cores": 2}, "stages": timed, "seconds": 3.0})
    for name in STAGE_NAMES:
        directory.begin(name, "key")
        directory.finish(StageRecord(name, "key", True, {"a": 1}, ()))
    curve = {"held_out_psnr": np.linspace(20, 30, 4), "held_out_psnr@step": np.array([2, 4, 6, 8])}
    np.savez(directory.stage("reflectance") / "curves.npz", **curve)  # type: ignore[arg-type]


def cameras(folder: Path) -> None:
    """capture/cameras.json of a run."""
    from hir_core.run.capture_store import camera_document

    document = camera_document(Camera(_K, _POSE, 64, 48))
    (folder / "cameras.json").write_text(json.dumps({"views": [{"name": "a", "split": "train"} | (document or {})]}))


def settings(folder: Path) -> None:
    """Settings as a file and as on the command line."""
    (folder / "settings.toml").write_text(
        'preset = "fast"\nseed = 3\ninitializers = ["visual_hull", "stereo"]\n[geometry]\nrenderer = "contour"\n'
        "[geometry.regularizers]\nlaplacian = { weight = 1.0 }\nedge_length = false\n"
    )
    (folder / "assignment").write_text("geometry.iterations=100\ninitializers=['colmap']\npreset=paper\n")


def takes(folder: Path) -> None:
    """Photographs in a folder for each take."""
    for take in ("a", "b"):
        (folder / take).mkdir()
        picture(folder / take / "0.png", 4)
    (folder / "takes.toml").write_text('takes = ["a", "b"]\n')


def stage_scene(folder: Path) -> None:
    """The stored result of a stage."""
    import torch

    from hir_core.scene import Mesh, Scene, Topology
    from hir_core.scene.scene_store import save_stage_scene

    folder.rmdir()
    faces = torch.tensor([[0, 1, 2]])
    save_stage_scene(Scene(Mesh(torch.rand(3, 3), Topology(faces, faces), torch.rand(3, 2))), folder)


def checkpoint(folder: Path) -> None:
    """An optimizer state with three parameters."""
    import torch

    from hir_core.optimization.checkpoints import save_checkpoint

    x = torch.zeros(3, requires_grad=True)
    optimizer = torch.optim.Adam([x])
    x.sum().backward()
    optimizer.step()
    save_checkpoint(folder / "state.npz", optimizer, 1, {"notes": np.frombuffer(b"{}", np.uint8)})


def two_views(folder: Path) -> Capture:
    """A capture in memory, one view of it without a mask."""
    black = Pixels(np.zeros((48, 64, 3), np.float32), None, np.zeros((48, 64), bool))
    camera = Camera(_K, _POSE, 64, 48)
    mask = np.ones((48, 64), np.float32)
    return Capture(folder, (View("a", camera, lambda: black, mask=mask), View("b", None, lambda: black)))


def stage_capture(folder: Path) -> None:
    """The capture as the first stage stores it."""
    points = OrientedPoints(np.eye(3), np.eye(3), np.ones((3, 3)))
    save_capture(replace(two_views(folder), points=points), folder)


def scale_bar(folder: Path) -> None:
    """Marks of both ends of a bar."""
    (folder / "bar.txt").write_text("# a bar\nIMG 0012 a 811.5 402\nIMG_0013.jpg b 1e2 -3\n")


def bench(folder: Path) -> None:
    """Figures of a benchmark."""
    timing = Timing(0.1, 0.2, 0.3, 3, 0.15, 1 << 20)
    rows = (
        Row({"size": 10, "kind": "ball"}, "contour", "ours", timing, {"IoU": 0.1, "dB": 30.0}),
        Row({"size": 10, "kind": "ball"}, "other", "peer", None, note="too slow"),
    )
    Result("geometry", rows, {"processor": "one", "cores": 2}, {"hir": "0"}, "2026-01-01").write(
        folder / "geometry.json"
    )


def batch(folder: Path) -> None:
    """The manifest of a batch of two captures, and the lease of the machine that works on it."""
    done = {
        "state": "done",
        "psnr": {"object": 25.0, "frame": 30.0},
        "stage_seconds": {"geometry": 1.5},
        "warnings": ["w"],
    }
    failed = {"state": "failed", "reason": "geometry: no", "retries": 2, "group": "geometry"}
    facts = {"format": FORMAT, "version": VERSION, "started": "today"}
    (folder / "batch.json").write_bytes(manifest_bytes(facts, {"a": done, "b": failed}))
    lease = {"owner": "token", "host": platform.node(), "pid": 1, "renewed": 0.0}
    (folder / "lease.json").write_text(json.dumps(lease))


def transforms(folder: Path) -> None:
    """A capture of one frame, as NeRF-synthetic has them."""
    (folder / "train").mkdir()
    picture(folder / "train" / "r_0.png", 4)
    matrix = np.eye(4)
    matrix[2, 3] = 4.0
    (folder / "transforms_train.json").write_text(
        json.dumps(
            {
                "camera_angle_x": 0.69,
                "w": 64,
                "h": 48,
                "k1": 0.01,
                "fl_x": 80.0,
                "cx": 32.0,
                "environment": {"file_path": "sky.hdr", "strength": 2.0},
                "frames": [{"file_path": "./train/r_0", "transform_matrix": matrix.tolist()}],
            }
        )
    )


def colmap_text(folder: Path) -> None:
    """A COLMAP model of one photograph, as text."""
    (folder / "images").mkdir()
    picture(folder / "images" / "a.png")
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    (sparse / "cameras.txt").write_text("# comment\n1 SIMPLE_RADIAL 64 48 80.0 32.0 24.0 0.01\n")
    (sparse / "images.txt").write_text("1 1.0 0.0 0.0 0.0 0.0 0.0 5.0 1 a.png\n12.5 13.5 1 20.0 21.0 -1\n")
    (sparse / "points3D.txt").write_text("1 0.1 0.2 0.3 200 100 50 0.5 1 0\n")


def colmap_binary(folder: Path) -> None:
    """The same as binary files."""
    import struct

    (folder / "images").mkdir()
    picture(folder / "images" / "a.png")
    sparse = folder / "sparse" / "0"
    sparse.mkdir(parents=True)
    camera = struct.pack("<QiiQQ4d", 1, 1, 2, 64, 48, 80.0, 32.0, 24.0, 0.01)
    image = (
        struct.pack("<Qi7di", 1, 1, 1.0, 0, 0, 0, 0, 0, 5.0, 1) + b"a.png\0" + struct.pack("<Qddq", 1, 12.5, 13.5, 1)
    )
    point = struct.pack("<QQ3d3BdQii", 1, 1, 0.1, 0.2, 0.3, 200, 100, 50, 0.5, 1, 1, 0)
    for name, data in (("cameras", camera), ("images", image), ("points3D", point)):
        (sparse / f"{name}.bin").write_bytes(data)


def idr(folder: Path) -> None:
    """`cameras.npz`."""
    (folder / "image").mkdir()
    picture(folder / "image" / "000.png")
    world, scale = np.eye(4), np.diag([2.0, 2, 2, 1])
    world[:3] = _K @ _POSE[:3]
    np.savez(folder / "cameras.npz", world_mat_0=world, scale_mat_0=scale)


def llff(folder: Path) -> None:
    """`poses_bounds.npy`."""
    (folder / "images").mkdir()
    picture(folder / "images" / "a.png")
    matrix = np.array([[0, 1, 0, 0, 48], [1, 0, 0, 0, 64], [0, 0, -1, -5, 80.0]])
    np.save(folder / "poses_bounds.npy", np.concatenate([matrix.reshape(-1), [1, 9]])[None])


def middlebury(folder: Path) -> None:
    """`*_par.txt`."""
    (folder / "images").mkdir()
    picture(folder / "images" / "a.png")
    numbers = np.concatenate([_K.reshape(-1), _POSE[:3, :3].reshape(-1), _POSE[:3, 3]])
    (folder / "temple_par.txt").write_text("1\nimages/a.png " + " ".join(map(str, numbers)) + "\n")


def blended_mvs(folder: Path) -> None:
    """`cams/*_cam.txt`."""
    (folder / "cams").mkdir()
    (folder / "blended_images").mkdir()
    picture(folder / "blended_images" / "00000000.png")
    rows = "\n".join(" ".join(map(str, row)) for row in _POSE)
    k = "\n".join(" ".join(map(str, row)) for row in _K)
    (folder / "cams" / "00000000_cam.txt").write_text(f"extrinsic\n{rows}\n\nintrinsic\n{k}\n\n425 2.5\n")


def scan(name: str) -> Callable[[Path], None]:
    """The cameras of a scanning program; `name` is the reader's."""
    from hir_plugins.readers import contract_inputs

    def write(folder: Path) -> None:
        def pixels() -> Pixels:
            color = np.random.default_rng(1).random((48, 64, 3)).astype(np.float32)
            return Pixels(color, None, np.zeros((48, 64), np.bool_))

        views = (View("0", Camera(_K, _POSE, 64, 48), pixels),)
        getattr(contract_inputs, name)(Capture(folder, views), folder)

    return write


def record3d_unpacked(folder: Path) -> None:
    """The files of a recording with a depth map."""
    import zipfile

    import lzfse

    scan("record3d")(folder)
    with zipfile.ZipFile(folder / "recording.r3d") as archive:
        archive.extractall(folder)
    (folder / "recording.r3d").unlink()
    depth = np.linspace(1, 2, 24 * 32, dtype=np.float32).round(2)
    (folder / "rgbd" / "0.depth").write_bytes(lzfse.compress(depth.tobytes()))


def video(folder: Path) -> None:
    """A clip of a few frames; empty where PyAV is missing."""
    try:
        import av
    except ImportError:
        (folder / "clip.mp4").write_bytes(b"")
        return
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height = 64, 48
        for i in range(6):
            pixels = np.random.default_rng(i).integers(0, 255, (48, 64, 3), np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())
    (folder / "clip.mp4").write_bytes(buffer.getvalue())


def mesh(folder: Path) -> None:
    """A square in every format that trimesh writes."""
    import trimesh

    square = asset().mesh
    shape = trimesh.Trimesh(square.positions, square.faces, process=False)
    shape.visual = trimesh.visual.TextureVisuals(uv=square.uvs)
    for kind in MESHES:
        shape.export(folder / f"mesh.{kind}")
    for name, data in trimesh.Scene(shape).export(file_type="gltf").items():
        (folder / ("mesh.gltf" if name.endswith(".gltf") else name)).write_bytes(data)


def usd(folder: Path) -> None:
    """The asset as the exporters write it."""
    from hir_exporters.formats import create_exporter

    for kind in ("usda", "usdz"):
        create_exporter(kind).write(asset(), folder / f"mesh.{kind}")


def picture(path: Path, channels: int = 3) -> None:
    """A photograph of 64×48 pixels."""
    image = np.random.default_rng(1).random((48, 64, channels)).astype(np.float32)
    path.write_bytes(encode_png(image))
