"""Writes a capture in the format of each reader, for the contract tests (`Component.testing`).

Each function takes a capture in `hir`'s world (right-handed, +Y up, OpenCV cameras), writes it below a folder, and
returns the path to read.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import write_png

from hir_core.capture import Array, Camera, Capture

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
"""Conversion between OpenCV's camera axes and OpenGL's; its own inverse."""


def transforms_json(capture: Capture, folder: Path) -> Path:
    """NeRF-synthetic: +Z up, cameras look along −z, masks as alpha channels."""
    _pictures(capture, folder / "train", alpha=True)
    z_up = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    frames = []
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        matrix = z_up @ np.linalg.inv(camera.world_to_camera) @ FLIP
        frames.append({"file_path": f"train/{view.name}", "transform_matrix": matrix.tolist(), **_lens(camera)})
    (folder / "transforms_train.json").write_text(json.dumps({"frames": frames}, indent=1), encoding="utf-8")
    return folder


def colmap_model(capture: Capture, folder: Path) -> Path:
    """COLMAP's text files, with one camera for each image."""
    from scipy.spatial.transform import Rotation

    _pictures(capture, folder / "images")
    cameras, images = [], []
    for i, (view, camera) in enumerate(zip(capture.views, capture.cameras, strict=True), 1):
        k = camera.intrinsics
        cameras.append(f"{i} PINHOLE {camera.width} {camera.height} {_row([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])}")
        x, y, z, w = Rotation.from_matrix(camera.world_to_camera[:3, :3]).as_quat()
        translation = camera.world_to_camera[:3, 3]
        images.append(f"{i} {_row([w, x, y, z, *translation])} {i} {view.name}.png\n")
    points = np.zeros((0, 3)) if capture.points is None else capture.points.positions[:50]
    model = folder / "sparse" / "0"
    model.mkdir(parents=True)
    (model / "cameras.txt").write_text("\n".join(cameras) + "\n", encoding="utf-8")
    (model / "images.txt").write_text("\n".join(images) + "\n", encoding="utf-8")
    lines = [f"{i} {_row(point)} 128 128 128 0.5 1 0 2 0" for i, point in enumerate(points, 1)]
    (model / "points3D.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def photos(capture: Capture, folder: Path) -> Path:
    """Images in a folder."""
    _pictures(capture, folder)
    return folder


def video(capture: Capture, folder: Path) -> Path:
    """Images as the frames of a lossless video."""
    import av

    path = folder / "walk.mov"
    with av.open(str(path), "w") as container:
        stream = None
        for view in capture.views:
            encoded = linear_to_srgb(view.pixels().color_linear)
            image = np.ascontiguousarray((encoded.clip(0, 1) * 255).round().astype(np.uint8))
            if stream is None:
                stream = container.add_stream("png", rate=10)
                stream.height, stream.width, stream.pix_fmt = *image.shape[:2], "rgb24"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
    return path


def idr_cameras(capture: Capture, folder: Path) -> Path:
    """Projection matrices of arbitrary scale in cameras.npz, with masks."""
    _pictures(capture, folder / "image")
    for view in capture.views:
        mask = view.pixels().mask
        if mask is not None:
            write_png(folder / "mask" / f"{view.name}.png", mask[..., None].repeat(3, axis=2))
    arrays = {}
    for i, camera in enumerate(capture.cameras):
        world = np.eye(4)
        world[:3] = -2.0 * camera.intrinsics @ camera.world_to_camera[:3]
        arrays[f"world_mat_{i}"], arrays[f"scale_mat_{i}"] = world, np.diag([2.0, 2.0, 2.0, 1.0])
    np.savez(folder / "cameras.npz", **arrays)  # type: ignore[arg-type]
    return folder


def llff(capture: Capture, folder: Path) -> Path:
    """poses_bounds.npy: columns down, right, backwards, position, (height, width, focal)."""
    _pictures(capture, folder / "images")
    rows = []
    for camera in capture.cameras:
        right, down, forward = camera.world_to_camera[:3, :3]
        size = [camera.height, camera.width, camera.intrinsics[0, 0]]
        matrix = np.stack([down, right, -forward, camera.center, np.array(size)], axis=1)
        rows.append(np.concatenate([matrix.reshape(-1), [1.0, 9.0]]))
    np.save(folder / "poses_bounds.npy", np.array(rows))
    return folder


def middlebury(capture: Capture, folder: Path) -> Path:
    """One line of name, K, R and t for each image."""
    _pictures(capture, folder)
    lines = [str(len(capture.views))]
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        pose = camera.world_to_camera
        numbers = [*camera.intrinsics.reshape(-1), *pose[:3, :3].reshape(-1), *pose[:3, 3]]
        lines.append(f"{view.name}.png {_row(numbers)}")
    (folder / "balls_par.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def blended_mvs(capture: Capture, folder: Path) -> Path:
    """A text file of extrinsic and intrinsic for each image; integer pixel centres."""
    _pictures(capture, folder / "blended_images")
    (folder / "cams").mkdir()
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        shifted = camera.intrinsics.copy()
        shifted[:2, 2] -= 0.5
        text = "\n".join(["extrinsic", *map(_row, camera.world_to_camera), "", "intrinsic", *map(_row, shifted)])
        (folder / "cams" / f"{view.name}_cam.txt").write_text(text + "\n\n1 0.1 128 9\n", encoding="utf-8")
    return folder


def _pictures(capture: Capture, folder: Path, alpha: bool = False) -> None:
    for view in capture.views:
        pixels = view.pixels()
        encoded = linear_to_srgb(pixels.color_linear)
        if alpha and pixels.mask is not None:
            encoded = np.concatenate([encoded, pixels.mask[..., None]], axis=2)
        write_png(folder / f"{view.name}.png", encoded.astype(np.float32))


def _lens(camera: Camera) -> dict[str, float]:
    k = camera.intrinsics
    return {"fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "w": camera.width, "h": camera.height}


def _row(numbers: Array | list[float]) -> str:
    return " ".join(f"{float(n):.12g}" for n in numbers)
