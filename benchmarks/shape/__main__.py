"""`python -m benchmarks.shape make OUT`: renders the captures of the shape benchmark."""

from __future__ import annotations

import argparse
import os
import time
from pathlib import Path

from benchmarks.shape.recipes import recipes


def main() -> None:
    parser = argparse.ArgumentParser(description="Made captures with true meshes.")
    commands = parser.add_subparsers(dest="command", required=True)
    commands.add_parser("list", help="print the captures, one a line")
    make = commands.add_parser("make", help="render captures; those that are complete are kept")
    make.add_argument("out", type=Path)
    make.add_argument("--half", choices=("tuning", "validation"), help="only one half")
    make.add_argument("--only", nargs="*", default=(), help="names of captures, or of objects")
    make.add_argument("--variant", default="llvm_ad_rgb", help="Mitsuba's variant")
    options = parser.parse_args()
    chosen = recipes()
    if options.command == "list":
        for recipe in chosen:
            print(f"{recipe.name}  {recipe.kind}  {recipe.light}  {recipe.half}")
        return
    if options.half:
        chosen = [recipe for recipe in chosen if recipe.half == options.half]
    if options.only:
        chosen = [recipe for recipe in chosen if recipe.name in options.only or recipe.object in options.only]
    import drjit
    import mitsuba as mi

    mi.set_variant(options.variant)
    drjit.set_thread_count(int(os.environ.get("OMP_NUM_THREADS", os.cpu_count() or 1)))
    from benchmarks.shape.render import write_capture

    for recipe in chosen:
        folder = options.out / recipe.half / recipe.name
        if (folder / "truth.json").exists():
            continue
        started = time.perf_counter()
        write_capture(recipe, folder)
        print(f"{folder}  {time.perf_counter() - started:.0f} s", flush=True)


if __name__ == "__main__":
    main()
