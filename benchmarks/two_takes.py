"""Two takes of an object under two lights, the second one upside down, against one take of as many photographs.

    python -m benchmarks.two_takes RECIPE… --workspace DIR [--runs one two] [--side 192] [--photographs 40]
        [--texture speckled] [--store FILE]
    python -m benchmarks.two_takes --table FILE

For each object of the materials benchmark: photographs from above alone, as of an object that stands on a table; and
half of them from above and half of the object turned over, under another light. Both captures are reconstructed with
the default settings and evaluated from all sides under two other lights. Rendered by Mitsuba's path tracer with the
`principled` BSDF; the table is not there. The run `estimated` reconstructs the two takes with cameras from structure
from motion on the masked photographs; use more pixels, more photographs and `--texture speckled` then, because the
materials of the benchmark have few features, and 20 photographs of a take are 20° apart. One line is stored for each
run, with commit, date and machine.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.textures.image_files import write_hdr, write_png
from numpy.typing import NDArray
from scipy.spatial import ConvexHull

from benchmarks.hir_command import hir
from benchmarks.materials.lights import LIGHTS, light_image
from benchmarks.materials.materials import MATERIALS, Surface, waves
from benchmarks.materials.recipes import Recipe, recipes
from benchmarks.materials.render import (
    DISTANCE,
    FIELD_OF_VIEW,
    bright_value,
    encoded,
    mitsuba_mesh,
    render_view,
    write_obj,
    write_truth,
)
from benchmarks.materials.shapes import make_shape
from benchmarks.stored_rows import add_rows, run_arguments
from hir_core.evaluation.truth_evaluation import true_mesh
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.metrics.surface_metrics import sample_surface, visible
from hir_core.plugins.manager import PluginManager
from hir_core.run.finished_run import FinishedRun, open_finished_run
from hir_core.run.machine import source_commit
from hir_core.run.run_directory import RunDirectory
from hir_plugins.commands.bench.inputs.parameter_errors import parameter_errors

SIDE, SAMPLES = 192, 128
PHOTOGRAPHS = 40
TESTED, RELIT = 6, 6
TURNED_OVER = np.diag([1.0, -1.0, -1.0, 1.0])
"""Half a turn about x: from the axes of the room to those of an object that lies upside down in it."""
TAKES = "standing", "upside down"
RUNS = "one", "two", "estimated"
TEXTURES = {"coarse": (), "fine": (8.0,), "speckled": (8.0, 20.0)}
"""The material as the benchmark draws it, or with dark dots in its base colour: how many of them fit in a radius."""
RELIGHTS = "relight_0", "relight_1"
ESTIMATED = (
    "--set",
    'initializers=["colmap", "visual_hull", "hollows", "stereo"]',
    "--set",
    "initializer.colmap.known_cameras=solve",
)
"""The initializers of photographs that have masks and no cameras; the capture has cameras, which are not used."""
NEAR = 0.02
"""Distance, in radii of the truth, within which a point of the true surface counts as reconstructed."""
Image = NDArray[np.float32]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    world = [each.name for each in recipes() if LIGHTS[each.light].frame == "world"]
    parser.add_argument("recipes", nargs="*", choices=[*world, []], metavar="RECIPE")
    parser.add_argument("--side", type=int, default=SIDE, help="pixels of a photograph")
    parser.add_argument("--photographs", type=int, default=PHOTOGRAPHS, help="of a capture; a take has half of them")
    parser.add_argument("--runs", nargs="+", choices=RUNS, default=["one", "two"])
    parser.add_argument("--texture", choices=TEXTURES, default="coarse", help="detail of the base colour")
    parser.add_argument("--evaluate-only", action="store_true", help="evaluate runs of before again, fit nothing")
    given = run_arguments(parser, Path("two_takes.jsonl"), table)
    import mitsuba as mi

    mi.set_variant(given.variant)
    for recipe in (each for each in recipes() if each.name in given.recipes):
        folder = given.workspace / (recipe.name if given.texture == "coarse" else f"{recipe.name}_{given.texture}")
        if not (folder / "two" / "transforms_train.json").exists():
            make_captures(recipe, folder, given.side, given.texture, given.photographs)
        for seed in () if given.make_only else given.seeds:
            for name in given.runs:
                if not given.evaluate_only:
                    reconstructed(folder, seed, name)
                add_rows(given.store, [measured(recipe, folder, seed, name) | {"texture": given.texture}])


def make_captures(
    recipe: Recipe, folder: Path, side: int = SIDE, texture: str = "coarse", photographs: int = PHOTOGRAPHS
) -> None:
    """`one` and `two`: captures with the same object, lights of evaluation and test views."""
    import mitsuba as mi

    shape, rng = make_shape(recipe.shape), np.random.default_rng(recipe.seed)
    surface = MATERIALS[recipe.material].draw(shape.positions.astype(np.float64), shape.parts, rng)
    for scale in TEXTURES[texture]:
        surface = with_dots(surface, shape.positions.astype(np.float64), recipe.seed, scale)
    mesh = mitsuba_mesh(mi, shape, surface)
    other = str(
        rng.choice([n for n in LIGHTS if LIGHTS[n].frame == "world" and n not in (recipe.light, *recipe.relights)])
    )
    lights = {TAKES[0]: light_image(recipe.light, rng), TAKES[1]: light_image(other, rng)[::-1, ::-1].copy()}
    lights |= dict(zip(RELIGHTS, (light_image(name, rng) for name in recipe.relights), strict=True))

    def rendered(light: str, poses: Sequence[NDArray[np.float64]]) -> list[Image]:
        image = lights[light]
        return [
            render_view(mi, mesh, surface, image, False, 0.0, pose, side, SAMPLES, i) for i, pose in enumerate(poses)
        ]

    above = [from_above(i, photographs) for i in range(photographs)]
    half = [from_above(i, photographs // 2) for i in range(photographs // 2)]
    below = [TURNED_OVER @ pose for pose in half]
    tested = [from_above(i, TESTED, 0.37) for i in range(TESTED)]
    around = [from_above(i, RELIT // 2, 0.61) for i in range(RELIT // 2)]
    around += [TURNED_OVER @ pose for pose in around]
    takes_of = {"one": [(TAKES[0], above)], "two": [(TAKES[0], half), (TAKES[1], below)]}
    relit = {name: rendered(name, around) for name in RELIGHTS}
    strengths = {name: recipe.exposure / bright_value(images) for name, images in relit.items()}
    for name, takes in takes_of.items():
        capture = folder / name
        shutil.rmtree(capture, ignore_errors=True)
        capture.mkdir(parents=True)
        write_obj(capture / "reference.obj", shape)
        frames: list[dict[str, Any]] = []
        strength = 0.0
        for take, poses in takes:
            images = rendered(take, poses)
            # one exposure for each take: its brightest pixels are as bright as the recipe says
            strength = recipe.exposure / bright_value(images)
            strengths[take] = strength
            label = {"take": take} if len(takes) > 1 else {}
            frames += _written(capture, "train", images, strength, poses, len(frames), label)
        _write_transforms(capture, "train", frames)
        label = {"take": TAKES[0]} if len(takes) > 1 else {}
        frames = _written(capture, "test", rendered(TAKES[0], tested), strengths[TAKES[0]], tested, 0, label)
        _write_transforms(capture, "test", frames)
        for light in RELIGHTS:
            write_hdr(capture / f"env_{light}.hdr", lights[light])
            frames = _written(capture, light, relit[light], strengths[light], around, 0, {})
            source = {"file_path": f"env_{light}.hdr", "strength": strengths[light]}
            _write_transforms(capture, light, frames, {"environment": source})
        write_truth(mi, mesh, surface, capture / "truth", around, side)


def with_dots(surface: Surface, points: NDArray[np.float64], seed: int, scale: float) -> Surface:
    """The base colour times 0.3 in dots of about 1/`scale` of the object's radius."""
    dots = waves(points, np.random.default_rng(seed), scale)[:, None] > 0.6
    return replace(surface, base_color=np.where(dots, 0.3 * surface.base_color, surface.base_color))


def from_above(i: int, count: int, offset: float = 0.0) -> NDArray[np.float64]:
    """Camera-to-world of a spiral from 5° to 75° above the horizon."""
    z = np.sin(np.radians(5 + 70 * (i + 0.5) / count))
    azimuth = 2 * np.pi * (i * 0.618034 + offset)
    back = np.array([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(back, right), back, DISTANCE * back], axis=1)
    return pose


def _written(
    capture: Path,
    split: str,
    images: Sequence[Image],
    strength: float,
    poses: Sequence[NDArray[np.float64]],
    first: int,
    label: dict[str, str],
) -> list[dict[str, Any]]:
    """Writes photographs and returns their frames."""
    (capture / split).mkdir(exist_ok=True)
    frames = []
    for i, (image, pose) in enumerate(zip(images, poses, strict=True), first):
        write_png(capture / split / f"{i:03d}.png", encoded(image, strength))
        frames.append({"file_path": f"./{split}/{i:03d}", "transform_matrix": pose.tolist()} | label)
    return frames


def _write_transforms(
    capture: Path, split: str, frames: list[dict[str, Any]], more: dict[str, Any] | None = None
) -> None:
    document = {"camera_angle_x": FIELD_OF_VIEW} | (more or {}) | {"frames": frames}
    (capture / f"transforms_{split}.json").write_text(json.dumps(document, indent=1), encoding="utf-8")


def reconstructed(folder: Path, seed: int, name: str) -> None:
    """Makes the run; an earlier one is replaced."""
    run = _run(folder, seed, name)
    settings = ESTIMATED if name == "estimated" else ()
    shutil.rmtree(run, ignore_errors=True)
    hir("reconstruct", _capture(folder, name), "-o", run, "-q", "--seed", str(seed), "--set", "export=[]", *settings)


def measured(recipe: Recipe, folder: Path, seed: int, name: str) -> dict[str, Any]:
    """The line of one run."""
    capture, run = _capture(folder, name), _run(folder, seed, name)
    for split in ("test", *RELIGHTS):
        hir("evaluate", run, "--split", split, "-q")
    found = {s: json.loads((run / "evaluation" / s / "metrics.json").read_text()) for s in ("test", *RELIGHTS)}
    finished, plugins = open_finished_run(RunDirectory(run)), PluginManager.discover()
    # the pictures of the true material are from the cameras of the first relit split
    around = finished.read_split(capture, RELIGHTS[0], plugins)
    errors = parameter_errors(finished.scene, around, capture / "truth").errors
    timings = json.loads((run / "timings.json").read_text())
    return {
        "recipe": recipe.name,
        "half": recipe.half,
        "seed": seed,
        "run": name,
        "side": around.cameras[0].width,
        "photographs": len(json.loads((capture / "transforms_train.json").read_text())["frames"]),
        "seconds": round(sum(float(stage["seconds"]) for stage in timings["stages"].values()), 1),
        "model": finished.document["stages"]["reflectance"]["report"]["model"],
        "unseen": found["test"]["psnr"],
        "relit_scaled": {light: found[light]["psnr_scaled"] for light in RELIGHTS},
        "relit": {light: found[light]["psnr"] for light in RELIGHTS},
        "base_color_scaled": round(errors["base colour scaled dB"], 2),
        "metalness_error": round(errors["metalness error"], 4),
        **completeness(finished, folder, plugins),
        "commit": source_commit(),
        "date": datetime.now(UTC).date().isoformat(),
        "machine": timings["machine"],
    }


def _capture(folder: Path, name: str) -> Path:
    return folder / ("two" if name == "estimated" else name)


def _run(folder: Path, seed: int, name: str) -> Path:
    return folder / f"run_{name}_{seed}"


def completeness(finished: FinishedRun, folder: Path, plugins: PluginManager) -> dict[str, float]:
    """Shares of the true surface that are nearer than `NEAR` radii to the reconstructed one: `complete` of all that the
    photographs of any take see, `underside` of what only those of the object that is turned over see, and
    `underside_on_hull` of that part of the underside that lies on the convex hull: without its holes and grooves.
    """
    truth = true_mesh(folder / "two" / "reference.obj", finished)
    low, high = truth[0].min(axis=0), truth[0].max(axis=0)
    points, normals = sample_surface(*truth, 50_000, seed=1)
    mesh = finished.scene.mesh
    distance, _ = MeshQueries(mesh.positions.detach().cpu().numpy(), mesh.faces.cpu().numpy()).nearest(points)
    reach = NEAR * 0.5 * float(np.linalg.norm(high - low))
    near = distance < reach
    one, two = (finished.read_split(folder / name, "train", plugins) for name in ("one", "two"))
    seen_above = visible(points, normals, truth, one.cameras)
    anywhere = seen_above | visible(points, normals, truth, two.cameras)
    underside = anywhere & ~seen_above
    return {
        "complete": round(float(near[anywhere].mean()), 4),
        "underside": round(float(near[underside].mean()), 4),
        "underside_on_hull": round(float(near[underside & (depth_in_hull(points, truth[0]) < reach)].mean()), 4),
    }


def depth_in_hull(points: NDArray[np.float64], vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """How far each point (N, 3) lies inside of the convex hull of vertices (V, 3), in their units."""
    planes = ConvexHull(vertices).equations
    depth = np.full(len(points), np.inf)
    for plane in np.unique(planes.round(9), axis=0):
        np.minimum(depth, -(points @ plane[:3] + plane[3]), out=depth)
    return depth


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: one take → two takes, dB of the frame, and in brackets with estimated cameras; means and standard
    deviations over the objects at the end. What was not run has a dash.
    """
    lines = [
        "| object | texture | pixels | photographs | seed | unseen | relit, scaled (mean of two lights) | "
        "base colour, scaled | complete | underside | underside on the convex hull |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    forms = ".1f", ".1f", ".1f", ".3f", ".3f", ".3f"
    groups: dict[tuple[str, str, int, int, int], dict[str, dict[str, Any]]] = {}
    for row in rows:
        key = row["recipe"], row["texture"], row["side"], row["photographs"], row["seed"]
        groups.setdefault(key, {})[row["run"]] = row
    gains = []
    for (recipe, texture, side, photographs, seed), group in sorted(groups.items()):
        figures = {name: _values(row) for name, row in group.items()}
        if "one" in figures and "two" in figures:
            gains.append(figures["two"] - figures["one"])
        cells = []
        for i, form in enumerate(forms):
            found = {name: float(values[i]) for name, values in figures.items() if np.isfinite(values[i])}
            one, two, estimated = (f"{found[name]:{form}}" if name in found else "–" for name in RUNS)
            cells.append(f"{one} → {two}" + (f" ({estimated})" if "estimated" in found else ""))
        lines.append(f"| {recipe} | {texture} | {side} | {photographs} | {seed} | " + " | ".join(cells) + " |")
    if len(gains) > 1:
        mean, deviation = np.mean(gains, axis=0), np.std(gains, axis=0, ddof=1)
        cells = [f"{m:+.2f} ± {s:.2f}" if np.isfinite(m) else "–" for m, s in zip(mean, deviation, strict=True)]
        lines.append("| two − one | | | | | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _values(row: dict[str, Any]) -> NDArray[np.float64]:
    relit = np.mean([row["relit_scaled"][light]["frame"] for light in RELIGHTS])
    figures = row["unseen"]["frame"], relit, row["base_color_scaled"], row["complete"], row["underside"]
    figures += (row.get("underside_on_hull", np.nan),)  # rows of before 2026-11-29 lack it
    return np.array(figures, dtype=np.float64)


if __name__ == "__main__":
    main()
