"""Evaluates fitted scenes on views that no fit uses: the test split, and the splits under other lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.intake.reader_lookup import find_reader, read_capture
from hir_core.metrics import OBJECT_COVERAGE, ChannelScale, composite, mean, psnr, unassociate
from hir_core.plugins.interfaces import ReflectanceRenderer
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.light_files import load_light
from hir_core.rendering.reference_renderer import reference_renderer, render_view
from hir_core.rendering.view_selection import evenly_spaced_indices
from hir_core.scene import Scene
from hir_plugins.commands.bench.inputs.bench_captures import decode_images

EVALUATED_VIEWS: Final = 4
"""Of each split."""

PATHS_PER_PIXEL: Final = 64


@dataclass(frozen=True)
class _ImagePair:
    """A rendered view and its photograph, linear: colours (H, W, 3), coverages (H, W)."""

    rendered: NDArray[np.float32]
    coverage: NDArray[np.float32]
    photograph: NDArray[np.float32]
    mask: NDArray[np.float32]

    @property
    def object_pixels(self) -> NDArray[np.bool_]:
        """The pixels that the photograph's mask covers (H, W)."""
        return self.mask > OBJECT_COVERAGE

    def psnr(self, where: NDArray[np.bool_] | None = None, scale: NDArray[np.float32] | None = None) -> float | None:
        """8-bit sRGB PSNR over black; `scale` (3,) multiplies the rendered colours."""
        rendered = self.rendered if scale is None else self.rendered * scale
        return psnr(composite(rendered, self.coverage), composite(self.photograph, self.mask), where)


class SceneEvaluator:
    """Path traces a few views of each split and compares them with the photographs."""

    def __init__(self, path: Path, plugins: PluginManager, downsample: int) -> None:
        _, reader = find_reader(path, plugins)
        splits = [split for split in reader.splits(path) if split == "test" or split.startswith("relight")]
        self.captures = {split: decode_images(read_capture(path, split, plugins)) for split in splits}
        self._downsample = downsample
        self._plugins = plugins

    def __call__(self, scene: Scene, bounces: int) -> dict[str, float]:
        """PSNR over the object's pixels and over the frame; under other lights over the frame, after a least-squares
        scale for each channel.
        """
        _, renderer = reference_renderer(self._plugins, "", {"samples": PATHS_PER_PIXEL}, bounces)
        errors: dict[str, float] = {}
        for split, capture in self.captures.items():
            lit = scene
            if split != "test":
                assert capture.environment is not None
                lit = replace(scene, environment=load_light(capture.environment, capture.world_from_source))
            views = evenly_spaced_indices(len(capture.views), EVALUATED_VIEWS)
            pairs = [self._image_pair(renderer, lit, capture, view) for view in views]
            if split == "test":
                errors["unseen dB"] = mean([pair.psnr(pair.object_pixels) for pair in pairs]) or 0.0
                errors["frame dB"] = mean([pair.psnr() for pair in pairs]) or 0.0
            else:
                errors[f"{split} scaled dB, frame"] = _scaled_psnr(pairs)
        return errors

    def _image_pair(self, renderer: ReflectanceRenderer, scene: Scene, capture: Capture, view: int) -> _ImagePair:
        camera = capture.cameras[view].downsampled(self._downsample)
        pixels = capture.views[view].pixels().downsampled(self._downsample)
        assert pixels.mask is not None
        rendered, coverage = unassociate(render_view(renderer, scene, camera, capture.views[view].name))
        return _ImagePair(rendered, coverage, pixels.color_linear, pixels.mask)


def _scaled_psnr(pairs: Sequence[_ImagePair]) -> float:
    """Mean PSNR over the frame, with one scale per channel for all views."""
    scale = ChannelScale()
    for pair in pairs:
        both = (pair.coverage > OBJECT_COVERAGE) & pair.object_pixels
        scale.add(pair.rendered[both], pair.photograph[both])
    value = scale.value.astype(np.float32)
    return mean([pair.psnr(scale=value) for pair in pairs]) or 0.0
