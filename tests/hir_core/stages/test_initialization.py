"""The chain that starts a run: which masks win, which photographs are left out, what a chain must end in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture, Pixels, View
from hir_core.config import RunConfig
from hir_core.errors import CaptureError, StageError
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import Initializer, MaskSource
from hir_core.plugins.manager import PluginManager
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.stages.initialization import _apply_masks, initialize

CAMERA = Camera(np.array([[50.0, 0, 4], [0, 50, 4], [0, 0, 1]]), np.eye(4), 8, 8)
BLACK = Pixels(np.zeros((8, 8, 3), np.float32), None, np.zeros((8, 8), bool))


class EveryOther(MaskSource):
    """Full masks for the first, third, … view."""

    def __init__(self, _: object) -> None:
        pass

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        return [np.ones((8, 8), np.float32) if i % 2 == 0 else None for i in range(len(capture.views))]


class Half(MaskSource):
    """One half everywhere; its trait says that it looks at cameras."""

    def __init__(self, _: object) -> None:
        pass

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        return [np.full((8, 8), 0.5, np.float32) for _ in capture.views]


class LosesOne(Initializer):
    """Places all photographs but the last, and makes no surface."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        views = tuple(replace(view, camera=CAMERA) for view in capture.views[:-1])
        return replace(capture, views=(*views, *capture.views[-1:])), scene


class Plugin:
    """What this file offers."""

    @hookimpl
    def hir_register_mask_sources(self) -> list[Component]:
        return [
            Component("every_other", f"{__name__}:EveryOther", summary="Masks of every other view."),
            Component("half", f"{__name__}:Half", summary="Half.", traits=frozenset({"needs_cameras"})),
        ]

    @hookimpl
    def hir_register_initializers(self) -> list[Component]:
        return [Component("loses_one", f"{__name__}:LosesOne", summary="Loses one.")]


@pytest.fixture
def told(tmp_path: Path) -> tuple[StageContext, list[str]]:
    """A stage's context, and what it warns of."""
    plugins, said = PluginManager(), []
    plugins.register(Plugin(), "test", "1")
    assert plugins.problems == []
    return StageContext(plugins, tmp_path, warn=said.append), said


def capture_of(count: int, camera: Camera | None = None) -> Capture:
    return Capture(Path("made"), tuple(View(str(i), camera, lambda: BLACK) for i in range(count)))


def means(capture: Capture) -> list[float | None]:
    masks: Sequence[NDArray[np.floating] | None] = [view.pixels().mask for view in capture.views]
    return [None if mask is None else float(mask.mean()) for mask in masks]


def test_a_later_source_fills_what_an_earlier_one_left(told: tuple[StageContext, list[str]]) -> None:
    context, _ = told
    config = replace(RunConfig(), masks=("every_other", "half"))
    first = _apply_masks(capture_of(4), None, config, context, with_cameras=False)
    assert means(first) == [1.0, None, 1.0, None], "half looks at cameras, which there are none of yet"
    both = _apply_masks(capture_of(4, CAMERA), None, replace(config, masks=("half",)), context, with_cameras=True)
    assert means(both) == [0.5] * 4


def test_masks_of_the_files_stay_unless_sources_are_named(told: tuple[StageContext, list[str]]) -> None:
    context, _ = told
    given = capture_of(2)
    given = replace(given, views=tuple(replace(v, mask=np.full((8, 8), 0.25, np.float32)) for v in given.views))
    assert means(_apply_masks(given, None, RunConfig(), context, with_cameras=False)) == [0.25, 0.25]
    named = replace(RunConfig(), masks=("every_other",))
    assert means(_apply_masks(given, None, named, context, with_cameras=False)) == [1.0, 0.25]


def test_photographs_without_a_camera_are_left_out_and_told(told: tuple[StageContext, list[str]]) -> None:
    context, said = told
    config = replace(RunConfig(), initializers=("loses_one",), masks=())
    with pytest.raises(StageError, match="the initializers loses_one made no surface"):
        initialize(capture_of(3), config, context)
    assert said == ["1 of 3 photographs have no camera and are left out: 2, …"]


def test_a_chain_that_nobody_suggests_is_an_error_that_names_what_there_is(
    told: tuple[StageContext, list[str]],
) -> None:
    context, _ = told
    with pytest.raises(CaptureError, match=r"no plugin suggests how to start .*there are: loses_one"):
        initialize(capture_of(3), replace(RunConfig(), masks=()), context)
