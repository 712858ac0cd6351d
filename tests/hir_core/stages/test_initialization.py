"""The chain of initializers: order of mask sources, unregistered photographs, and a chain without a surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from hir_core.capture import Camera, Capture, OrientedPoints, Pixels, View
from hir_core.capture.pixel_cache import PixelCache
from hir_core.config import RunConfig
from hir_core.errors import CaptureError, StageError
from hir_core.plugins import Component, hookimpl
from hir_core.plugins.interfaces import Initializer, MaskSource
from hir_core.plugins.manager import PluginManager
from hir_core.run.run_directory import RunDirectory
from hir_core.run.stage_context import StageContext
from hir_core.scene import Scene
from hir_core.scene.frames import move_scene
from hir_core.scene.scan import Scan
from hir_core.stages.initialization import apply_masks, initialize, resolve_initializers, scale_source
from hir_core.stages.run_state import CaptureSource, RunState
from hir_core.stages.stage_list import INITIALIZER
from tests.fixtures.scenes import square

CAMERA = Camera(np.array([[50.0, 0, 4], [0, 50, 4], [0, 0, 1]]), np.eye(4), 8, 8)
BLACK = Pixels(np.zeros((8, 8, 3), np.float32), None, np.zeros((8, 8), bool))


class EveryOther(MaskSource):
    """Full masks for the first, third, … view."""

    def __init__(self, _: object) -> None:
        pass

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        return [np.ones((8, 8), np.float32) if i % 2 == 0 else None for i in range(len(capture.views))]


class Half(MaskSource):
    """One half everywhere; its trait says that it needs cameras."""

    def __init__(self, _: object) -> None:
        pass

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        return [np.full((8, 8), 0.5, np.float32) for _ in capture.views]


class LosesOne(Initializer):
    """Gives all photographs but the last a camera, and makes no surface."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        views = tuple(replace(view, camera=CAMERA) for view in capture.views[:-1])
        return replace(capture, views=(*views, *capture.views[-1:])), scene


class AddsPoints(Initializer):
    """Keeps cameras and finds points, as structure from motion with known cameras does; it sees no mask."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        assert means(capture) == [None] * len(capture.views)
        return replace(capture, points=OrientedPoints(np.zeros((50, 3)))), scene


class NeedsPoints(MaskSource):
    """As grabcut: cameras are not enough."""

    def __init__(self, _: object) -> None:
        pass

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        assert capture.points is not None
        return [np.ones((8, 8), np.float32) for _ in capture.views]


class NeedsManyPoints(MaskSource):
    """As grabcut without points."""

    def __init__(self, _: object) -> None:
        pass

    def masks(self, capture: Capture, scene: Scene | None) -> list[NDArray[np.float32] | None]:
        raise CaptureError("points are missing; add masks")


class NeedsMasks(Initializer):
    """Fails without a mask."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        assert means(capture) == [1.0] * len(capture.views)
        return capture, scene


class ReadsScan(Initializer):
    """Its surface is the one of a file with a texture."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        return capture, Scene(square())

    def scan(self) -> Scan | None:
        return Scan("scan.obj", np.full((2, 2, 3), 9, np.uint8))


class Doubles(Initializer):
    """Makes the surface twice as large."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        assert scene is not None
        return capture, move_scene(scene, np.diag([2.0, 2.0, 2.0, 1.0]))


class Replaces(Initializer):
    """Makes another surface."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        return capture, Scene(square())


class Raises(Initializer):
    """Moves the surface up."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        assert scene is not None
        return capture, Scene(scene.mesh.with_positions(scene.mesh.positions + 0.5))


class Stays(Initializer):
    """Could change the surface."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        return capture, scene


class MovesCameras(Initializer):
    """Moves the cameras without the surface."""

    def __init__(self, _: object) -> None:
        pass

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        return capture.transformed(np.diag([2.0, 2.0, 2.0, 1.0])), scene


class Plugin:
    """The components of this file."""

    @hookimpl
    def hir_register_mask_sources(self) -> list[Component]:
        return [
            Component("every_other", f"{__name__}:EveryOther", summary="Masks of every other view."),
            Component("half", f"{__name__}:Half", summary="Half.", traits=frozenset({"needs_cameras"})),
            Component(
                "points",
                f"{__name__}:NeedsManyPoints",
                summary="None.",
                traits=frozenset({"automatic", "needs_cameras"}),
            ),
            Component("cut", f"{__name__}:NeedsPoints", summary="All.", traits=frozenset({"needs_cameras"})),
        ]

    @hookimpl
    def hir_register_initializers(self) -> list[Component]:
        return [
            Component("reads_scan", f"{__name__}:ReadsScan", summary="Reads a scan."),
            Component("raises", f"{__name__}:Raises", summary="Raises.", traits=frozenset({"revises_mesh"})),
            Component("stays", f"{__name__}:Stays", summary="Stays.", traits=frozenset({"revises_mesh"})),
            Component("moves_cameras", f"{__name__}:MovesCameras", summary="Moves cameras."),
            Component("doubles", f"{__name__}:Doubles", summary="Doubles the surface."),
            Component("replaces", f"{__name__}:Replaces", summary="Makes another surface."),
            Component("loses_one", f"{__name__}:LosesOne", summary="Loses one."),
            Component("motion", f"{__name__}:AddsPoints", summary="Points.", traits=frozenset({"finds_cameras"})),
            Component("hull", f"{__name__}:NeedsMasks", summary="Nothing.", traits=frozenset({"needs_masks"})),
        ]


@pytest.fixture
def stage(tmp_path: Path) -> tuple[StageContext, list[str]]:
    """A stage's context, and its warnings."""
    plugins, warned = PluginManager(), []
    plugins.register(Plugin(), "test", "1")
    assert plugins.problems == []
    return StageContext(plugins, tmp_path, warn=warned.append), warned


def capture_of(count: int, camera: Camera | None = None) -> Capture:
    return Capture(Path("made"), tuple(View(str(i), camera, lambda: BLACK) for i in range(count)))


def means(capture: Capture) -> list[float | None]:
    masks: Sequence[NDArray[np.floating] | None] = [view.pixels().mask for view in capture.views]
    return [None if mask is None else float(mask.mean()) for mask in masks]


def test_a_later_source_fills_what_an_earlier_one_left(stage: tuple[StageContext, list[str]]) -> None:
    context, _ = stage
    config = replace(RunConfig(), masks=("every_other", "half"))
    first = apply_masks(capture_of(4), None, config, context, known="photographs")
    assert means(first) == [1.0, None, 1.0, None], "half needs cameras, and there are none yet"
    both = apply_masks(capture_of(4, CAMERA), None, replace(config, masks=("half",)), context, known="cameras")
    assert means(both) == [0.5] * 4


def test_masks_of_the_files_stay_unless_sources_are_named(stage: tuple[StageContext, list[str]]) -> None:
    context, _ = stage
    masked = capture_of(2)
    masked = replace(masked, views=tuple(replace(v, mask=np.full((8, 8), 0.25, np.float32)) for v in masked.views))
    assert means(apply_masks(masked, None, RunConfig(), context, known="photographs")) == [0.25, 0.25]
    named = replace(RunConfig(), masks=("every_other",))
    assert means(apply_masks(masked, None, named, context, known="photographs")) == [1.0, 0.25]


def test_what_gave_the_metres_is_the_last_that_says_so() -> None:
    """An initializer that scales the world comes after the files of the cameras."""
    arkit = replace(capture_of(1), metres_from="ARKit")
    assert scale_source(capture_of(1), {}) == "" and scale_source(arkit, {"hull": {"voxels": 3}}) == "ARKit"
    reports = {"solved": {"scale_from": "GPS"}, "marked": {"scale_from": "8 markers"}, "hull": {}}
    assert scale_source(arkit, reports) == "8 markers"


def test_photographs_without_a_camera_are_left_out_with_a_warning(stage: tuple[StageContext, list[str]]) -> None:
    context, warned = stage
    config = replace(RunConfig(), initializers=("loses_one",), masks=())
    with pytest.raises(StageError, match="the initializers loses_one made no surface"):
        initialize(capture_of(3), config, context)
    assert warned == ["1 of 3 photographs have no camera and are left out: 2"]


@pytest.mark.parametrize("bare", [0, 2])
def test_photographs_without_a_mask_are_left_out_with_a_warning(
    stage: tuple[StageContext, list[str]], bare: int
) -> None:
    """Where the automatic sources cannot make a mask; it had ended the run."""
    context, warned = stage
    views = capture_of(8, CAMERA).views
    masked = replace(BLACK, mask=np.ones((8, 8), np.float32))
    capture = replace(
        capture_of(0), views=tuple(v if i == bare else replace(v, read=lambda: masked) for i, v in enumerate(views))
    )
    found, _ = initialize(capture, replace(RunConfig(), initializers=("hull", "replaces")), context)
    assert [view.name for view in found.capture.views] == [str(i) for i in range(8) if i != bare]
    left_out = f"1 of 8 photographs have no mask and are left out: {bare}; add their masks to use them"
    assert warned[:2] == ["points are missing; add masks", left_out]


def test_a_capture_with_few_masks_is_not_reduced_to_them(stage: tuple[StageContext, list[str]]) -> None:
    masked = replace(BLACK, mask=np.ones((8, 8), np.float32))
    first, *others = capture_of(8, CAMERA).views
    capture = replace(capture_of(0), views=(replace(first, read=lambda: masked), *others))
    with pytest.raises(CaptureError, match="points are missing"):
        initialize(capture, replace(RunConfig(), initializers=("replaces",)), stage[0])


def test_masks_that_need_points_wait_for_them_where_cameras_are_given(stage: tuple[StageContext, list[str]]) -> None:
    """The cameras of another program without masks: structure from motion gives points, then grabcut cuts."""
    context, _ = stage
    config = replace(RunConfig(), initializers=("motion", "hull"), masks=("cut",))
    with pytest.raises(StageError, match="the initializers motion, hull made no surface"):
        initialize(capture_of(3, CAMERA), config, context)


@pytest.mark.parametrize(
    ("chain", "kept"),
    [
        (("reads_scan",), True),
        (("reads_scan", "doubles"), True),
        (("reads_scan", "replaces"), False),
        (("replaces",), False),
    ],
)
def test_a_scan_is_kept_while_the_surface_is_its_own(
    stage: tuple[StageContext, list[str]], chain: tuple[str, ...], kept: bool
) -> None:
    """The texture belongs to the triangles and coordinates of its file, wherever its vertices are moved."""
    config = replace(RunConfig(), initializers=chain, masks=())
    found, _ = initialize(capture_of(3, CAMERA), config, stage[0])
    assert (found.scan is not None) == kept


@pytest.mark.parametrize(
    ("chain", "known"),
    [
        (("reads_scan", "raises", "doubles"), True),
        (("reads_scan", "raises", "moves_cameras"), False),
        (("reads_scan", "stays", "doubles"), False),
        (("reads_scan", "stays", "raises"), True),
        (("reads_scan", "doubles"), False),
    ],
    ids=["changed", "later the cameras move", "not changed", "by the second one", "no trait"],
)
def test_the_mesh_before_a_change_that_held_out_views_judge_is_kept(
    stage: tuple[StageContext, list[str]], chain: tuple[str, ...], known: bool
) -> None:
    """In the frame of the changed one, whose vertices are higher here."""
    found, _ = initialize(capture_of(3, CAMERA), replace(RunConfig(), initializers=chain, masks=()), stage[0])
    assert (found.unchanged_scene is not None) == known
    if found.unchanged_scene is not None:
        original = move_scene(found.unchanged_scene, found.frames.asset_from_working).mesh.positions
        assert torch.allclose(original, square().positions, atol=1e-6)


@pytest.mark.parametrize("changed", [True, False])
def test_the_mesh_before_a_change_survives_a_resume(
    stage: tuple[StageContext, list[str]], changed: bool, tmp_path: Path
) -> None:
    context, _ = stage
    config = replace(RunConfig(), initializers=("reads_scan", "raises" if changed else "stays"), masks=())
    capture = capture_of(3, CAMERA)
    found, _ = initialize(capture, config, context)
    source = CaptureSource(tmp_path, "made", "", tuple(view.name for view in capture.views))
    run = RunDirectory(tmp_path / "run")
    run.path.mkdir()
    state = RunState(config, context.plugins, run, "cpu", source, PixelCache(0), capture)
    INITIALIZER.save(state, found, tmp_path)
    loaded = INITIALIZER.load(state, tmp_path)
    extended = INITIALIZER.extend(state, loaded).unchanged_scene
    if not changed:
        assert found.unchanged_scene is None and extended is None
        return
    assert found.unchanged_scene is not None and extended is not None
    assert torch.equal(extended.mesh.positions, found.unchanged_scene.mesh.positions)


def test_takes_that_are_too_small_to_hold_views_out_are_said(stage: tuple[StageContext, list[str]]) -> None:
    context, warned = stage
    config = replace(RunConfig(), initializers=("replaces",), masks=())
    capture = capture_of(8, CAMERA)
    initialize(capture, config, context)
    assert warned == []
    initialize(replace(capture, views=tuple(replace(view, take=view.name) for view in capture.views)), config, context)
    assert warned == [
        "the 8 takes have too few photographs each to hold some out, so no models are compared; "
        "take 20 or more of one take around the object"
    ]


def test_the_chain_is_computed_once_and_with_the_masks_of_the_run(stage: tuple[StageContext, list[str]]) -> None:
    """A suggestion sees the masks that the stage will give, and the stage runs the chain that it is given."""
    context, _ = stage
    asked: list[float | None] = []

    class Suggests:
        @hookimpl
        def hir_suggest_initializers(self, capture: Capture) -> list[str]:
            asked.extend(means(capture)[:1])
            return ["loses_one"]

    context.plugins.register(Suggests(), "suggests", "1")
    config = replace(RunConfig(), masks=("every_other",))
    chain = resolve_initializers(capture_of(3), config, context.plugins)
    assert chain == ("loses_one",) and asked == [1.0]
    with pytest.raises(StageError, match="made no surface"):
        initialize(capture_of(3), replace(config, initializers=chain), context)
    assert asked == [1.0], "the stage does not ask again"


def test_a_capture_without_a_suggested_chain_is_an_error_that_names_the_installed_initializers(
    stage: tuple[StageContext, list[str]],
) -> None:
    context, _ = stage
    with pytest.raises(CaptureError, match=r"no plugin suggests initializers .*installed: .*hull, loses_one, motion"):
        resolve_initializers(capture_of(3), replace(RunConfig(), masks=()), context.plugins)
