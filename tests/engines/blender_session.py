"""Runs inside of Blender: `python blender_session.py REQUEST.json`. Tests of the extension read what it answers.

REQUEST names the unpacked extension's `program` (the stand-in for hir or hir itself), `answer` (a file) and `cases`,
a list of [function, arguments]. The answer is {function: result}; an exception is {"exception": its text}.
"""

from __future__ import annotations

import json
import math
import sys
import time
import traceback
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

MODULE = "bl_ext.user_default.hir"
TURN = Matrix.Rotation(0.7, 4, "Z") @ Matrix.Rotation(0.4, 4, "X")


def addons() -> Any:
    """Blender's module for add-ons, which is found once bpy is imported."""
    return import_module("addon_utils")


def submodule(name: str) -> Any:
    return import_module(f"{MODULE}.{name}")


def report_of(operator: Any, **properties: Any) -> dict[str, Any]:
    """What an operator returns, or the message that it reports as an error."""
    try:
        return {"result": sorted(operator(**properties)), "error": ""}
    except RuntimeError as error:
        return {"result": [], "error": str(error).strip()}


def empty_scene() -> None:
    for item in list(bpy.data.objects):
        bpy.data.objects.remove(item)
    for material in list(bpy.data.materials):
        bpy.data.materials.remove(material)


def corners(item: Any) -> dict[str, Any]:
    """World positions and texture coordinates of the corners."""
    mesh = item.data
    return {
        "positions": [list(item.matrix_world @ mesh.vertices[loop.vertex_index].co) for loop in mesh.loops],
        "uv": [list(value.vector) for value in mesh.uv_layers[0].uv],
    }


def textures(material: Any) -> dict[str, list[int]]:
    """Input of the Principled node → size of the texture that reaches it."""
    found = {}
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    for socket in shader.inputs:
        waiting = [link.from_node for link in socket.links]
        while waiting:
            node = waiting.pop()
            if node.type == "TEX_IMAGE":
                found[socket.name] = list(node.image.size)
            waiting += [link.from_node for other in node.inputs for link in other.links]
    return found


def radiance(directions: list[list[float]], folder: str) -> list[list[float]]:
    """The world's radiance along directions of glTF's axes, rendered by Cycles."""
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    if scene.world is not None:
        scene.world.cycles.sampling_method = "NONE"  # a table of where the light is takes 3 s, and nothing is lit here
    scene.render.resolution_x = scene.render.resolution_y = 4
    scene.render.image_settings.file_format = "OPEN_EXR"
    hidden = [item for item in scene.objects if not item.hide_render]
    for item in hidden:
        item.hide_render = True
    camera = bpy.data.objects.new("test camera", bpy.data.cameras.new("test camera"))
    camera.data.angle = math.radians(0.5)
    scene.collection.objects.link(camera)
    scene.camera = camera
    values = []
    for index, (x, y, z) in enumerate(directions):
        camera.rotation_euler = Vector((x, -z, y)).to_track_quat("-Z", "Y").to_euler()
        scene.render.filepath = str(Path(folder) / f"{index}.exr")
        bpy.ops.render.render(write_still=True)
        picture = bpy.data.images.load(scene.render.filepath)
        values.append(np.array(picture.pixels[:]).reshape(-1, 4)[:, :3].mean(axis=0).tolist())
    bpy.data.objects.remove(camera)
    for item in hidden:
        item.hide_render = False
    return values


def registered() -> dict[str, Any]:
    """The names that the extension adds to Blender, and whether they go when it is disabled."""

    def names() -> list[bool]:
        menu = getattr(bpy.types.TOPBAR_MT_file_import.draw, "_draw_funcs", [])
        return [
            hasattr(bpy.types, "HIR_OT_import_run"),
            hasattr(bpy.types, "HIR_OT_refit_materials"),
            hasattr(bpy.types, "HIR_PT_refit"),
            any(function.__module__ == f"{MODULE}.import_run" for function in menu),
        ]

    enabled = names()
    category = bpy.types.HIR_PT_refit.bl_category
    addons().disable(MODULE)
    disabled = names()
    enable("hir")
    return {"enabled": enabled, "category": category, "disabled": disabled}


def imported(run: str) -> dict[str, Any]:
    empty_scene()
    answer = report_of(bpy.ops.hir.import_run, directory=run)
    if not answer["error"]:
        [item] = [item for item in bpy.data.objects if item.type == "MESH"]
        answer |= corners(item) | {"textures": textures(item.data.materials[0])}
        answer["world"] = bpy.context.scene.world.name
        answer["view"] = bpy.context.scene.view_settings.view_transform
    return answer


def world_radiance(run: str, directions: list[list[float]], folder: str) -> dict[str, Any]:
    empty_scene()
    return {**report_of(bpy.ops.hir.import_run, directory=run), "values": radiance(directions, folder)}


def missing_run(folder: str) -> dict[str, Any]:
    return report_of(bpy.ops.hir.import_run, directory=folder)


def old_material() -> Any:
    """A material with a picture of 8 × 4 texels as base colour."""
    picture = bpy.data.images.new("old", 8, 4)
    picture.pixels[:] = np.tile([0.2, 0.4, 0.6, 1.0], 32)
    picture.pack()
    material = bpy.data.materials.new("old")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    texture = nodes.new("ShaderNodeTexImage")
    texture.image = picture
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    material.node_tree.links.new(texture.outputs["Color"], shader.inputs["Base Color"])
    return material


def refitted(
    glb: str, photos: str, run: str, axes: str, turned: bool, settings: str, directions: list[list[float]], folder: str
) -> dict[str, Any]:
    """The mesh of `glb`, turned, with a second UV map and an old material; refitted."""
    empty_scene()
    bpy.ops.import_scene.gltf(filepath=glb)
    [item] = [item for item in bpy.data.objects if item.type == "MESH"]
    if turned:
        item.matrix_world = TURN @ item.matrix_world
    bpy.context.view_layer.update()
    item.data.materials.clear()
    item.data.materials.append(old_material())
    item.data.uv_layers[0].name = "scan's own"
    item.data.uv_layers.new(name="another")
    before = corners(item)
    item.select_set(True)
    bpy.context.view_layer.objects.active = item
    answer = report_of(bpy.ops.hir.refit_materials, directory=photos, run=run, axes=axes, settings=settings)
    answer["unchanged"] = corners(item) == before
    answer["objects"] = [other.name for other in bpy.data.objects if other.type in {"MESH", "EMPTY"}]
    answer["selected"] = [other.name for other in bpy.context.selected_objects]
    answer["item"] = item.name
    answer["materials"] = [material.name for material in item.data.materials]
    answer |= before
    if not answer["error"]:
        material = item.data.materials[0]
        answer["textures"] = textures(material)
        normal = [node.uv_map for node in material.node_tree.nodes if node.type == "NORMAL_MAP"]
        answer["normal_uv_maps"] = normal
        turn = TURN.to_3x3() if turned else Matrix.Identity(3)
        in_blender = [turn @ Vector((x, -z, y)) for x, y, z in directions]
        answer["values"] = radiance([[x, z, -y] for x, y, z in in_blender], folder)
    return answer


def refused(photos: str) -> dict[str, Any]:
    """The error of an object without a UV map."""
    empty_scene()
    bpy.ops.mesh.primitive_cube_add()
    item = bpy.context.object
    item.data.uv_layers.remove(item.data.uv_layers[0])
    no_uv = report_of(bpy.ops.hir.refit_materials, directory=photos)["error"]
    item.data.uv_layers.new()
    return {"no_uv": no_uv, "no_photos": report_of(bpy.ops.hir.refit_materials, directory=photos + "/x")["error"]}


def modal(program: str, run: str) -> dict[str, Any]:
    """The events that a window sends: timers while hir runs, Esc, timers until it has ended."""
    shared = submodule("process_operator")
    reports: list[Any] = []
    status: list[Any] = []
    removed: list[Any] = []
    finished: list[Any] = []

    class Operator(shared.HirProcessOperator):  # type: ignore[misc, name-defined]
        def report(self, kinds: set[str], text: str) -> None:
            reports.append([sorted(kinds), text])

        def finish(self, context: Any) -> None:
            finished.append(True)

    context = SimpleNamespace(
        workspace=SimpleNamespace(status_text_set=status.append),
        window_manager=SimpleNamespace(event_timer_remove=removed.append),
    )
    timer = SimpleNamespace(type="TIMER", value="NOTHING")

    def until_end(operator: Any) -> set[str]:
        deadline = time.monotonic() + 60
        while (result := operator.modal(context, timer)) == {"PASS_THROUGH"} and time.monotonic() < deadline:
            time.sleep(0.05)
        return result

    def start(word: str) -> Any:
        operator = Operator()
        operator._process = submodule("hir_process").HirProcess(program, [word, "-o", run], run)
        operator._timer = "timer"
        return operator

    operator = start("endless")
    deadline = time.monotonic() + 60
    while not (Path(run) / "progress.json").is_file() and time.monotonic() < deadline:
        time.sleep(0.05)
    answer: dict[str, Any] = {"running": sorted(operator.modal(context, timer)), "status": status[-1]}
    answer["mouse"] = sorted(operator.modal(context, SimpleNamespace(type="MOUSEMOVE", value="NOTHING")))
    answer["esc"] = sorted(operator.modal(context, SimpleNamespace(type="ESC", value="PRESS")))
    answer["stopped"] = [sorted(until_end(operator)), list(reports), status[-1], list(removed), list(finished)]
    reports.clear()
    answer["succeeded"] = [sorted(until_end(start("nothing"))), list(reports), list(finished)]
    answer["failed"] = [sorted(until_end(start("broken"))), list(reports)]
    operator = start("endless")
    process = operator._process
    operator.cancel(context)
    answer["closed"] = process.is_running
    return answer


def enable(program: str) -> None:
    addons().enable(MODULE, default_set=True)
    bpy.context.preferences.addons[MODULE].preferences.program = program


def main(request_file: str) -> None:
    request = json.loads(Path(request_file).read_text(encoding="utf-8"))
    enable("hir")
    answer: dict[str, Any] = {"default_program": submodule("preferences").hir_program(bpy.context)}
    for name, function, arguments in request["cases"]:
        bpy.context.preferences.addons[MODULE].preferences.program = request["program"]
        try:
            answer[name] = globals()[function](*arguments)
        except Exception:
            answer[name] = {"exception": traceback.format_exc()}
    Path(request["answer"]).write_text(json.dumps(answer), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1])
