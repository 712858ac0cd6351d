"""Writes a capture in the format of each reader, for the contract tests (`Component.testing`).

Each function takes a capture in `hir`'s world (right-handed, +Y up, OpenCV cameras), writes it below a folder, and
returns the path to read.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import write_png

from hir_core.capture import Array, Camera, Capture
from hir_core.capture.rotations import quaternion_from_rotation
from hir_plugins.readers.parsing.lens_camera import HALF_PIXEL

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
    _pictures(capture, folder / "images")
    cameras, images = [], []
    for i, (view, camera) in enumerate(zip(capture.views, capture.cameras, strict=True), 1):
        k = camera.intrinsics
        cameras.append(f"{i} PINHOLE {camera.width} {camera.height} {_row([k[0, 0], k[1, 1], k[0, 2], k[1, 2]])}")
        pose = [*quaternion_from_rotation(camera.world_to_camera[:3, :3]), *camera.world_to_camera[:3, 3]]
        images.append(f"{i} {_row(pose)} {i} {view.name}.png\n")
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


def metashape(capture: Capture, folder: Path) -> Path:
    """Cameras as XML in a chunk of scale 2, with labels without suffix."""
    _pictures(capture, folder / "photos")
    sensors, cameras = [], []
    for i, (view, camera) in enumerate(zip(capture.views, capture.cameras, strict=True)):
        k = camera.intrinsics
        values = {"f": k[1, 1], "b1": k[0, 0] - k[1, 1]}
        values |= {"cx": k[0, 2] - camera.width / 2, "cy": k[1, 2] - camera.height / 2}
        lens = "".join(f"<{name}>{float(value)!r}</{name}>" for name, value in values.items())
        size = f'<resolution width="{camera.width}" height="{camera.height}"/>'
        sensors.append(
            f'<sensor id="{i}" type="frame">{size}<calibration type="frame" class="adjusted">{size}{lens}'
            "</calibration></sensor>"
        )
        pose = np.linalg.inv(camera.world_to_camera)
        pose[:3, 3] /= 2
        cameras.append(
            f'<camera id="{i}" sensor_id="{i}" component_id="0" label="{view.name}">'
            f"<transform>{_row(pose.reshape(-1))}</transform></camera>"
        )
    place = "<rotation>1 0 0 0 1 0 0 0 1</rotation><translation>0 0 0</translation><scale>2</scale>"
    (folder / "cameras.xml").write_text(
        f'<?xml version="1.0" encoding="UTF-8"?>\n<document version="2.0.0"><chunk label="a">'
        f'<sensors>{"".join(sensors)}</sensors><components><component id="0"><transform>{place}</transform></component>'
        f"</components><cameras>{''.join(cameras)}</cameras></chunk></document>\n",
        encoding="utf-8",
    )
    return folder


def reality_capture(capture: Capture, folder: Path) -> Path:
    """XMP sidecars: lengths as shares of the longer side, the rotation of the world in the camera, the position."""
    _pictures(capture, folder)
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        k, side = camera.intrinsics, max(camera.width, camera.height)
        attributes = {
            "Version": 3,
            "DistortionModel": "brown3",
            "DistortionCoeficients": "0 0 0 0 0 0",
            "FocalLength35mm": float(k[0, 0] / side * 36),
            "Skew": 0,
            "AspectRatio": float(k[1, 1] / k[0, 0]),
            "PrincipalPointU": float((k[0, 2] - camera.width / 2) / side),
            "PrincipalPointV": float((k[1, 2] - camera.height / 2) / side),
            "Rotation": _row(camera.world_to_camera[:3, :3].reshape(-1)),
        }
        words = " ".join(f'xcr:{name}="{value}"' for name, value in attributes.items())
        (folder / f"{view.name}.xmp").write_text(
            '<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
            f'<rdf:Description xmlns:xcr="http://www.capturingreality.com/ns/xcr/1.1#" {words}>'
            f"<xcr:Position>{_row(camera.center)}</xcr:Position></rdf:Description></rdf:RDF></x:xmpmeta>\n",
            encoding="utf-8",
        )
    return folder


def meshroom(capture: Capture, folder: Path) -> Path:
    """cameras.sfm of version 1.2.6; all numbers are text, paths are those of another computer."""
    _pictures(capture, folder / "images")
    views, intrinsics, poses = [], [], []
    for i, (view, camera) in enumerate(zip(capture.views, capture.cameras, strict=True)):
        k = camera.intrinsics
        path = f"D:/scans/images/{view.name}.png"
        views.append({"viewId": str(i), "poseId": str(i), "intrinsicId": str(i), "path": path})
        offset = [str(k[0, 2] - HALF_PIXEL - camera.width / 2), str(k[1, 2] - HALF_PIXEL - camera.height / 2)]
        lens = {"type": "pinhole", "focalLength": str(k[0, 0] * 36 / camera.width), "sensorWidth": "36"}
        size = {"width": str(camera.width), "height": str(camera.height)}
        intrinsics.append({"intrinsicId": str(i), **size, **lens, "pixelRatio": "1", "principalPoint": offset})
        rotation = [str(value) for value in camera.world_to_camera[:3, :3].T.reshape(-1)]
        transform = {"rotation": rotation, "center": [str(value) for value in camera.center]}
        poses.append({"poseId": str(i), "pose": {"transform": transform, "locked": "1"}})
    content = {"version": ["1", "2", "6"], "views": views, "intrinsics": intrinsics, "poses": poses}
    (folder / "cameras.sfm").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return folder


def open_mvg(capture: Capture, folder: Path) -> Path:
    """sfm_data.json with polymorphic intrinsics."""
    _pictures(capture, folder / "images")
    views, intrinsics, extrinsics = [], [], []
    for i, (view, camera) in enumerate(zip(capture.views, capture.cameras, strict=True)):
        k, size = camera.intrinsics, {"width": camera.width, "height": camera.height}
        data = {"local_path": "", "filename": f"{view.name}.png", **size, "id_intrinsic": i, "id_pose": i}
        views.append({"key": i, "value": {"ptr_wrapper": {"id": i, "data": data}}})
        center = [k[0, 2] - HALF_PIXEL, k[1, 2] - HALF_PIXEL]
        lens = {**size, "focal_length": k[0, 0], "principal_point": center, "disto_k3": [0.0, 0.0, 0.0]}
        intrinsics.append({"key": i, "value": {"polymorphic_id": 1, "ptr_wrapper": {"id": i, "data": lens}}})
        pose = {"rotation": camera.world_to_camera[:3, :3].tolist(), "center": camera.center.tolist()}
        extrinsics.append({"key": i, "value": pose})
    content = {"sfm_data_version": "0.3", "root_path": "/elsewhere", "views": views}
    content |= {"intrinsics": intrinsics, "extrinsics": extrinsics}
    (folder / "sfm_data.json").write_text(json.dumps(content, indent=1), encoding="utf-8")
    return folder


def bundler(capture: Capture, folder: Path) -> Path:
    """bundle.out and list.txt; the format has neither principal points nor sizes."""
    _pictures(capture, folder / "images")
    lines = ["# Bundle file v0.3", f"{len(capture.views)} 0"]
    for camera in capture.cameras:
        pose = FLIP @ camera.world_to_camera
        lines += [f"{float(camera.intrinsics[0, 0])!r} 0 0", *(_row(row[:3]) for row in pose[:3]), _row(pose[:3, 3])]
    (folder / "bundle.out").write_text("\n".join(lines) + "\n", encoding="utf-8")
    names = "".join(f"images/{view.name}.png 0 500\n" for view in capture.views)
    (folder / "list.txt").write_text(names, encoding="utf-8")
    return folder


def polycam(capture: Capture, folder: Path) -> Path:
    """One JSON file for each keyframe; +Y up, cameras look along −z."""
    _pictures(capture, folder / "keyframes" / "corrected_images")
    cameras = folder / "keyframes" / "corrected_cameras"
    cameras.mkdir(parents=True)
    for view, camera in zip(capture.views, capture.cameras, strict=True):
        pose, k = np.linalg.inv(camera.world_to_camera) @ FLIP, camera.intrinsics
        table = {f"t_{row}{column}": float(pose[row, column]) for row in range(3) for column in range(4)}
        table |= {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
        table |= {"width": camera.width, "height": camera.height}
        (cameras / f"{view.name}.json").write_text(json.dumps(table), encoding="utf-8")
    return folder


def record3d(capture: Capture, folder: Path) -> Path:
    """A .r3d without depth. Its photographs are PNG inside, because JPEG would change their colours."""
    _pictures(capture, folder / "pictures")
    poses = []
    for camera in capture.cameras:
        w, x, y, z = quaternion_from_rotation((np.linalg.inv(camera.world_to_camera) @ FLIP)[:3, :3])
        poses.append([x, y, z, w, *camera.center])
    first = capture.cameras[0]
    lenses = [[k[0, 0], k[1, 1], k[0, 2], k[1, 2]] for k in (camera.intrinsics for camera in capture.cameras)]
    document = {"w": first.width, "h": first.height, "K": first.intrinsics.T.ravel().tolist(), "poses": poses}
    path = folder / "recording.r3d"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("metadata", json.dumps(document | {"perFrameIntrinsicCoeffs": lenses}))
        for i, view in enumerate(capture.views):
            archive.write(folder / "pictures" / f"{view.name}.png", f"rgbd/{i}.jpg")
    return path


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
