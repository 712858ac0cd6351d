"""Features of images and their matches, in COLMAP's database (Lowe 2004; Schönberger et al. 2016 for the tree)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

import numpy as np
import pycolmap
from hir_exporters.files.atomic import atomic_path

from hir_core.errors import StageError
from hir_plugins.initializers.options import ColmapOptions
from hir_plugins.initializers.sfm.sfm_images import SfmImage, camera_groups

_MAX_EXHAUSTIVE_IMAGES = 150
"""Above this number of images, a vocabulary tree proposes the pairs."""
_MAX_EXHAUSTIVE_IMAGES_OF_TAKES = 300
"""As above for several takes: a tree proposes images of the same take first, and only pairs of two takes join them."""
_PROPOSED_IMAGES = 40
"""For each image, and each take, that a vocabulary tree proposes."""

_EMBEDDING_DIMENSIONS = 64
"""Dimensions of a descriptor in the vocabulary tree, of 128: the value of COLMAP's own vocabularies."""


Result = TypeVar("Result")


@dataclass(frozen=True)
class Attempt:
    """Parameters of one attempt."""

    features: int
    peak_threshold: float
    min_inliers: int
    masked: bool


def extract_features(
    images: Sequence[SfmImage], folder: Path, database: Path, attempt: Attempt, options: ColmapOptions
) -> None:
    """Writes each image's features to the database; images of one camera share its intrinsics."""
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.num_threads = options.threads
    extraction.sift.max_num_features = attempt.features
    extraction.sift.peak_threshold = attempt.peak_threshold
    for group in camera_groups(images, options.camera):
        reader = pycolmap.ImageReaderOptions()
        reader.camera_model = "PINHOLE" if group[0].parameters else options.camera_model
        reader.camera_params = _initial_parameters(group, options)
        if attempt.masked:
            reader.mask_path = str(folder.parent / "masks")
        known = _stored_camera(database, {image.file for image in group})
        if known is not None:
            reader.existing_camera_id = known
        run_cancellable(
            lambda token, group=group, reader=reader: pycolmap.extract_features(  # type: ignore[misc]
                str(database),
                str(folder.parent / "images"),
                image_names=[i.file for i in group],
                camera_mode=pycolmap.CameraMode.SINGLE,
                reader_options=reader,
                extraction_options=extraction,
                device=pycolmap.Device.cpu,
                cancellation_token=token,
            )
        )


def _stored_camera(database: Path, files: set[str]) -> int | None:
    """The camera identifier that an interrupted run stored for this group of images."""
    if not database.is_file():
        return None
    opened = pycolmap.Database.open(str(database))
    try:
        return next((image.camera_id for image in opened.read_all_images() if image.name in files), None)
    finally:
        opened.close()


def _initial_parameters(group: Sequence[SfmImage], options: ColmapOptions) -> str:
    image = group[0]
    if image.parameters:
        return ", ".join(map(repr, image.parameters))
    focal = options.focal_length / image.factor if options.focal_length else float(np.median([i.focal for i in group]))
    camera = pycolmap.Camera.create_from_model_name(0, options.camera_model, focal, image.width, image.height)
    return ", ".join(repr(float(p)) for p in camera.params)


def match_features(database: Path, folder: Path, count: int, options: ColmapOptions, takes: int = 1) -> None:
    """Matches features of image pairs, of `count` images in `takes`, and verifies them geometrically."""
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    matching.num_threads = options.threads
    method = options.matching
    if method == "auto":
        limit = _MAX_EXHAUSTIVE_IMAGES if takes == 1 else _MAX_EXHAUSTIVE_IMAGES_OF_TAKES
        method = "exhaustive" if count <= limit else "vocabulary"
    common: dict[str, Any] = {
        "matching_options": matching,
        "verification_options": verification_options(options),
        "device": pycolmap.Device.cpu,
    }
    if method == "exhaustive":
        run: Callable[[pycolmap.CancellationToken], object] = lambda token: pycolmap.match_exhaustive(  # noqa: E731
            str(database), cancellation_token=token, **common
        )
    elif method == "sequential":
        run = lambda token: pycolmap.match_sequential(str(database), cancellation_token=token, **common)  # noqa: E731
    else:
        pairing = pycolmap.VocabTreePairingOptions()
        pairing.num_images = min(count, _PROPOSED_IMAGES * takes)
        pairing.vocab_tree_path = str(_vocabulary(database, folder, options))
        run = lambda token: pycolmap.match_vocabtree(  # noqa: E731
            str(database), pairing_options=pairing, cancellation_token=token, **common
        )
    run_cancellable(run)


def verification_options(options: ColmapOptions) -> pycolmap.TwoViewGeometryOptions:
    """Options of the geometric verification of a pair.

    The generator is seeded for each pair: a result depends neither on earlier pairs, which a resumed run skips, nor on
    the thread.
    """
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    return verification


def _vocabulary(database: Path, folder: Path, options: ColmapOptions) -> Path:
    """A vocabulary tree, trained on the capture's own descriptors: nothing is downloaded."""
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
    index = pycolmap.VisualIndex.create(stacked.shape[1], _EMBEDDING_DIMENSIONS)
    build = pycolmap.VisualIndex.BuildOptions()
    build.num_visual_words = int(min(16384, max(256, len(stacked) // 20)))
    index.build(build, pycolmap.FeatureDescriptorsFloat(kind, stacked.astype(np.float32)))
    with atomic_path(path) as temporary:
        index.write(str(temporary))
    return path


def run_cancellable(call: Callable[[pycolmap.CancellationToken], Result]) -> Result:
    """Runs COLMAP in a thread, so that Ctrl-C cancels it and its database stays valid."""
    token = pycolmap.CancellationToken()
    outcome: list[Result] = []
    failure: list[BaseException] = []

    def work() -> None:
        try:
            outcome.append(call(token))
        except BaseException as error:  # raised again in the caller's thread below
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
