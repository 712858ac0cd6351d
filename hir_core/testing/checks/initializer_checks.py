"""Contracts of initializers, on a capture whose cameras and surface are known."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from itertools import permutations, product
from typing import TYPE_CHECKING, Any

import numpy as np

from hir_core.errors import HirError
from hir_core.testing.captures import (
    TinyCapture,
    distance_to_surface,
    similarity_between,
    surface_mesh,
    tiny_capture,
)
from hir_core.testing.contract import BrokenContract, Subject, contract, require
from hir_core.testing.exercise import Exercise, seeded
from hir_core.testing.files_read import require_files

if TYPE_CHECKING:
    from hir_core.capture import Capture
    from hir_core.plugins.interfaces import Initializer
    from hir_core.scene import Scene


def _case(subject: Subject) -> tuple[TinyCapture, Capture, Initializer]:
    """The truth, what the initializer is given of it, and the initializer with the options of its test."""
    if "case" not in subject.memory:
        finds = subject.has("finds_cameras")
        truth = tiny_capture(subject.folder(), *((24, 256, 40.0) if finds else (16, 96, 12.0)))
        input_capture = truth.without_cameras() if finds else truth.capture
        options: dict[str, Any] = {}
        if subject.testing is not None:
            input_capture, options = subject.testing(truth, input_capture, subject.folder())
        subject.memory["case"] = truth, input_capture, options
    truth, input_capture, options = subject.memory["case"]
    return truth, input_capture, subject.create(**options)


def _given_scene(subject: Subject) -> Scene | None:
    """The true surface, for an initializer that changes one."""
    return surface_mesh() if subject.has("needs_surface") else None


def _initialized(subject: Subject) -> tuple[TinyCapture, Capture, Capture, Scene | None]:
    truth, input_capture, initializer = _case(subject)
    if "initialized" not in subject.memory:
        seeded(0)
        given = input_capture, _given_scene(subject)
        subject.memory["initialized"] = initializer.initialize(*given, subject.folder())
    capture, scene = subject.memory["initialized"]
    return truth, input_capture, capture, scene


def exercise(subject: Subject, device: str) -> Exercise:
    """Cameras and vertices."""
    del device
    _, input_capture, initializer = _case(subject)

    def run() -> dict[str, np.ndarray]:
        capture, scene = initializer.initialize(input_capture, _given_scene(subject), subject.folder())
        subject.memory.setdefault("initialized", (capture, scene))
        found = {"cameras": np.array([v.camera.world_to_camera for v in capture.views if v.camera is not None])}
        if scene is not None:
            found["vertices"] = scene.mesh.positions.cpu().numpy()
        return found

    return Exercise({"capture": input_capture}, run)


@contract("initializer", first=True, slow=True)
def returns_capture_and_scene(subject: Subject) -> None:
    """`initialize` returns a pair: the capture, and a `Scene` or None. The mesh of the scene has vertices (V, 3) as
    tensors of float32 and triangles (F, 3) of int64, which name vertices that are there; a closed mesh encloses a
    positive volume. `report` returns entries for a JSON document, `scan` a `Scan` or None, and with the trait
    `reads_files` `files` lists files that are there.
    """
    import torch

    from hir_core.capture import Capture
    from hir_core.scene import Scene

    _, input_capture, initializer = _case(subject)
    if "initialized" not in subject.memory:
        seeded(0)
        given = input_capture, _given_scene(subject)
        subject.memory["initialized"] = initializer.initialize(*given, subject.folder())
    returned = subject.memory["initialized"]
    _require_report_and_scan(initializer)
    if subject.has("reads_files"):
        require_files(initializer.files(input_capture))
    require(
        isinstance(returned, tuple) and len(returned) == 2,
        f"initialize returns {_named(returned)}; return the capture and the scene: return capture, scene",
    )
    capture, scene = returned
    require(isinstance(capture, Capture), f"the first value is {_named(capture)}, not a Capture")
    require(
        scene is None or isinstance(scene, Scene),
        f"the second value is {_named(scene)}, not a Scene or None; write Scene(Mesh(positions, Topology(faces)))",
    )
    if scene is None:
        return
    for name, tensor, wanted in (
        ("positions", scene.mesh.positions, torch.float32),
        ("faces", scene.mesh.faces, torch.int64),
    ):
        require(
            isinstance(tensor, torch.Tensor),
            f"the mesh's {name} are {_named(tensor)}, not a tensor; write torch.from_numpy(array)",
        )
        require(
            tensor.ndim == 2 and tensor.shape[1] == 3,
            f"the mesh's {name} have the shape {tuple(tensor.shape)}, not (N, 3)",
        )
        require(
            tensor.dtype == wanted,
            f"the mesh's {name} are {tensor.dtype}, not {wanted}; write {name}.to({wanted}), because all that follows "
            "computes with these types",
        )

    _require_sound_triangles(scene)


def _require_report_and_scan(initializer: Initializer) -> None:
    from hir_core.scene.scan import Scan

    report, scan = initializer.report(), initializer.scan()
    require(isinstance(report, Mapping), f"report() returns {_named(report)}; return a dict, empty without entries")
    try:
        json.dumps(dict(report), allow_nan=False)
    except (TypeError, ValueError) as error:
        raise BrokenContract(
            f"report() cannot be written as JSON: {error}; return numbers, text, lists and dicts of Python"
        ) from error
    require(scan is None or isinstance(scan, Scan), f"scan() returns {_named(scan)}; return a Scan or None")


def _require_sound_triangles(scene: Scene) -> None:
    positions, faces = scene.mesh.positions.detach().double().cpu().numpy(), scene.mesh.faces.cpu().numpy()
    require(len(faces) > 0, "the mesh has no triangles; return None where no surface is made")
    require(
        faces.min() >= 0 and faces.max() < len(positions),
        f"triangles name the vertices {faces.min()} … {faces.max()}, the mesh has {len(positions)}; the first is 0",
    )
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    keys = edges[:, 0] * len(positions) + edges[:, 1]
    reversed_keys = edges[:, 1] * len(positions) + edges[:, 0]
    if np.array_equal(np.sort(keys), np.sort(reversed_keys)):
        a, b, c = positions[faces.T]
        volume = float((a * np.cross(b, c)).sum() / 6)
        require(
            volume >= 0,
            f"the closed mesh encloses a volume of {volume:.3g}: its triangles face inwards; counter-clockwise is "
            "outside, write faces.flip(1)",
        )


def _named(value: object) -> str:
    kind = type(value)
    inside = f" of {len(value)} values" if isinstance(value, tuple | list) else ""
    return f"{kind.__module__.partition('.')[0]}.{kind.__qualname__}{inside}".removeprefix("builtins.")


@contract("initializer", traits={"makes_surface"}, slow=True)
def surface_is_the_true_one(subject: Subject) -> None:
    """The mesh lies on the true surface: half of its vertices within 3 % of the object's radius, 95 % within 12 %;
    faces index its vertices, most of them face outwards. A world that was moved is recorded in `world_from_source`.
    """
    import torch

    _, input_capture, capture, scene = _initialized(subject)
    require(scene is not None, "it declares 'makes_surface' and returns no scene")
    assert scene is not None
    mesh = scene.mesh
    require(torch.isfinite(mesh.positions).all(), "the mesh has vertices that are not finite")
    faces = mesh.faces
    require(len(faces) > 20, f"the mesh has {len(faces)} triangles")
    require(int(faces.min()) >= 0 and int(faces.max()) < len(mesh.positions), "faces name vertices that are not there")
    # the files' axes are those of the truth, so that the surface is known in any world
    truth_from_world = input_capture.world_from_source @ np.linalg.inv(capture.world_from_source)
    vertices = mesh.positions.double().cpu().numpy() @ truth_from_world[:3, :3].T + truth_from_world[:3, 3]
    away = np.abs(distance_to_surface(vertices))
    half, most = np.quantile(away, [0.5, 0.95])
    require(
        half < 0.03 and most < 0.12,
        f"half of the vertices lie within {half:.3f}, 95 % within {most:.3f} of the true surface of radius 1"
        + _frame_advice(vertices),
    )
    normal = mesh.face_areas_normals.cpu().numpy() @ truth_from_world[:3, :3].T
    centre = vertices[faces.cpu().numpy()].mean(axis=1)
    outer = distance_to_surface(
        centre + 0.05 * normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    )
    share = float((outer > distance_to_surface(centre)).mean())
    require(share > 0.9, f"{100 * share:.0f} % of the triangles face outwards; counter-clockwise is outside")


def _frame_advice(vertices: np.ndarray) -> str:
    """Whether the surface is the true one in other axes, or in another unit; "" where it is neither."""
    candidates = []
    for order in permutations(range(3)):
        for signs in product((1.0, -1.0), repeat=3):
            axes = np.eye(3)[list(order)] * np.array(signs)[:, None]
            candidates.append((axes, 1.0))
    candidates += [(np.eye(3), scale) for scale in (1e-3, 1e-2, 1e-1, 10.0, 100.0, 1000.0)]
    for axes, scale in candidates:
        half, most = np.quantile(np.abs(distance_to_surface(scale * vertices @ axes.T)), [0.5, 0.95])
        if half < 0.03 and most < 0.12:
            if scale != 1:
                return f"; times {scale:g} it is the true surface: convert its unit of length"
            named = ", ".join(f"{'-' if row.min() < 0 else ''}{'xyz'[int(np.abs(row).argmax())]}" for row in axes)
            return (
                f"; with its axes changed to ({named}) it is the true surface: it is in another frame; return it in "
                "that of "
                "the capture's cameras, by capture.world_from_source"
            )
    return ""


@contract("initializer", traits={"revises_mesh"}, slow=True)
def true_surface_is_not_revised(subject: Subject) -> None:
    """Given the true surface with a material and a light, it returns that scene, or one whose mesh is as near to the
    true surface as `surface_is_the_true_one` asks for. It is called with a fitted scene after the reflectance stage.
    """
    import torch

    from hir_core.scene import EnvironmentMap, Material

    _, input_capture, initializer = _case(subject)
    grey, rough = torch.full((3,), 0.3), torch.ones(1)
    material = Material("dielectric", grey, torch.full((3,), 0.04), rough)
    fitted = replace(surface_mesh(), material=material, environment=EnvironmentMap(torch.ones(16, 32, 3)))
    seeded(0)
    capture, scene = initializer.initialize(input_capture, fitted, subject.folder())
    require(capture is input_capture, "it changes the capture of a fitted scene; return it as it is")
    require(scene is not None, "it returns no scene for a fitted one; return that one where there is nothing to revise")
    assert scene is not None
    if scene.mesh is fitted.mesh:
        return
    vertices = scene.mesh.positions.double().cpu().numpy()
    require(np.isfinite(vertices).all(), "the revised mesh has vertices that are not finite")
    half, most = np.quantile(np.abs(distance_to_surface(vertices)), [0.5, 0.95])
    require(
        half < 0.03 and most < 0.12,
        f"it revises the true surface: half of the vertices lie within {half:.3f}, 95 % within {most:.3f} of it",
    )


@contract("initializer", traits={"finds_cameras"}, slow=True)
def cameras_are_the_true_ones(subject: Subject) -> None:
    """At least nine in ten views get a camera; after the best similarity all centres are within 5 % of the object's
    radius, and the focal length within 10 %.
    """
    truth, _, capture, _ = _initialized(subject)
    true = {view.name: view.camera for view in truth.capture.views if view.camera is not None}
    found = {view.name: view.camera for view in capture.views if view.camera is not None}
    require(len(found) >= 0.9 * len(true), f"{len(found)} of {len(true)} views got a camera")
    names = sorted(found)
    centers = np.array([found[n].center for n in names]), np.array([true[n].center for n in names])
    _, left = similarity_between(*centers)
    require(left < 0.05, f"after the best similarity a camera is {left:.3f} radii from where it was")
    focal = float(np.median([found[n].intrinsics[0, 0] / true[n].intrinsics[0, 0] for n in names]))
    require(abs(focal - 1) < 0.1, f"the focal length is {focal:.3f} times the true one")


@contract("initializer", slow=True)
def views_are_kept(subject: Subject) -> None:
    """It returns the views it was given, by name and in their order, but for those it found no camera for."""
    _, input_capture, capture, _ = _initialized(subject)
    before, after = [v.name for v in input_capture.views], [v.name for v in capture.views]
    placed = [v.name for v in capture.views if v.camera is not None]
    require(
        after == before or ([n for n in before if n in set(after)] == after and placed == after),
        f"it was given {', '.join(before)} and returns {', '.join(after)}",
    )


@contract("initializer", slow=True)
def unusable_captures_are_refused(subject: Subject) -> None:
    """Captures without views, without cameras and masks, with empty masks or with one view work, or raise a `HirError`
    (`CaptureError`, `StageError`) with a sentence: never another error, never a mesh that is not finite.
    """
    truth, input_capture, initializer = _case(subject)
    nothing = [replace(v, camera=None) for v in truth.without_masks().views]
    empty = [
        replace(v, mask=np.zeros((v.camera.height, v.camera.width), np.float32)) if v.camera else v
        for v in truth.capture.views
    ]
    cases = {
        "no views": replace(input_capture, views=(), points=None),
        "neither cameras nor masks nor points": replace(input_capture, views=tuple(nothing[:4]), points=None),
        "masks that show nothing": replace(input_capture, views=tuple(empty), points=None),
        "a single view": replace(input_capture, views=input_capture.views[:1], points=None),
    }
    for name, capture in cases.items():
        _refused(initializer, capture, name, subject)


def _refused(initializer: Initializer, capture: Capture, name: str, subject: Subject) -> None:
    import torch

    seeded(0)
    try:
        _, scene = initializer.initialize(capture, _given_scene(subject), subject.folder())
    except HirError as error:
        require(len(str(error)) > 20, f"given {name}, it raises {type(error).__name__}({str(error)!r})")
        return
    except Exception as error:
        require(False, f"given {name}, it raises {type(error).__name__}: {error}")
        return
    require(scene is None or bool(torch.isfinite(scene.mesh.positions).all()), f"given {name}, its mesh is not finite")
