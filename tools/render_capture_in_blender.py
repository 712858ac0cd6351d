"""Renders a capture in Cycles: `python render_capture_in_blender.py MODEL FOLDER [--light camera] [--relight HDR] …`.

For studies that need more views, another light or another object than the captures at hand have: photographs by a
renderer that is not ours, of a mesh whose truth is known. A glTF file has its own materials and is brought to a radius
of 1; an OBJ file, in world units with Z up, gets a dielectric of one texture. Writes `transforms_{train,test}.json` as
NeRF-synthetic has them, a split `relight_N` for each other light, PNGs with straight alpha, the lights, and
`reference.obj`. What is there already is not rendered again. Runs in an environment of its own, with bpy 5.0.1
(Python 3.11, numpy < 2): `tools/setup.sh blender` makes it.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import shutil
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

BRIGHT_SHARE, BRIGHT_LEVEL = 0.02, 0.8
"""The strength of the light lets this share of the object's pixels reach this level."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model", type=Path, help="A .gltf, .glb or .obj file.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--texture", type=Path, help="The base colour of an OBJ file, which needs one.")
    parser.add_argument("--views", type=int, default=80)
    parser.add_argument("--test-views", type=int, default=16)
    parser.add_argument("--relight-views", type=int, default=6)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=24)
    parser.add_argument("--light", default="camera", help="A lat-long .hdr, or `camera` for a lamp at the camera.")
    parser.add_argument("--relight", action="append", default=[], help="Another lat-long .hdr; repeatable.")
    parser.add_argument("--roughness", type=float, default=0.3, help="Of an OBJ file.")
    parser.add_argument("--distance", type=float, default=3.68)
    options = parser.parse_args()
    if (options.model.suffix == ".obj") != (options.texture is not None):
        parser.error("an OBJ file needs --texture, and a glTF file has its own materials")
    options.folder.mkdir(parents=True, exist_ok=True)
    scene = make_scene(options)
    spirals = {"train": spiral(options.views, 0.0), "test": spiral(options.test_views, 0.5)}
    lights = dict.fromkeys(spirals, options.light)
    for i, light in enumerate(options.relight):
        spirals[f"relight_{i}"], lights[f"relight_{i}"] = spiral(options.relight_views, 0.3), light
    for split, directions in spirals.items():
        write_split(scene, split, directions, lights[split], options)


def write_split(
    scene: bpy.types.Scene, split: str, directions: list[np.ndarray], light: str, options: argparse.Namespace
) -> None:
    """The photographs of one split, its cameras and, where the light is a panorama, the file of the light."""
    lamp = load_light(scene, light)
    strength = known_strength(scene, lamp, light, options)
    set_strength(scene, lamp, strength)
    frames = []
    for i, direction in enumerate(directions):
        pose = place_camera(scene, lamp, direction * options.distance)
        path = options.folder / split / f"{i:03d}.png"
        if not path.is_file():
            shoot(scene, path)
        frames.append({"file_path": f"./{split}/{i:03d}", "transform_matrix": pose})
    document: dict[str, Any] = {"camera_angle_x": scene.camera.data.angle_x, "frames": frames}
    if lamp is None:
        name = f"env_{split}{Path(light).suffix}"
        shutil.copy(light, options.folder / name)
        document["environment"] = {"file_path": name, "strength": strength}
    (options.folder / f"transforms_{split}.json").write_text(json.dumps(document, indent=1))


def make_scene(options: argparse.Namespace) -> bpy.types.Scene:
    """The model with its materials, a camera, Cycles on the processor; writes `reference.obj`."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    if options.model.suffix == ".obj":
        bpy.ops.wm.obj_import(filepath=str(options.model), forward_axis="Y", up_axis="Z")
        give_dielectric(options.texture, options.roughness)
        shutil.copy(options.model, options.folder / "reference.obj")
    else:
        bpy.ops.import_scene.gltf(filepath=str(options.model))
        bring_to_unit_sphere()
        reference = str(options.folder / "reference.obj")
        bpy.ops.wm.obj_export(filepath=reference, forward_axis="Y", up_axis="Z", export_materials=False)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("light")
    scene.world.use_nodes = True
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = options.samples
    scene.cycles.use_denoising = True
    scene.cycles.max_bounces = 6
    scene.render.film_transparent = True
    scene.render.use_persistent_data = True
    scene.render.resolution_x = scene.render.resolution_y = options.size
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.render.image_settings.color_mode = "RGBA"
    scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.camera.data.angle = 0.6
    scene.collection.objects.link(scene.camera)
    return scene


def give_dielectric(texture: Path, roughness: float) -> None:
    """All meshes smooth, with one material of a texture and a roughness."""
    material = bpy.data.materials.new("surface")
    material.use_nodes = True
    shader = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
    image = material.node_tree.nodes.new("ShaderNodeTexImage")
    image.image = bpy.data.images.load(str(texture))
    material.node_tree.links.new(image.outputs["Color"], shader.inputs["Base Color"])
    shader.inputs["Roughness"].default_value = roughness
    for thing in meshes():
        thing.data.materials.clear()
        thing.data.materials.append(material)
        thing.data.shade_smooth()


def bring_to_unit_sphere() -> None:
    """The middle of the meshes' bounding box at the origin, the farthest vertex at 1; nothing but meshes stays."""
    points = np.array([thing.matrix_world @ vertex.co for thing in meshes() for vertex in thing.data.vertices])
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    radius = float(np.linalg.norm(points - middle, axis=1).max())
    moved = Matrix.Scale(1 / radius, 4) @ Matrix.Translation(Vector(-middle))
    for thing in meshes():
        pose = moved @ thing.matrix_world
        thing.parent = None
        thing.matrix_world = pose
    for thing in [thing for thing in bpy.data.objects if thing.type != "MESH"]:
        bpy.data.objects.remove(thing)
    bpy.context.view_layer.update()


def meshes() -> list[bpy.types.Object]:
    return [thing for thing in bpy.data.objects if thing.type == "MESH"]


def load_light(scene: bpy.types.Scene, light: str) -> bpy.types.Object | None:
    """A lamp that goes with the camera, or None where the light is a panorama. It replaces the light before."""
    for thing in [thing for thing in bpy.data.objects if thing.type == "LIGHT"]:
        bpy.data.objects.remove(thing)
    nodes, links = scene.world.node_tree.nodes, scene.world.node_tree.links
    for node in [node for node in nodes if node.type == "TEX_ENVIRONMENT"]:
        nodes.remove(node)
    background = nodes["Background"]
    if light != "camera":
        image = nodes.new("ShaderNodeTexEnvironment")
        image.image = bpy.data.images.load(light)
        links.new(image.outputs["Color"], background.inputs["Color"])
        return None
    background.inputs["Strength"].default_value = 0.0
    lamp = bpy.data.objects.new("lamp", bpy.data.lights.new("lamp", "POINT"))
    lamp.data.shadow_soft_size = 0.15
    scene.collection.objects.link(lamp)
    return lamp


def known_strength(
    scene: bpy.types.Scene, lamp: bpy.types.Object | None, light: str, options: argparse.Namespace
) -> float:
    """The strength of a light, measured once and stored: a capture that is continued keeps its exposure."""
    path = options.folder / "strength.json"
    known: dict[str, float] = json.loads(path.read_text()) if path.is_file() else {}
    key = strength_key(light)
    if key not in known:
        known[key] = measured_strength(scene, lamp, options)
        path.write_text(json.dumps(known))
    return known[key]


def strength_key(light: str) -> str:
    """The name of a light's file and a hash of its bytes: files of one name in two folders are two lights."""
    if light == "camera":
        return light
    return f"{Path(light).name} {hashlib.sha256(Path(light).read_bytes()).hexdigest()[:16]}"


def set_strength(scene: bpy.types.Scene, lamp: bpy.types.Object | None, strength: float) -> None:
    if lamp is None:
        scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = strength
    else:
        lamp.data.energy = strength


def measured_strength(scene: bpy.types.Scene, lamp: bpy.types.Object | None, options: argparse.Namespace) -> float:
    """What brings the brightest share of the object's pixels to the level; pictures are linear in it."""
    set_strength(scene, lamp, 1.0)
    levels = []
    with tempfile.TemporaryDirectory() as folder:
        scene.render.image_settings.file_format = "OPEN_EXR"
        for i, direction in enumerate(spiral(4, 0.25)):
            place_camera(scene, lamp, direction * options.distance)
            scene.render.filepath = str(Path(folder) / f"{i}.exr")
            bpy.ops.render.render(write_still=True)
            image = bpy.data.images.load(scene.render.filepath)
            pixels = np.array(image.pixels[:], dtype=np.float32).reshape(-1, 4)
            levels.append(np.quantile(pixels[pixels[:, 3] > 0.99, :3].max(axis=1), 1 - BRIGHT_SHARE))
    return float(BRIGHT_LEVEL / np.mean(levels))


def shoot(scene: bpy.types.Scene, path: Path) -> None:
    """One PNG, complete or absent."""
    scene.render.image_settings.file_format = "PNG"
    unfinished = path.with_name(f"{path.stem}.part.png")
    scene.render.filepath = str(unfinished)
    bpy.ops.render.render(write_still=True)
    unfinished.rename(path)


def place_camera(scene: bpy.types.Scene, lamp: bpy.types.Object | None, place: np.ndarray) -> list[list[float]]:
    """Looks at the origin, Z up; returns camera_to_world 4×4, camera looking along its −Z."""
    rotation = Vector(-place).to_track_quat("-Z", "Y").to_matrix().to_4x4()
    pose = Matrix.Translation(Vector(place)) @ rotation
    scene.camera.matrix_world = pose
    if lamp is not None:
        # a hand's breadth above the lens, as on a camera: where it sits exactly in the lens nothing casts a shadow
        lamp.matrix_world = pose @ Matrix.Translation((0.0, 0.15, 0.0))
    return [list(row) for row in pose]


def spiral(count: int, phase: float) -> list[np.ndarray]:
    """Directions over the upper hemisphere, each the golden angle further round."""
    found = []
    for i in range(count):
        height = 0.05 + 0.93 * (i + 0.5) / count
        angle = (i + phase) * math.pi * (3 - math.sqrt(5))
        ring = math.sqrt(1 - height**2)
        found.append(np.array([ring * math.cos(angle), ring * math.sin(angle), height]))
    return found


if __name__ == "__main__":
    main()
