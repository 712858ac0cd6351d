"""Structure from motion with COLMAP (Schönberger & Frahm 2016): features, matches, incremental mapping."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import pycolmap
from hir_exporters.files.atomic import write_text_atomic

from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.feature_matching import Attempt, extract_features, match_features, run_cancellable
from hir_plugins.initializers.sfm.sfm_images import SfmImage


def attempts(options: ColmapOptions, masked: bool, takes: int = 1) -> list[Attempt]:
    """Attempts from fast to thorough. Photographs with masks are first solved from features on the object.

    The background is never used for several takes: the object moved before it.
    """
    first = options.max_features
    planned = [
        Attempt(first, 0.0066, 30, masked),
        Attempt(2 * first, 0.004, 20, masked),
    ]
    if masked and takes == 1:
        planned.append(Attempt(2 * first, 0.0066, 30, False))
    return planned if options.retry else planned[:1]


def solve_attempt(
    images: Sequence[SfmImage], folder: Path, attempt: Attempt, options: ColmapOptions, takes: int = 1
) -> list[pycolmap.Reconstruction]:
    """Reconstructions of one attempt, the largest first."""
    return _map(build_database(images, folder, attempt, options, takes), folder, attempt, options)


def build_database(
    images: Sequence[SfmImage], folder: Path, attempt: Attempt, options: ColmapOptions, takes: int = 1
) -> Path:
    """The database in `folder` with features and matches; the database of an interrupted run is continued."""
    folder.mkdir(parents=True, exist_ok=True)
    database = folder / "database.db"
    settings = {
        "attempt": vars(attempt),
        "camera": options.camera,
        "model": options.camera_model,
        "images": [(i.file, i.width, i.height, i.parameters) for i in images],
    }
    _discard_other_settings(folder, settings)
    pycolmap.set_random_seed(options.seed)
    pycolmap.logging.minloglevel = int(pycolmap.logging.ERROR)
    extract_features(images, folder, database, attempt, options)
    match_features(database, folder, len(images), options, takes)
    return database


def _discard_other_settings(folder: Path, settings: Mapping[str, object]) -> None:
    record = folder / "settings.json"
    text = json.dumps(settings, sort_keys=True)
    if not record.is_file() or record.read_text(encoding="utf-8") != text:
        for name in ("database.db", "database.db-wal", "database.db-shm", "vocabulary.bin"):
            (folder / name).unlink(missing_ok=True)
        shutil.rmtree(folder / "models", ignore_errors=True)
        write_text_atomic(record, text)


def _map(database: Path, folder: Path, attempt: Attempt, options: ColmapOptions) -> list[pycolmap.Reconstruction]:
    models = folder / "models"
    shutil.rmtree(models, ignore_errors=True)
    models.mkdir()
    images = str(folder.parent / "images")
    if options.mapper == "global":
        reconstructions = run_cancellable(lambda token: pycolmap.global_mapping(str(database), images, str(models)))
    else:
        pipeline = pycolmap.IncrementalPipelineOptions()
        pipeline.num_threads = options.threads
        pipeline.random_seed = options.seed
        pipeline.ba_refine_focal_length = options.refine_intrinsics
        pipeline.ba_refine_extra_params = options.refine_intrinsics
        pipeline.mapper.abs_pose_min_num_inliers = attempt.min_inliers
        pipeline.mapper.abs_pose_refine_focal_length = options.refine_intrinsics
        pipeline.mapper.abs_pose_refine_extra_params = options.refine_intrinsics
        reconstructions = run_cancellable(
            lambda token: pycolmap.incremental_mapping(
                str(database), images, str(models), options=pipeline, cancellation_token=token
            )
        )
    return sorted(reconstructions.values(), key=lambda model: -model.num_reg_images())


def largest_reconstruction(
    images: Sequence[SfmImage], masked: bool, workspace: Path, options: ColmapOptions, takes: int = 1
) -> pycolmap.Reconstruction | None:
    """The largest reconstruction of all attempts; None if there is none. `takes` is the number of the capture's takes.

    No further attempt is made once `options.min_registered_share` of the images are registered.
    """
    best: pycolmap.Reconstruction | None = None
    planned = attempts(options, masked, takes)
    for number, attempt in enumerate(planned):
        if number and masked and not attempt.masked:
            warnings.warn(
                "features inside the masks register few photographs; the background is used too, which gives wrong "
                "cameras if the object stands on a turntable",
                stacklevel=3,
            )
        models = solve_attempt(images, workspace / f"attempt-{number + 1}", attempt, options, takes)
        if models and (best is None or models[0].num_reg_images() > best.num_reg_images()):
            best = models[0]
        fragments = [m.num_reg_images() for m in models]
        if best is not None and best.num_reg_images() >= options.min_registered_share * len(images):
            break
        if number + 1 < len(planned):
            warnings.warn(
                f"{attempt.features} features per photograph register only {fragments[:5] or 'none'} of "
                f"{len(images)} photographs in one model; trying more",
                stacklevel=3,
            )
    return best
