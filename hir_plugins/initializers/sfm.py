"""Structure from motion with COLMAP (Schönberger & Frahm 2016): features, matches, incremental mapping."""
# ruff: noqa: TID253 - loaded when cameras are solved

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
import pycolmap
from hir_exporters.atomic import write_text_atomic

from hir_core.errors import StageError
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm_images import SfmImage, camera_groups

_MANY_IMAGES = 150
"""Above this many pictures, pairs are found by a vocabulary tree instead of trying all."""


@dataclass(frozen=True)
class Attempt:
    """How hard one attempt tries."""

    features: int
    peak_threshold: float
    min_inliers: int
    masked: bool


def attempts(options: ColmapOptions, masked: bool) -> list[Attempt]:
    """From quick to thorough; photographs with masks are first solved from the object alone."""
    first = options.max_features
    tries = [
        Attempt(first, 0.0066, 30, masked),
        Attempt(2 * first, 0.004, 20, masked),
    ]
    if masked:
        tries.append(Attempt(2 * first, 0.0066, 30, False))
    return tries if options.retry else tries[:1]


def solve(images: Sequence[SfmImage], folder: Path, attempt: Attempt, options: ColmapOptions) -> list[Any]:
    """Reconstructions of one attempt, the largest first; its database in `folder` survives a kill and is taken up."""
    folder.mkdir(parents=True, exist_ok=True)
    database = folder / "database.db"
    settings = {"attempt": vars(attempt), "camera": options.camera, "model": options.camera_model,
                "images": [(i.file, i.width, i.height) for i in images]}
    _same_settings_or_new(folder, settings)
    pycolmap.set_random_seed(options.seed)
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    _extract(images, folder, database, attempt, options)
    _match(database, folder, len(images), options)
    return _map(database, folder, attempt, options)


def _same_settings_or_new(folder: Path, settings: dict[str, Any]) -> None:
    record = folder / "settings.json"
    text = json.dumps(settings, sort_keys=True)
    if not record.is_file() or record.read_text(encoding="utf-8") != text:
        for name in ("database.db", "database.db-wal", "database.db-shm", "vocabulary.bin"):
            (folder / name).unlink(missing_ok=True)
        shutil.rmtree(folder / "models", ignore_errors=True)
        write_text_atomic(record, text)


def _extract(
    images: Sequence[SfmImage], folder: Path, database: Path, attempt: Attempt, options: ColmapOptions
) -> None:
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.num_threads = options.threads
    extraction.sift.max_num_features = attempt.features
    extraction.sift.peak_threshold = attempt.peak_threshold
    for group in camera_groups(images, options.camera):
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = options.camera_model
        reader.camera_params = _start_parameters(group, options)
        if attempt.masked:
            reader.mask_path = str(folder.parent / "masks")
        known = _known_camera(database, {image.file for image in group})
        if known is not None:
            reader.existing_camera_id = known
        _cancellable(lambda token, group=group, reader=reader: pycolmap.extract_features(  # type: ignore[misc]
            str(database), str(folder.parent / "images"), image_names=[i.file for i in group],
            camera_mode=pycolmap.CameraMode.SINGLE, reader_options=reader, extraction_options=extraction,
            device=pycolmap.Device.cpu, cancellation_token=token,
        ))  # fmt: skip


def _known_camera(database: Path, files: set[str]) -> int | None:
    """The camera that an interrupted run gave to this group."""
    if not database.is_file():
        return None
    opened = pycolmap.Database.open(str(database))
    try:
        return next((image.camera_id for image in opened.read_all_images() if image.name in files), None)
    finally:
        opened.close()


def _start_parameters(group: Sequence[SfmImage], options: ColmapOptions) -> str:
    image = group[0]
    focal = options.focal_length / image.factor if options.focal_length else float(np.median([i.focal for i in group]))
    camera = pycolmap.Camera.create_from_model_name(0, options.camera_model, focal, image.width, image.height)
    return ", ".join(repr(float(p)) for p in camera.params)


def _match(database: Path, folder: Path, count: int, options: ColmapOptions) -> None:
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    matching.num_threads = options.threads
    chosen = options.matching
    if chosen == "auto":
        chosen = "exhaustive" if count <= _MANY_IMAGES else "vocabulary"
    common: dict[str, Any] = {"matching_options": matching, "device": pycolmap.Device.cpu}
    if chosen == "exhaustive":
        run: Callable[[Any], Any] = lambda token: pycolmap.match_exhaustive(  # noqa: E731
            str(database), cancellation_token=token, **common)
    elif chosen == "sequential":
        run = lambda token: pycolmap.match_sequential(str(database), cancellation_token=token, **common)  # noqa: E731
    else:
        pairing = pycolmap.VocabTreePairingOptions()
        pairing.num_images = min(count, 40)
        pairing.vocab_tree_path = str(_vocabulary(database, folder, options))
        run = lambda token: pycolmap.match_vocabtree(  # noqa: E731
            str(database), pairing_options=pairing, cancellation_token=token, **common)
    _cancellable(run)


def _vocabulary(database: Path, folder: Path, options: ColmapOptions) -> Path:
    """A vocabulary tree trained on the capture's own descriptors: nothing is downloaded."""
    path = folder / "vocabulary.bin"
    if path.is_file():
        return path
    opened = pycolmap.Database.open(str(database))
    try:
        rng = np.random.default_rng(options.seed)
        parts = []
        for image in opened.read_all_images():
            descriptors = opened.read_descriptors(image.image_id)
            data = np.asarray(descriptors.data)
            parts.append(data[rng.permutation(len(data))[:400]])
        kind = descriptors.type
    finally:
        opened.close()
    stacked = np.concatenate(parts)
    index = pycolmap.VisualIndex.create(kind, stacked.shape[1])
    build = pycolmap.VisualIndex.BuildOptions()
    build.num_visual_words = int(min(16384, max(256, len(stacked) // 20)))
    index.build(build, pycolmap.FeatureDescriptorsFloat(kind, stacked.astype(np.float32)))
    index.write(str(path))
    return path


def _map(database: Path, folder: Path, attempt: Attempt, options: ColmapOptions) -> list[Any]:
    models = folder / "models"
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir()
    images = str(folder.parent / "images")
    if options.mapper == "global":
        found = _cancellable(lambda token: pycolmap.global_mapping(str(database), images, str(models)))
    else:
        pipeline = pycolmap.IncrementalPipelineOptions()
        pipeline.num_threads = options.threads
        pipeline.random_seed = options.seed
        pipeline.ba_refine_focal_length = options.refine_intrinsics
        pipeline.ba_refine_extra_params = options.refine_intrinsics
        pipeline.mapper.abs_pose_min_num_inliers = attempt.min_inliers
        pipeline.mapper.abs_pose_refine_focal_length = options.refine_intrinsics
        pipeline.mapper.abs_pose_refine_extra_params = options.refine_intrinsics
        found = _cancellable(lambda token: pycolmap.incremental_mapping(
            str(database), images, str(models), options=pipeline, cancellation_token=token))
    return sorted(found.values(), key=lambda model: -model.num_reg_images())


def _cancellable(call: Callable[[Any], Any]) -> Any:
    """Runs COLMAP in a thread, so that Ctrl-C reaches it and its database stays whole."""
    token = pycolmap.CancellationToken()
    outcome: list[Any] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            outcome.append(call(token))
        except BaseException as error:  # handed to the caller's thread below
            failure.append(error)

    thread = Thread(target=work, daemon=True)
    thread.start()
    try:
        while thread.is_alive():
            thread.join(0.2)
    except KeyboardInterrupt:
        token.cancel()
        thread.join(30)
        raise
    if failure:
        raise StageError(f"COLMAP failed: {' '.join(str(failure[0]).split())}") from failure[0]
    return outcome[0]


def best_model(images: Sequence[SfmImage], masked: bool, workspace: Path, options: ColmapOptions) -> Any:
    """The largest reconstruction of all attempts; they stop once nearly all pictures are in one."""
    best: Any = None
    for number, attempt in enumerate(attempts(options, masked)):
        if number and masked and not attempt.masked:
            warnings.warn("few photographs could be placed by what lies inside of the masks; the background is used "
                          "too, which misleads where the object stands on a turntable", stacklevel=3)
        models = solve(images, workspace / f"attempt-{number + 1}", attempt, options)
        if models and (best is None or models[0].num_reg_images() > best.num_reg_images()):
            best = models[0]
        fragments = [m.num_reg_images() for m in models]
        if best is not None and best.num_reg_images() >= options.enough * len(images):
            break
        if number + 1 < len(attempts(options, masked)):
            warnings.warn(f"{attempt.features} features a photograph join only {fragments[:5] or 'none'} of "
                          f"{len(images)}; trying more", stacklevel=3)
    return best
