"""Renders the captures of the materials benchmark with Mitsuba's path tracer and its `principled` BSDF."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from hir_exporters.textures.image_files import read_hdr, write_hdr, write_png
from numpy.typing import NDArray

from benchmarks.materials.lights import LIGHTS, light_image
from benchmarks.materials.materials import MATERIALS, Surface
from benchmarks.materials.recipes import Recipe
from benchmarks.materials.shapes import Shape

SIDE = 144
SAMPLES = 192
DEPTH = 6
FIELD_OF_VIEW = 0.62
"""Radians, both ways."""
DISTANCE = 3.4
SPLITS = {"train": 32, "test": 8, "relight_0": 6, "relight_1": 6}
LATLONG_TO_WORLD = [[0, 0, 1, 0], [1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]]
"""Mitsuba's environment axes (pole +Y) to the captures' (pole +Z, image centre +X)."""


@dataclass(frozen=True)
class RenderSettings:
    """Size and number of the photographs of one capture."""

    side: int = SIDE
    samples: int = SAMPLES
    """Paths for each pixel."""
    views: Mapping[str, int] = field(default_factory=lambda: SPLITS)
    """Photographs of each split."""


def write_capture(recipe: Recipe, shape: Shape, folder: Path, settings: RenderSettings | None = None) -> None:
    """Writes photographs, cameras, lights, the true mesh and the true material of one capture."""
    import mitsuba as mi

    settings = settings or RenderSettings()
    side, samples = settings.side, settings.samples
    material = MATERIALS[recipe.material]
    mesh, surface, images = scene_parts(mi, recipe, shape)
    folder.mkdir(parents=True, exist_ok=True)
    write_obj(folder / "reference.obj", shape)
    lights = lights_of(recipe)
    for split, light_map in images.items():
        write_hdr(folder / f"env_{split}.hdr", light_map)
        images[split] = read_hdr(folder / f"env_{split}.hdr")
    strengths: dict[str, float] = {}
    for split, count in settings.views.items():
        lit_by = "train" if split == "test" else split
        cameras = [spiral_camera(i, count, split) for i in range(count)]
        light = LIGHTS[lights[lit_by]]
        renders = [
            render_view(mi, mesh, surface, images[lit_by], light.frame == "camera", light.lamp, pose, side, samples, i)
            for i, pose in enumerate(cameras)
        ]
        if lit_by not in strengths:
            strengths[lit_by] = recipe.exposure / bright_value(renders)
        (folder / split).mkdir(exist_ok=True)
        for i, image in enumerate(renders):
            write_png(folder / split / f"{i:03d}.png", encoded(image, strengths[lit_by]))
        if split == "test":
            write_truth(mi, mesh, surface, folder / "truth_test", cameras, side)
        document: dict[str, Any] = {"camera_angle_x": FIELD_OF_VIEW}
        if light.frame == "world":
            document["environment"] = {"file_path": f"env_{lit_by}.hdr", "strength": strengths[lit_by]}
        document["frames"] = [
            {"file_path": f"./{split}/{i:03d}", "transform_matrix": pose.tolist()} for i, pose in enumerate(cameras)
        ]
        (folder / f"transforms_{split}.json").write_text(json.dumps(document, indent=1))
    truth = asdict(recipe) | {
        "kind": material.kind,
        "within_model": material.within_model,
        "light_frame": LIGHTS[recipe.light].frame,
        "constants": surface.constants,
    }
    (folder / "truth.json").write_text(json.dumps(truth, indent=1))


def spiral_camera(i: int, count: int, split: str) -> NDArray[np.float64]:
    """Camera-to-world (4×4, looking along -Z) on a spiral over the sphere, from 30° below to 75° above the horizon."""
    offset = {"train": 0.0, "test": 0.37, "relight_0": 0.61, "relight_1": 0.83}[split]
    share = (i + 0.5) / count
    z = np.sin(np.radians(-30 + 105 * share))
    azimuth = 2 * np.pi * (i * 0.618034 + offset)
    eye = DISTANCE * np.array([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z])
    back = eye / np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, eye], axis=1)
    return pose


def mitsuba_mesh(mi: Any, shape: Shape, surface: Surface) -> Any:
    """A Mitsuba mesh whose vertex attributes are the material."""
    attributes = {name: {"type": "mesh_attribute", "name": f"vertex_{name}"} for name in ("base", "metal", "rough")}
    bsdf = {
        "type": "principled",
        "base_color": attributes["base"],
        "metallic": attributes["metal"],
        "roughness": attributes["rough"],
        **surface.constants,
    }
    props = mi.Properties()
    props["bsdf"] = mi.load_dict({"type": "twosided", "nested": bsdf})
    mesh = mi.Mesh("object", len(shape.positions), len(shape.faces), has_vertex_normals=True, props=props)
    params = mi.traverse(mesh)
    params["vertex_positions"] = shape.positions.ravel()
    params["vertex_normals"] = shape.normals.ravel()
    params["faces"] = shape.faces.ravel()
    params.update()
    mesh.add_attribute("vertex_base", 3, surface.base_color.astype(np.float32).ravel())
    mesh.add_attribute("vertex_metal", 1, surface.metallic.astype(np.float32).ravel())
    mesh.add_attribute("vertex_rough", 1, surface.roughness.astype(np.float32).ravel())
    return mesh


def lights_of(recipe: Recipe) -> dict[str, str]:
    """The name of the light of each split; the test split has the train split's."""
    return dict(zip(("train", "relight_0", "relight_1"), (recipe.light, *recipe.relights), strict=True))


def scene_parts(mi: Any, recipe: Recipe, shape: Shape) -> tuple[Any, Surface, dict[str, NDArray[np.float32]]]:
    """Mitsuba's mesh, the material at its vertices, and the light of each split; random, from the recipe's seed."""
    rng = np.random.default_rng(recipe.seed)
    surface = MATERIALS[recipe.material].draw(shape.positions.astype(np.float64), shape.parts, rng)
    images = {split: light_image(name, rng) for split, name in lights_of(recipe).items()}
    return mitsuba_mesh(mi, shape, surface), surface, images


def render_view(
    mi: Any,
    mesh: Any,
    surface: Surface,
    image: NDArray[np.float32],
    carried: bool,
    lamp: float,
    pose: NDArray[np.float64],
    side: int,
    samples: int,
    seed: int,
) -> NDArray[np.float32]:
    """Premultiplied linear RGBA (H, W, 4)."""
    to_world = np.array(LATLONG_TO_WORLD, dtype=np.float64)
    if carried:
        # the light's own axes (pole +Z, centre +X) turn with the camera: +Z up in the picture, +X towards the eye
        turn = np.eye(4)
        turn[:3, :3] = np.stack([pose[:3, 2], pose[:3, 0], pose[:3, 1]], axis=1)
        to_world = turn @ to_world
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": DEPTH, "hide_emitters": True},
        "object": mesh,
        "light": {
            "type": "envmap",
            "bitmap": mi.Bitmap(image),
            "to_world": mi.ScalarTransform4f(to_world),
        },
        "sensor": sensor(mi, pose, side, samples),
    }
    if lamp:
        place = pose[:3, 3] + 0.12 * pose[:3, 1] + 0.05 * pose[:3, 0]
        scene["lamp"] = {
            "type": "point",
            "position": [float(v) for v in place],
            "intensity": {"type": "rgb", "value": [lamp * DISTANCE**2 / 4] * 3},
        }
    rendered = np.array(mi.render(mi.load_dict(scene), spp=samples, seed=seed))
    return np.nan_to_num(rendered.astype(np.float32))


def sensor(
    mi: Any, pose: NDArray[np.float64], side: int, samples: int, field_of_view: float = FIELD_OF_VIEW
) -> dict[str, Any]:
    """A camera with square photographs of `side` pixels; `field_of_view` in radians, both ways."""
    eye, back, up = pose[:3, 3], pose[:3, 2], pose[:3, 1]
    camera_to_world = mi.ScalarTransform4f().look_at(origin=eye.tolist(), target=(eye - back).tolist(), up=up.tolist())
    film = {
        "type": "hdrfilm",
        "width": side,
        "height": side,
        "pixel_format": "rgba",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    return {
        "type": "perspective",
        "fov": float(np.degrees(field_of_view)),
        "to_world": camera_to_world,
        "film": film,
        "sampler": {"type": "independent", "sample_count": samples},
    }


def bright_value(renders: list[NDArray[np.float32]]) -> float:
    """The linear value that 2 % of all object pixels exceed in some channel."""
    pixels = [image[..., :3][image[..., 3] > 0.99] for image in renders]
    return float(np.quantile(np.concatenate(pixels).max(axis=-1), 0.98))


def encoded(image: NDArray[np.float32], strength: float) -> NDArray[np.float32]:
    """sRGB with straight alpha, 0…1."""
    alpha = image[..., 3:].clip(0, 1)
    color = np.where(alpha > 1e-3, image[..., :3] / np.maximum(alpha, 1e-3), 0.0) * strength
    return np.concatenate([linear_to_srgb(color.clip(0, 1)), alpha], axis=-1).astype(np.float32)


def write_truth(
    mi: Any, mesh: Any, surface: Surface, folder: Path, cameras: list[NDArray[np.float64]], side: int
) -> None:
    """Base colour (sRGB), metalness and roughness (linear) at the pixel centres of each test view, with coverage."""
    folder.mkdir(exist_ok=True)
    for i, pose in enumerate(cameras):
        scene = mi.load_dict({"type": "scene", "object": mesh, "sensor": sensor(mi, pose, side, 1)})
        grid = (np.arange(side) + 0.5) / side
        y, x = np.meshgrid(grid, grid, indexing="ij")
        ray, _ = scene.sensors()[0].sample_ray(0.0, 0.5, mi.Point2f(x.ravel(), y.ravel()), mi.Point2f(0.5))
        hit = scene.ray_intersect(ray)
        covered = np.array(hit.is_valid()).astype(np.float32).reshape(side, side, 1)
        read: dict[str, Callable[[], Any]] = {
            "base_color": lambda hit=hit: mesh.eval_attribute_3("vertex_base", hit, hit.is_valid()),
            "metallic": lambda hit=hit: mesh.eval_attribute_1("vertex_metal", hit, hit.is_valid()),
            "roughness": lambda hit=hit: mesh.eval_attribute_1("vertex_rough", hit, hit.is_valid()),
        }
        for name, values in read.items():
            picture = np.array(values()).reshape(-1, side * side).T.reshape(side, side, -1).astype(np.float32)
            picture = np.where(covered > 0, picture, 0)  # attributes are undefined where the ray misses
            if name == "base_color":
                picture = linear_to_srgb(picture.clip(0, 1)).astype(np.float32)
            picture = np.broadcast_to(picture, (side, side, 3))
            write_png(folder / f"{i:03d}_{name}.png", np.concatenate([picture, covered], axis=-1))


def write_obj(path: Path, shape: Shape) -> None:
    lines = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in shape.positions]
    lines += [f"f {a} {b} {c}" for a, b, c in shape.faces + 1]
    path.write_text("\n".join(lines) + "\n")
