"""What limits `transport_ggx` in cavities: cells of the irradiance cache, directions of a lobe, or rows of the light.

    python -m benchmarks.cache_cells [-o benchmarks/results/cache_cells.json]

Errors on the scenes of `hir bench shading`, with GGX width 0.1 and direct light, against 2,048 paths per pixel. ρs = 0
leaves the diffuse part alone, which reads the cache. Prints a table of the mean errors.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Final

from hir_core.plugins.manager import PluginManager
from hir_core.rendering.reference_renderer import reference_renderer
from hir_core.scene import Scene
from hir_core.testing.scenes import constant_material, looking_at
from hir_plugins.commands.bench.inputs.uniform_pixels import uniform_pixels
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Case, Result, Row
from hir_plugins.commands.bench.results.markdown_tables import machine_line
from hir_plugins.commands.bench.suites import shading_suite

VARIANTS: Final[Mapping[str, dict[str, int]]] = {
    "default": {},
    "12,000 cells": {"cache_cells": 12_000},
    "24,000 cells": {"cache_cells": 24_000},
    "40,000 cells": {"cache_cells": 40_000},
    "64 directions": {"samples": 64},
    "24,000 cells, 64 directions": {"cache_cells": 24_000, "samples": 64},
    "24,000 cells, 64 rows": {"cache_cells": 24_000, "diffuse_rows": 64},
}
"""Options that differ from the defaults: 6,000 cells, 16 directions, 32 rows of the light."""
ALPHA: Final = 0.1


def rows() -> Iterator[Row]:
    plugins = PluginManager.discover()
    _, path_tracer = reference_renderer(plugins, "", {"samples": shading_suite.REFERENCE_PATHS, "max_depth": 2})
    for mesh_name, (make_mesh, eye) in shading_suite.SHADED_MESHES.items():
        mesh = make_mesh()
        uniform = uniform_pixels(mesh, looking_at(eye, shading_suite.IMAGE_SIZE))
        for light_name, light in shading_suite.lights().items():
            for specular in (0.0, 0.2):
                scene = Scene(mesh, constant_material("dielectric", 0.4, specular, ALPHA), light)
                reference = shading_suite.render_radiance(path_tracer, scene, eye)
                case: Case = {"scene": mesh_name, "light": light_name, "ρs": specular}
                for name, options in VARIANTS.items():
                    renderer = plugins.create("reflectance_renderer", "transport_ggx", options)
                    work = partial(shading_suite.render_radiance, renderer, scene, eye)
                    timing = measure(work, repeats=1, warm_up=False)
                    errors = shading_suite.radiance_errors(work(), reference, uniform)
                    yield Row(case, name, "ours", timing, errors)


def table(result: Result) -> str:
    """Mean errors in percent: a row for each case, a column for each variant."""
    cells: dict[tuple[str, ...], dict[str, float]] = {}
    for row in result.rows:
        cells.setdefault(tuple(map(str, row.case.values())), {})[row.method] = row.errors["mean error"]
    lines = ["| scene | light | ρs | " + " | ".join(VARIANTS) + " |", "|" + "---|" * (3 + len(VARIANTS))]
    for case, errors in cells.items():
        figures = [f"{100 * errors[name]:.2f}" if name in errors else "–" for name in VARIANTS]
        lines.append("| " + " | ".join([*case, *figures]) + " |")
    return "\n".join([*lines, "", machine_line(result)])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=Path("benchmarks/results/cache_cells.json"))
    output = parser.parse_args().output
    result = Result("cache_cells", ())
    for row in rows():
        result = Result("cache_cells", (*result.rows, row))
        result.write(output)
    print(table(result))


if __name__ == "__main__":
    main()
