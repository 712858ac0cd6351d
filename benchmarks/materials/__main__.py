"""`python -m benchmarks.materials make OUT`: renders the captures of the materials benchmark.

`model FILE OUT` renders one larger capture of a model file, with a material and lights of the benchmark.
`noise OUT` prints for each capture the PSNR that the noise of its photographs allows.
"""

from __future__ import annotations

import argparse
import time
import zlib
from pathlib import Path

from benchmarks.materials.lights import LIGHTS
from benchmarks.materials.materials import MATERIALS
from benchmarks.materials.model_shapes import shape_of_model
from benchmarks.materials.recipes import Recipe, recipes
from benchmarks.materials.shapes import make_shape
from hir_core.files.json_documents import write_json
from hir_plugins.commands.bench.inputs.materials_captures import INDEX


def main() -> None:
    parser = argparse.ArgumentParser(description="Small made captures with known truth.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="print the captures, one a line")
    make = commands.add_parser("make", help="render captures; those that are complete are kept")
    make.add_argument("out", type=Path)
    noise = commands.add_parser("noise", help="print the PSNR that the photographs' own noise allows")
    noise.add_argument("out", type=Path, help="the folder of `make`")
    noise.add_argument("--views", type=int, default=4, help="test views that are rendered once more")
    for command in (make, noise):
        command.add_argument("--half", choices=("tuning", "validation"), help="only one half")
        command.add_argument("--only", nargs="*", default=(), help="names or numbers of captures")
        command.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's variant")
    model = commands.add_parser("model", help="render one capture of a model file")
    model.add_argument("file", type=Path, help="glTF, OBJ or PLY")
    model.add_argument("out", type=Path)
    model.add_argument("--material", choices=tuple(MATERIALS), required=True)
    model.add_argument("--lights", nargs=3, choices=tuple(LIGHTS), default=("windows", "overcast", "sun"),
                       help="the light of the photographs, and two other ones")  # fmt: skip
    model.add_argument("--side", type=int, default=384, help="pixels")
    model.add_argument("--samples", type=int, default=128, help="paths for each pixel")
    model.add_argument("--views", type=int, default=64, help="training photographs")
    model.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's variant")
    options = parser.parse_args()
    if options.command == "model":
        if not options.file.is_file():
            parser.error(f"{options.file} is not a file; name a model in glTF, OBJ or PLY")
        render_model(options)
        return
    chosen = recipes()
    if options.command == "list":
        for recipe in chosen:
            print(f"{recipe.name}  {recipe.half}  exposure {recipe.exposure}  relit: {', '.join(recipe.relights)}")
        return
    if options.half:
        chosen = [recipe for recipe in chosen if recipe.half == options.half]
    if options.only:
        chosen = [r for r in chosen if r.name in options.only or r.name.partition("_")[0] in options.only]
    import mitsuba as mi

    mi.set_variant(options.variant)
    if options.command == "noise":
        from benchmarks.materials.photograph_noise import print_noise

        if not print_noise(options.out, chosen, options.views):
            parser.error(f"{options.out} has none of these captures; render them with: make {options.out}")
        return
    write_index(options.out)
    from benchmarks.materials.render import write_capture

    for recipe in chosen:
        folder = options.out / recipe.half / recipe.name
        if (folder / "truth.json").exists():
            continue
        started = time.perf_counter()
        write_capture(recipe, make_shape(recipe.shape), folder)
        print(f"{folder}  {time.perf_counter() - started:.0f} s", flush=True)


def render_model(options: argparse.Namespace) -> None:
    """One capture of a model file; what is random in it follows from the names."""
    import mitsuba as mi

    mi.set_variant(options.variant)
    from benchmarks.materials.render import SPLITS, RenderSettings, write_capture

    light, *others = options.lights
    name = f"{options.file.stem}_{options.material}_{light}"
    seed = zlib.crc32(name.encode())
    recipe = Recipe(name, options.file.stem, options.material, light, (others[0], others[1]), 0.9, "validation", seed)
    settings = RenderSettings(options.side, options.samples, SPLITS | {"train": options.views})
    write_capture(recipe, shape_of_model(options.file), options.out, settings)


def write_index(out: Path) -> None:
    """Writes the name and half of every capture, rendered or not: `hir bench materials` says which are missing."""
    write_json(out / INDEX, {"captures": {recipe.name: recipe.half for recipe in recipes()}})


if __name__ == "__main__":
    main()
