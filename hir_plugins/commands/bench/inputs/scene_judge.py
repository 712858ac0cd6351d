"""Judges fitted scenes where no fit has looked: unseen views, and the same under the capture's other lights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from hir_core.capture import Capture
from hir_core.evaluation import spread
from hir_core.intake.reader_lookup import find_reader, read_capture
from hir_core.metrics import OBJECT_COVERAGE, ChannelScale, composite, mean, psnr, unassociate
from hir_core.plugins.interfaces import ReflectanceRenderer
from hir_core.plugins.manager import PluginManager
from hir_core.rendering.reference_renderer import light_of, reference_renderer, render_view
from hir_core.scene import Scene
from hir_plugins.commands.bench.inputs.bench_captures import decoded

VIEWS = 4
PATHS = 64

_Pair: TypeAlias = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
"""Linear colour and coverage of a fit, and of a photograph: (H, W, 3), (H, W) each."""


class Judge:
    """Path traces a few views of each split, all scenes alike."""

    def __init__(self, path: Path, plugins: PluginManager, downsample: int) -> None:
        _, reader = find_reader(path, plugins)
        splits = [split for split in reader.splits(path) if split == "test" or split.startswith("relight")]
        self.captures = {split: decoded(read_capture(path, split, plugins)) for split in splits}
        self._downsample = downsample
        self._plugins = plugins

    def __call__(self, scene: Scene, bounces: int) -> dict[str, float]:
        """PSNR of the object and of the frame; under other lights of the frame, one scale for each channel given."""
        _, renderer = reference_renderer(self._plugins, "", {"samples": PATHS}, bounces)
        errors: dict[str, float] = {}
        for split, capture in self.captures.items():
            shown = scene
            if split != "test":
                assert capture.environment is not None
                shown = replace(scene, environment=light_of(capture.environment, capture.world_from_source))
            pairs = [self._pair(renderer, shown, capture, i) for i in spread(len(capture.views), VIEWS)]
            if split != "test":
                errors[f"{split} scaled dB, frame"] = _scaled(pairs)
                continue
            masks = [mask > OBJECT_COVERAGE for *_, mask in pairs]
            pictures = [(composite(fit, cover), composite(true, mask)) for fit, cover, true, mask in pairs]
            inside = [psnr(a, b, where) for (a, b), where in zip(pictures, masks, strict=True)]
            errors["unseen dB"] = mean(inside) or 0.0
            errors["frame dB"] = mean([psnr(a, b) for a, b in pictures]) or 0.0
        return errors

    def _pair(self, renderer: ReflectanceRenderer, scene: Scene, capture: Capture, view: int) -> _Pair:
        camera = capture.cameras[view].downsampled(self._downsample)
        pixels = capture.views[view].pixels().downsampled(self._downsample)
        assert pixels.mask is not None
        image = render_view(renderer, scene, camera, capture.views[view].name)
        return (*unassociate(image), pixels.color_linear, pixels.mask)


def _scaled(pairs: Sequence[_Pair]) -> float:
    scale = ChannelScale()
    for fit, cover, true, mask in pairs:
        both = (cover > OBJECT_COVERAGE) & (mask > OBJECT_COVERAGE)
        scale.add(fit[both], true[both])
    value = scale.value.astype(np.float32)
    return mean([psnr(composite(fit * value, cover), composite(true, mask)) for fit, cover, true, mask in pairs]) or 0.0
