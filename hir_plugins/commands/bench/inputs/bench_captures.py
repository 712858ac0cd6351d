"""Captures for benchmarks: thinned and reduced copies, true meshes."""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import torch
from hir_exporters.conventions import linear_to_srgb, srgb_to_linear
from hir_exporters.textures.image_files import read_ldr, write_png
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.capture.pixel_cache import PixelCache
from hir_core.errors import InputError
from hir_core.evaluation import spread
from hir_core.evaluation.truth_evaluation import TRUE_MESH
from hir_core.scene import Material, Mesh, Scene, Topology

SPLITS = ("train", "test", "relight_0", "relight_1", "albedo_test")


def made_smaller(source: Path, folder: Path, views: int, side: int) -> Path:
    """A copy of a NeRF-synthetic capture with `views` train views, spread over its own, of at most `side` pixels.

    All other splits, lights and the true mesh stay whole but for their size. A folder that is there already is taken.
    """
    done = folder / "made.json"
    if done.is_file():
        return folder
    if not (source / "transforms_train.json").is_file():
        raise InputError(f"{source} has no transforms_train.json; only such captures can be thinned and reduced")
    for split in SPLITS:
        path = source / f"transforms_{split}.json"
        if not path.is_file():
            continue
        document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if split == "train":
            document["frames"] = [document["frames"][i] for i in spread(len(document["frames"]), views)]
        for frame in document["frames"]:
            _copy_picture(source, folder, frame, side)
        (folder / path.name).write_text(json.dumps(document, indent=1), encoding="utf-8")
    for other in (*source.glob("*.hdr"), *source.glob(TRUE_MESH)):
        shutil.copy(other, folder / other.name)
    done.write_text(json.dumps({"source": source.name, "views": views, "side": side}), encoding="utf-8")
    return folder


def stretched(source: Path, folder: Path, views: int, side: int) -> Path:
    """A copy with exactly `views` train views of `side` pixels, for time and memory alone.

    More views than there are come again; larger pictures are enlarged, and show nothing new. Fewer and smaller ones
    are those of `made_smaller`, and the other splits stay as it leaves them.
    """
    if (folder / "stretched.json").is_file():
        return folder
    made_smaller(source, folder, views, side)
    path = folder / "transforms_train.json"
    document: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    frames, document["frames"] = document["frames"], []
    for number in range(views):
        frame = frames[number % len(frames)]
        name = f"stretched/{number:04d}"
        (folder / "stretched").mkdir(exist_ok=True)
        _enlarge(folder / Path(frame["file_path"]).with_suffix(".png"), folder / f"{name}.png", side)
        document["frames"].append(frame | {"file_path": f"./{name}"})
    path.write_text(json.dumps(document, indent=1), encoding="utf-8")
    (folder / "stretched.json").write_text(json.dumps({"source": source.name, "views": views, "side": side}))
    return folder


def _enlarge(source: Path, target: Path, side: int) -> None:
    from PIL import Image

    with Image.open(source) as picture:
        if max(picture.size) >= side:
            shutil.copy(source, target)
            return
        shape = (side, round(side * picture.height / picture.width))
        picture.convert("RGBA").convert("RGBa").resize(shape, Image.Resampling.BICUBIC).convert("RGBA").save(target)


def extent(source: Path) -> tuple[int, int]:
    """Train views and pixels of the longer side of a NeRF-synthetic capture."""
    try:
        frames = json.loads((source / "transforms_train.json").read_text(encoding="utf-8"))["frames"]
        picture = read_ldr(source / Path(frames[0]["file_path"]).with_suffix(".png"))
    except (OSError, KeyError, IndexError, ValueError) as error:
        raise InputError(f"{source}: no train views of a transforms_train.json ({error})") from error
    return len(frames), max(picture.shape[:2])


def reduced(picture: NDArray[np.float32], factor: int) -> NDArray[np.float32]:
    """sRGB with straight alpha (H, W, 4) at 1/`factor`: colours are averaged as light, each as far as it covers."""
    height, width = picture.shape[0] // factor, picture.shape[1] // factor
    blocks = picture[: height * factor, : width * factor].reshape(height, factor, width, factor, 4)
    alpha = blocks[..., 3:]
    light = (np.asarray(srgb_to_linear(blocks[..., :3])) * alpha).sum(axis=(1, 3))
    covered = alpha.sum(axis=(1, 3))
    color = linear_to_srgb(np.where(covered > 0, light / np.maximum(covered, 1e-9), 0.0))
    return np.concatenate([color, covered / factor**2], axis=2).astype(np.float32)


def true_mesh(path: Path, capture: Capture) -> tuple[NDArray[np.float64], NDArray[np.int64]] | None:
    """`reference.obj` in the axes of `capture`, corners merged; None where there is none."""
    import trimesh

    if not (path / TRUE_MESH).is_file():
        return None
    loaded = cast(Any, trimesh.load(path / TRUE_MESH, process=False, force="mesh"))
    plain = trimesh.Trimesh(loaded.vertices, loaded.faces, process=False)
    plain.merge_vertices()
    move = capture.world_from_source
    return np.asarray(plain.vertices) @ move[:3, :3].T + move[:3, 3], np.asarray(plain.faces, dtype=np.int64)


def true_scene(path: Path, capture: Capture) -> Scene | None:
    """The true mesh with texture coordinates, mid-grey; what is left to find is material and light."""
    from hir_core.stages.atlas import texture_size, unwrap_mesh

    found = true_mesh(path, capture)
    if found is None:
        return None
    mesh = Mesh(torch.from_numpy(found[0].astype(np.float32)), Topology(torch.from_numpy(found[1])))
    size = texture_size(mesh, capture.cameras)
    mesh, _ = unwrap_mesh(mesh, size)
    grey = Material("paper", torch.full((size, size, 3), 0.5), torch.zeros(3), torch.ones(1))
    return replace(Scene(mesh), material=grey)


def _copy_picture(source: Path, folder: Path, frame: Mapping[str, Any], side: int) -> None:
    name = Path(frame["file_path"]).with_suffix(".png")
    (folder / name).parent.mkdir(parents=True, exist_ok=True)
    picture = read_ldr(source / name)
    factor = picture.shape[0] // side
    if factor <= 1:
        shutil.copy(source / name, folder / name)
    else:
        write_png(folder / name, reduced(picture, factor))


def decoded(capture: Capture) -> Capture:
    """With photographs in memory, so that decoding is not timed."""
    cached = PixelCache().wrap(capture)
    for view in cached.views:
        view.pixels()
    return cached
