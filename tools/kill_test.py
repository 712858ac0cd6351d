"""Kills a small run with SIGKILL at random moments, resumes it, and compares all files with those of a whole run.

    python tools/kill_test.py [--kills 50] [--seed 0] [--kind cached|traced|sfm] [--keep FOLDER]

One warm process imports everything and forks a child for each run, so that a kill costs seconds. Moments are drawn
evenly over the length of a run, from a seed. Prints what was interrupted; exit code 1 if any file differs.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from importlib import import_module
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

SMALL = {
    "geometry.iterations": "15",
    "geometry.levels": "2",
    "geometry.triangles": "1200",
    "geometry.photo_consistency_iterations": "6",
    "geometry.occlusion_boundary_iterations": "6",
    "geometry.outline_iterations": "6",
    "atlas.texture_size": "64",
    "reflectance.environment_height": "8",
    "reflectance.environment_width": "16",
    "export": '["glb", "usdz", "obj", "hdr"]',
    "checkpoint_seconds": "0.05",
}
KINDS = {
    "cached": {
        "initializer.visual_hull.max_resolution": "40",
        "reflectance.light_frame": "world",
        "reflectance.brdf": "dielectric",
        "reflectance_renderer.transport_ggx.steps": "24",
        "reflectance_renderer.transport_ggx.cache_cells": "300",
        "reflectance_renderer.transport_ggx.vertices": "1500",
        "reflectance_renderer.transport_ggx.samples": "4",
    },
    "traced": {
        "initializer.visual_hull.max_resolution": "40",
        "reflectance.renderer": "mitsuba_ggx",
        "reflectance.method": "gradient",
        "reflectance.model": "specular",
        "reflectance.gradient.iterations": "12",
        "reflectance.gradient.batch_pixels": "1024",
        "reflectance_renderer.mitsuba_ggx.samples": "4",
        "reflectance_renderer.mitsuba_ggx.render_samples": "4",
    },
    "sfm": {
        "initializers": '["colmap", "mesh_file"]',
        "initializer.colmap.focal_length": "310",
        "initializer.colmap.max_features": "1024",
    },
}
"""Cached transport with model selection; the path tracer with gradient steps; cameras and mesh colours solved from
photographs alone."""

UNTIL = {"sfm": "initializer"}
PHOTOGRAPHS = 8
OCTAHEDRON = """v .3 0 0
v 0 .3 0
v 0 0 .3
v -.3 0 0
v 0 -.3 0
v 0 0 -.3
f 1 2 3
f 2 4 3
f 4 5 3
f 5 1 3
f 2 1 6
f 4 2 6
f 5 4 6
f 1 5 6
"""

WARM = (
    "torch",
    "mitsuba",
    "open3d",
    "pycolmap",
    "trimesh",
    "xatlas",
    "scipy.optimize",
    "hir_core.report.rendered_pictures",
    "hir_plugins.initializers.hull.visual_hull",
    "hir_plugins.geometry_renderers.contour",
    "hir_plugins.reflectance_renderers.transport_ggx.renderer",
)
"""Imported once, before any child: none of it starts a thread."""

CLOCKED = {"timings.json", "report.html", "log.txt", ".lock", "database.db"}
"""Files that contain times, and COLMAP's database, whose pages are in the order of its writes."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, default="cached")
    parser.add_argument("--keep", type=Path, help="work in this folder and keep it")
    options = parser.parse_args()
    for module in WARM:
        import_module(module)
    with tempfile.TemporaryDirectory() as folder:
        folder = options.keep or Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        return kill_and_resume(captured(folder / "capture", options.kind), folder, options)


def captured(folder: Path, kind: str) -> Path:
    """The input: the reduced sample capture, or photographs of a painted room without cameras."""
    from tests.fixtures.runs import make_tiny

    if kind != "sfm":
        return make_tiny(folder, train=10, test=1)
    folder.mkdir()
    folder.with_name("octahedron.obj").write_text(OCTAHEDRON)
    from hir_exporters.textures.image_files import write_png

    from tests.hir_plugins.initializers.test_colmap import cameras_on_an_arc, room

    for number, camera in enumerate(cameras_on_an_arc(PHOTOGRAPHS)):
        write_png(folder / f"{number:02}.png", room(camera, 0))
    return folder


def kill_and_resume(capture: Path, folder: Path, options: argparse.Namespace) -> int:
    """Prints a line for each kill; returns 0 if all runs ended with the files of the uninterrupted one, else 1."""
    kills, kind = options.kills, options.kind
    started = time.monotonic()
    if wait(start(capture, folder / "whole", kind)) != 0:
        print((folder / "whole.log").read_text())
        return 1
    length = time.monotonic() - started
    truth = final_files(folder / "whole")
    print(f"unbroken run: {length:.1f} s, {len(truth)} files, {sum(map(len, truth.values())) / 1e6:.1f} MB", flush=True)
    draw = random.Random(options.seed)
    same, where = 0, Counter()
    for number in range(kills):
        run = folder / f"run-{number}"
        moment = draw.uniform(0.0, length)
        child = start(capture, run, kind)
        time.sleep(moment)
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        stage, kept = interrupted_in(run)
        code = wait(start(capture, run, kind))
        wrong = differences(truth, final_files(run)) if code == 0 else [f"exit code {code}: {last_line(run)}"]
        left = [p.name for p in run.rglob(".hir-partial-*")] + [p.name for p in run.rglob("checkpoints")]
        same += not wrong and not left
        where[stage] += 1
        verdict = "the same files" if not wrong and not left else f"DIFFERENT: {', '.join([*wrong, *left])}"
        note = f" with {kept} states kept" if kept else ""
        print(f"{number + 1:3}: killed at {moment:5.2f} s in {stage}{note}: {verdict}", flush=True)
        if not wrong and not left:
            shutil.rmtree(run)
    print(f"{same} of {kills} the same; killed in: {', '.join(f'{k} {v}' for k, v in sorted(where.items()))}")
    return 0 if same == kills else 1


def start(capture: Path, run: Path, kind: str) -> int:
    """Starts or resumes the run in a child process; returns its id."""
    child = os.fork()
    if child:
        return child
    code = 1
    try:
        log = os.open(run.with_suffix(".log"), os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        os.dup2(log, 1)
        os.dup2(log, 2)
        from hir_core.pipeline import reconstruct

        settings = [f"{key}={value}" for key, value in (SMALL | KINDS[kind]).items()]
        if kind == "sfm":
            settings.append(f"initializer.mesh_file.path={capture.with_name('octahedron.obj')}")
        reconstruct(
            capture,
            run,
            assignments=settings,
            device="cpu",
            deterministic=True,
            resume=True,
            on_message=print,
            until=UNTIL.get(kind),
        )
        code = 0
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        os._exit(code)


def wait(child: int) -> int:
    """Exit code of a child; 128 + the signal that ended it."""
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else 128 + os.WTERMSIG(status)


def final_files(run: Path) -> dict[str, bytes]:
    """The files of a run without those that contain times."""
    return {str(p.relative_to(run)): p.read_bytes() for p in run.rglob("*") if p.is_file() and p.name not in CLOCKED}


def differences(truth: dict[str, bytes], found: dict[str, bytes]) -> list[str]:
    """Names of files that are missing, new or different."""
    return sorted(name for name in truth.keys() | found.keys() if truth.get(name) != found.get(name))


def interrupted_in(run: Path) -> tuple[str, int]:
    """The current stage and its number of checkpoints; COLMAP's database counts as one."""
    kept = len([*run.rglob("work/checkpoints/*.npz"), *run.rglob("work/**/database.db")]) if run.exists() else 0
    ended = False
    for record in sorted(run.glob("stages/*/stage.json")):
        ended = json.loads(record.read_text())["finished"]
        if not ended:
            return record.parent.name, kept
    return ("report or export" if ended and (run / "stages" / "6-export").exists() else "between stages"), kept


def last_line(run: Path) -> str:
    """The end of a run's log."""
    lines = run.with_suffix(".log").read_text().strip().splitlines()
    return lines[-1] if lines else ""


if __name__ == "__main__":
    sys.exit(main())
