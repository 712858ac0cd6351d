"""Initializers with one fault each."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from hir_core.capture import Camera, Capture
from hir_core.errors import CaptureError
from hir_core.plugins import Component
from hir_core.plugins.interfaces import Initializer
from hir_core.scene import Mesh, Scene, Topology
from hir_core.testing.captures import TinyCapture

HERE = __name__


@dataclass(frozen=True)
class Known:
    """Where the truth lies."""

    path: str = ""
    """A .ply with the surface, or a .json with the cameras."""
    axes: str = "source"
    """Axes of the file: always those of the capture's files."""


class FromFile(Initializer):
    """The sound one for surfaces: reads the truth."""

    def __init__(self, config: Known) -> None:
        self.path = config.path

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        import trimesh

        mesh = trimesh.load(self.path, process=False, force="mesh")
        positions, faces = self.changed(np.asarray(mesh.vertices), np.asarray(mesh.faces))
        topology = Topology(torch.from_numpy(np.array(faces, dtype=np.int64)))
        return capture, Scene(Mesh(torch.from_numpy(positions.astype(np.float32)), topology))

    def changed(self, positions: Any, faces: Any) -> tuple[Any, Any]:
        return positions, faces


class Flipped(FromFile):
    def changed(self, positions: Any, faces: Any) -> tuple[Any, Any]:
        return positions * [1, -1, 1], faces[:, ::-1]


class ForgetsOne(FromFile):
    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        capture, scene = super().initialize(capture, scene, workspace)
        return replace(capture, views=capture.views[1:] + capture.views[:1]), scene


class InsideOut(FromFile):
    def changed(self, positions: Any, faces: Any) -> tuple[Any, Any]:
        import trimesh

        ball = trimesh.creation.icosphere(2)
        return np.asarray(ball.vertices), np.asarray(ball.faces)[:, ::-1]


class FromOne(FromFile):
    def changed(self, positions: Any, faces: Any) -> tuple[Any, Any]:
        return positions, faces + 1


class Empty(FromFile):
    def changed(self, positions: Any, faces: Any) -> tuple[Any, Any]:
        return positions, faces[:0]


class ReportsNothing(FromFile):
    def report(self) -> Any:
        return None


class ReportsArrays(FromFile):
    def report(self) -> Any:
        return {"size": np.arange(3)}


class ScansAName(FromFile):
    def scan(self) -> Any:
        return "scan.ply"


class SceneAlone(FromFile):
    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> Any:
        return super().initialize(capture, scene, workspace)[1]


class Inflates(FromFile):
    """Sound in the chain, wrong when it is asked again."""

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        if scene is None or scene.environment is None:
            return super().initialize(capture, scene, workspace)
        return capture, replace(scene, mesh=scene.mesh.with_positions(1.2 * scene.mesh.positions))


class NeedsAView(FromFile):
    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        capture.views[0].pixels()
        return super().initialize(capture, scene, workspace)


def true_cameras(truth: TinyCapture, given: Capture, folder: Path) -> tuple[Capture, dict[str, Any]]:
    """The cameras in another world, as a file."""
    table = {v.name: [v.camera.intrinsics.tolist(), v.camera.world_to_camera.tolist()] for v in truth.capture.views}
    (folder / "cameras.json").write_text(json.dumps(table))
    return given, {"path": str(folder / "cameras.json")}


class CamerasFromFile(Initializer):
    """The sound one for cameras."""

    def __init__(self, config: Known) -> None:
        self.path = config.path

    def initialize(self, capture: Capture, scene: Scene | None, workspace: Path) -> tuple[Capture, Scene | None]:
        table = json.loads(Path(self.path).read_text())
        views = []
        for view in capture.views:
            if view.name not in table:
                raise CaptureError(f"{view.name} is not in {self.path}; take another file")
            intrinsics, pose = (np.array(m) for m in table[view.name])
            height, width = view.pixels().color_linear.shape[:2]
            views.append(replace(view, camera=Camera(intrinsics, self.changed(pose), width, height)))
        return replace(capture, views=tuple(views)), scene

    def changed(self, pose: Any) -> Any:
        return pose


class InAMirror(CamerasFromFile):
    def changed(self, pose: Any) -> Any:
        mirror = np.diag([1.0, -1.0, 1.0, 1.0])
        return mirror @ pose @ mirror


def surface(implementation: type = FromFile) -> Component:
    return Component(
        "known",
        f"{HERE}:{implementation.__name__}",
        Known,
        "Reads the truth.",
        ("torch", "jaxtyping"),
        "reconstruct",
        frozenset({"makes_surface", "revises_mesh"} if implementation is Inflates else {"makes_surface"}),
        testing="hir_plugins.initializers.contract_inputs:object_mesh_file",
    )


def cameras(implementation: type = CamerasFromFile) -> Component:
    return Component(
        "placed",
        f"{HERE}:{implementation.__name__}",
        Known,
        "Reads the true cameras.",
        ("torch", "jaxtyping"),
        "reconstruct",
        frozenset({"finds_cameras"}),
        testing=f"{HERE}:true_cameras",
    )


BROKEN_INITIALIZERS: dict[str, Component] = {
    "returns_capture_and_scene": surface(SceneAlone),
    "surface_is_the_true_one": surface(Flipped),
    "true_surface_is_not_revised": surface(Inflates),
    "cameras_are_the_true_ones": cameras(InAMirror),
    "views_are_kept": surface(ForgetsOne),
    "unusable_captures_are_refused": surface(NeedsAView),
}
