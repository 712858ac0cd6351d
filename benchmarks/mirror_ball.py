"""`hir light-probe` on photographs of a mirror ball and a grey one that Mitsuba renders in the place of an object.

    python -m benchmarks.mirror_ball CAPTURE… --workspace DIR [--light-only] [--store FILE]
    python -m benchmarks.mirror_ball --table FILE
    python -m benchmarks.mirror_ball CAPTURE --workspace DIR --picture FILE

For each capture with a true mesh and a true light: photographs of a mirror ball from three of its cameras at three
exposures and of a grey ball at one, 8 bits, with EXIF data; the light that the command measures with the mirror ball
alone and with both; and fits on the true mesh (`hir delight`) with the light of both, with the true one and with a
fitted one, evaluated under other lights without a scale. One line is stored for each capture, with commit, date and
machine.
"""

from __future__ import annotations

import argparse
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from hir_exporters.conventions import latlong_directions, latlong_solid_angles, linear_to_srgb
from hir_exporters.light.environment_map import resample_latlong
from hir_exporters.textures.image_files import read_hdr, read_ldr
from numpy.typing import NDArray
from PIL import Image

from benchmarks.hir_command import hir
from benchmarks.materials.render import LATLONG_TO_WORLD, sensor
from benchmarks.stored_rows import add_rows, provenance, stored_rows
from hir_core.capture import Capture
from hir_core.intake.reader_lookup import read_capture
from hir_core.plugins.manager import PluginManager
from hir_plugins.initializers.existing_mesh.mesh_loading import load_mesh

VIEWS, SAMPLES = 3, 64
REFLECTANCE, GREY_REFLECTANCE = 0.6, 0.18
EXPOSURES = (1.0, 1 / 16, 1 / 256)
"""Of the mirror ball, beside those of the object's photographs."""
MIRROR: dict[str, Any] = {"type": "conductor", "material": "none", "specular_reflectance": REFLECTANCE}
GREY: dict[str, Any] = {"type": "diffuse", "reflectance": {"type": "rgb", "value": GREY_REFLECTANCE}}
ROWS = 128
EVALUATED_VIEWS = 6
EXIF, EXPOSURE_TIME, F_NUMBER, ISO = 0x8769, 0x829A, 0x829D, 0x8827


def save(path: Path, linear: NDArray[np.floating], coverage: NDArray[np.floating], exposure: float) -> None:
    """An 8-bit sRGB picture with alpha and EXIF data."""
    picture = np.dstack([linear_to_srgb(np.clip(linear * exposure, 0, 1)), coverage])
    exif = Image.Exif()
    exif[EXIF] = {EXPOSURE_TIME: exposure / 100, F_NUMBER: 8.0, ISO: 100}
    Image.fromarray(np.round(picture * 255).astype(np.uint8)).save(path, exif=exif)


def copy_with_exposures(source: Path, folder: Path) -> None:
    """The capture, whose photographs record that all were exposed equally."""
    shutil.copytree(source, folder)
    for file in (folder / "train").glob("*.png"):
        exif = Image.Exif()
        exif[EXIF] = {EXPOSURE_TIME: 0.01, F_NUMBER: 8.0, ISO: 100}
        with Image.open(file) as image:
            image.load()
        image.save(file, exif=exif)


def photograph_ball(
    source: Path, capture: Capture, folder: Path, material: dict[str, Any], exposures: Sequence[float]
) -> None:
    """A transforms file and photographs of a ball in the place of the object, half as large."""
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    assert capture.environment is not None
    positions = load_mesh(source / "reference.obj").positions
    center = (positions.max(axis=0) + positions.min(axis=0)) / 2
    radius = float(np.ptp(positions, axis=0).max()) / 4
    light = read_hdr(capture.environment.path) * np.float32(capture.environment.strength)
    folder.mkdir(parents=True)
    frames, source_from_world = [], np.linalg.inv(capture.world_from_source)
    chosen = np.linspace(0, len(capture.views), VIEWS, endpoint=False).astype(int)
    for number in chosen.tolist():
        camera = capture.cameras[number].transformed(source_from_world)
        pose = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
        view = 2 * np.arctan(camera.width / 2 / camera.intrinsics[0, 0])
        scene = {
            "type": "scene",
            "integrator": {"type": "path", "max_depth": 3, "hide_emitters": True},
            "ball": {"type": "sphere", "center": center.tolist(), "radius": radius, "bsdf": material},
            "light": {
                "type": "envmap",
                "bitmap": mi.Bitmap(light),
                "to_world": mi.ScalarTransform4f(np.array(LATLONG_TO_WORLD, dtype=np.float64)),
            },
            "sensor": sensor(mi, pose, camera.width, SAMPLES, float(view)),
        }
        image = np.array(mi.render(mi.load_dict(scene), seed=number))
        coverage = image[..., 3].clip(0, 1)
        linear = image[..., :3] / np.maximum(coverage, 1e-3)[..., None]
        for exposure in exposures:
            name = f"{number:03d}_{round(1 / exposure)}.png"
            save(folder / name, linear, coverage, exposure)
            frames.append({"file_path": name, "transform_matrix": pose.tolist()})
    document = {"camera_angle_x": float(view), "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(document), encoding="utf-8")


def irradiance(radiance: NDArray[np.floating]) -> NDArray[np.float64]:
    """Irradiance (N, 3) of normals that are spread over the sphere."""
    small = resample_latlong(radiance, 32, 64)
    directions = latlong_directions(32, 64).reshape(-1, 3)
    normals = latlong_directions(12, 24).reshape(-1, 3)
    solid = np.broadcast_to(latlong_solid_angles(32, 64), (32, 64)).reshape(-1)
    found: NDArray[np.float64] = (np.maximum(normals @ directions.T, 0) * solid) @ small.reshape(-1, 3)
    return found


def relit(run: Path, source: Path) -> dict[str, Any]:
    """PSNR under the other lights, unscaled and scaled."""
    found: dict[str, Any] = {}
    for light in ("relight_0", "relight_1"):
        hir("evaluate", run, source, "--split", light, "--views", str(EVALUATED_VIEWS), "-q")
        metrics = json.loads((run / "evaluation" / light / "metrics.json").read_text(encoding="utf-8"))
        found[light] = {"psnr": metrics["psnr"], "psnr_scaled": metrics["psnr_scaled"]}
    return found


def measured_light(source: Path, capture: Capture, folder: Path) -> dict[str, Any]:
    """Relative errors of the irradiance by the mirror ball alone and by both balls; light.exr is that of both."""
    assert capture.environment is not None, "the capture states no true light"
    mirror, grey, thing = folder / "mirror", folder / "grey", folder / "object"
    if not thing.exists():
        copy_with_exposures(source, thing)
        photograph_ball(source, capture, mirror, MIRROR, EXPOSURES)
        photograph_ball(source, capture, grey, GREY, (1.0,))
    truth = irradiance(read_hdr(capture.environment.path) * np.float32(capture.environment.strength))
    errors = {}
    both = ("--grey-ball", grey, "--grey-reflectance", str(GREY_REFLECTANCE))
    for name, more, file in (("mirror", (), "mirror_alone.exr"), ("both", both, "light.exr")):
        words = ("--object", thing, "--reflectance", str(REFLECTANCE), "--rows", str(ROWS), *more)
        hir("light-probe", mirror, "-o", folder / file, *words)
        error = np.abs(irradiance(read_hdr(folder / file)) / truth - 1)
        errors[name] = {"mean": float(error.mean()), "largest": float(error.max())}
    return errors


def measured(source: Path, folder: Path, light_only: bool, plugins: PluginManager) -> dict[str, Any]:
    """The line of one capture; `light_only` leaves out the fits."""
    capture = read_capture(source, "train", plugins)
    assert capture.environment is not None, "the capture states no true light"
    thing, probe = folder / "object", folder / "light.exr"
    errors = measured_light(source, capture, folder)
    rows: dict[str, Any] = {}
    lights = {
        "measured": (f'reflectance.known_environment="{probe.resolve()}"',),
        "true": (f'reflectance.known_environment="{capture.environment.path}*{capture.environment.strength}"',),
        "fitted": (),
    }
    for name, settings in () if light_only else lights.items():
        run = folder / f"run_{name}"
        shutil.rmtree(run, ignore_errors=True)
        words = [word for setting in (*settings, "export=[]") for word in ("--set", setting)]
        words += ["--set", 'atlas.texture_coordinates="auto"', "-q"]
        hir("delight", source / "reference.obj", thing, "-o", run, *words)
        rows[name] = relit(run, source)
    return {
        "capture": source.name,
        "irradiance_error": errors,
        "relit": rows,
        **provenance(),
    }


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Markdown: mean error of the irradiance (largest), and unscaled relit PSNR of the object under both lights."""
    lines = [
        "| capture | irradiance: mirror ball alone | with the grey ball | fitted light | measured light | true light |",
        "|---|---|---|---|---|---|",
    ]
    for row in rows:
        errors = [row["irradiance_error"][name] for name in ("mirror", "both")]
        cells = [row["capture"], *(f"{error['mean']:.1%} ({error['largest']:.1%})" for error in errors)]
        for name in ("fitted", "measured", "true"):
            found = row["relit"].get(name, {})  # empty where the fits were left out
            cells.append(", ".join(f"{each['psnr']['object']:.1f}" for each in found.values()) or "–")
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def draw_picture(source: Path, folder: Path, target: Path, plugins: PluginManager) -> None:
    """A long and a short exposure of one photograph, the measured light and the true one."""
    capture = read_capture(source, "train", plugins)
    assert capture.environment is not None
    names = sorted(file.name for file in (folder / "mirror").glob("*.png"))
    first = names[0].partition("_")[0]
    balls = [read_ldr(folder / "mirror" / f"{first}_{round(1 / e)}.png") for e in EXPOSURES[:2]]
    rows, columns = np.nonzero(balls[0][..., 3] > 0)
    around = slice(rows.min() - 4, rows.max() + 5), slice(columns.min() - 4, columns.max() + 5)
    pictures = [(each[..., :3] * each[..., 3:])[around] for each in balls]
    lights = [
        read_hdr(folder / "light.exr"),
        resample_latlong(read_hdr(capture.environment.path) * np.float32(capture.environment.strength), ROWS, 2 * ROWS),
    ]
    pictures += [linear_to_srgb(np.clip(each, 0, 1)) for each in lights]
    height = 256
    tiles = [Image.fromarray(np.round(np.clip(p, 0, 1) * 255).astype(np.uint8)) for p in pictures]
    tiles = [t.resize((round(t.width * height / t.height), height), Image.Resampling.LANCZOS) for t in tiles]
    page = Image.new("RGB", (sum(t.width for t in tiles) + 8 * (len(tiles) - 1), height), (246, 245, 242))
    left = 0
    for tile in tiles:
        page.paste(tile, (left, 0))
        left += tile.width + 8
    page.save(target, quality=88)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("captures", nargs="*", type=Path)
    parser.add_argument("--workspace", type=Path, help="folder of the photographs, the lights and the runs")
    parser.add_argument("--light-only", action="store_true", help="measure the light, fit nothing")
    parser.add_argument("--store", type=Path, help="file to which lines are added")
    parser.add_argument("--picture", type=Path, help="write the picture of an earlier measurement, measure nothing")
    parser.add_argument("--table", type=Path, metavar="FILE", help="print the table of stored lines, measure nothing")
    options = parser.parse_args()
    if options.table is not None:
        print(table(stored_rows(options.table)))
        return
    if not options.captures or options.workspace is None:
        parser.error("name captures and --workspace, or --table")
    plugins = PluginManager.discover()
    for source in options.captures:
        folder = options.workspace / source.name
        if options.picture is not None:
            draw_picture(source, folder, options.picture, plugins)
            continue
        row = measured(source, folder, options.light_only, plugins)
        if options.store is None:
            print(json.dumps(row, indent=2))
        else:
            add_rows(options.store, [row])


if __name__ == "__main__":
    main()
