"""Captures for benchmarks: copies with fewer, smaller or larger photographs; true meshes."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from hir_exporters.reading.mesh_references import load_mesh_scene
from hir_exporters.textures.image_files import read_ldr
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.capture.pixel_cache import PixelCache
from hir_core.errors import InputError
from hir_core.evaluation.truth_evaluation import TRUE_MESH
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.scene import Material, Mesh, Scene, Topology
from hir_plugins.commands.bench.inputs.image_resampling import copy_downsampled, copy_enlarged

SPLITS: Final = ("train", "test", "relight_0", "relight_1", "albedo_test")


def make_reduced_capture(source: Path, folder: Path, views: int, side: int) -> Path:
    """Copies a NeRF-synthetic capture with `views` evenly spaced train views of at most `side` pixels.

    The other splits keep all views, at the same size; lights and the true mesh are copied. An existing copy is kept.
    """
    marker = folder / "made.json"
    if marker.is_file():
        return folder
    if not (source / "transforms_train.json").is_file():
        raise InputError(f"{source} has no transforms_train.json; only NeRF-synthetic captures can be reduced")
    for split in SPLITS:
        path = source / f"transforms_{split}.json"
        if not path.is_file():
            continue
        document = _read_transforms(path)
        if split == "train":
            document["frames"] = [document["frames"][i] for i in evenly_spaced_indices(len(document["frames"]), views)]
        for frame in document["frames"]:
            name = _image_name(frame)
            copy_downsampled(source / name, folder / name, side)
        (folder / path.name).write_text(json.dumps(document, indent=1), encoding="utf-8")
    for file in (*source.glob("*.hdr"), *source.glob(TRUE_MESH)):
        shutil.copy(file, folder / file.name)
    marker.write_text(json.dumps({"source": source.name, "views": views, "side": side}), encoding="utf-8")
    return folder


def make_resized_capture(source: Path, folder: Path, views: int, side: int) -> Path:
    """Copies a capture with exactly `views` train views of `side` pixels, for measurements of time and memory only.

    Missing views are repeated and small photographs are enlarged. Otherwise the copy is that of
    `make_reduced_capture`.
    """
    marker = folder / "stretched.json"
    if marker.is_file():
        return folder
    make_reduced_capture(source, folder, views, side)
    path = folder / "transforms_train.json"
    document = _read_transforms(path)
    frames, document["frames"] = document["frames"], []
    (folder / "stretched").mkdir(exist_ok=True)
    for number in range(views):
        frame = frames[number % len(frames)]
        name = f"stretched/{number:04d}"
        copy_enlarged(folder / _image_name(frame), folder / f"{name}.png", side)
        document["frames"].append(frame | {"file_path": f"./{name}"})
    path.write_text(json.dumps(document, indent=1), encoding="utf-8")
    marker.write_text(json.dumps({"source": source.name, "views": views, "side": side}))
    return folder


def capture_size(source: Path) -> tuple[int, int]:
    """The number of train views of a NeRF-synthetic capture, and the longer side of their images in pixels."""
    try:
        frames = _read_transforms(source / "transforms_train.json")["frames"]
        image = read_ldr(source / _image_name(frames[0]))
    except (OSError, KeyError, IndexError, ValueError) as error:
        raise InputError(f"{source}: transforms_train.json has no readable train views ({error})") from error
    return len(frames), max(image.shape[:2])


def true_mesh(path: Path, capture: Capture) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """Positions (V, 3) and faces (F, 3) of `reference.obj` in the axes of `capture`, equal positions merged.

    None if the capture has no such file.
    """
    import trimesh

    if not (path / TRUE_MESH).is_file():
        return None
    loaded = load_mesh_scene(path / TRUE_MESH, process=False).to_mesh()
    mesh = trimesh.Trimesh(loaded.vertices, loaded.faces, process=False)
    mesh.merge_vertices()
    transform = capture.world_from_source
    positions = np.asarray(mesh.vertices) @ transform[:3, :3].T + transform[:3, 3]
    return positions, np.asarray(mesh.faces, dtype=np.int64)


def true_scene(path: Path, capture: Capture) -> Scene | None:
    """The true mesh with texture coordinates and a grey material; None if the capture has no true mesh."""
    from hir_core.stages.atlas import texture_size, unwrap_mesh

    truth = true_mesh(path, capture)
    if truth is None:
        return None
    mesh = Mesh(torch.from_numpy(truth[0].astype(np.float32)), Topology(torch.from_numpy(truth[1])))
    size = texture_size(mesh, capture.cameras)
    mesh, _ = unwrap_mesh(mesh, size)
    grey = Material("paper", torch.full((size, size, 3), 0.5), torch.zeros(3), torch.ones(1))
    return replace(Scene(mesh), material=grey)


def decode_images(capture: Capture) -> Capture:
    """The capture with all photographs decoded in memory, so that decoding is not measured."""
    cached = PixelCache().wrap(capture)
    for view in cached.views:
        view.pixels()
    return cached


def _read_transforms(path: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return document


def _image_name(frame: dict[str, Any]) -> Path:
    return Path(frame["file_path"]).with_suffix(".png")
