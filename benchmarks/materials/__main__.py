"""`python -m benchmarks.materials make OUT`: renders the captures of the materials benchmark."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from benchmarks.materials.recipes import recipes
from hir_core.files.json_documents import write_json
from hir_plugins.commands.bench.inputs.materials_captures import INDEX


def main() -> None:
    parser = argparse.ArgumentParser(description="Small made captures with known truth.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="print the captures, one a line")
    make = commands.add_parser("make", help="render captures; those that are complete are kept")
    make.add_argument("out", type=Path)
    make.add_argument("--half", choices=("tuning", "validation"), help="only one half")
    make.add_argument("--only", nargs="*", default=(), help="names or numbers of captures")
    make.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's variant")
    options = parser.parse_args()
    chosen = recipes()
    if options.command == "list":
        for recipe in chosen:
            print(f"{recipe.name}  {recipe.half}  exposure {recipe.exposure}  relit: {', '.join(recipe.relights)}")
        return
    if options.half:
        chosen = [recipe for recipe in chosen if recipe.half == options.half]
    if options.only:
        chosen = [r for r in chosen if r.name in options.only or r.name.partition("_")[0] in options.only]
    write_index(options.out)
    import mitsuba as mi

    mi.set_variant(options.variant)
    from benchmarks.materials.render import write_capture

    for recipe in chosen:
        folder = options.out / recipe.half / recipe.name
        if (folder / "truth.json").exists():
            continue
        started = time.perf_counter()
        write_capture(recipe, folder)
        print(f"{folder}  {time.perf_counter() - started:.0f} s", flush=True)


def write_index(out: Path) -> None:
    """Writes the name and half of every capture, rendered or not: `hir bench materials` says which are missing."""
    write_json(out / INDEX, {"captures": {recipe.name: recipe.half for recipe in recipes()}})


if __name__ == "__main__":
    main()
