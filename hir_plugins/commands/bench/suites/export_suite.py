"""Exporters: time and bytes at growing sizes, and how closely the file's material matches the asset's."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial
from hir_exporters.errors import HirError
from hir_exporters.reading.file_verification import READERS, verify_file
from numpy.typing import NDArray

from hir_core.testing.assets import ball, textured_asset, waves
from hir_plugins.commands.bench.bench_options import BenchOptions
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing
from hir_plugins.commands.bench.suites.export_command_rows import export_command_rows

SIZES: Final = ((36, 256), (72, 512), (144, 1024))
"""Rings of the sphere (5k, 20k and 82k triangles) and side of its textures in texels."""


def exporter_rows(options: BenchOptions) -> Iterator[Row]:
    """Rows for each size and each installed format, then those of the whole command."""
    names = [r.component.name for r in options.plugins.components("exporter") if not r.missing]
    timings: dict[str, Timing] = {}
    for rings, side in SIZES[:1] if options.quick else SIZES:
        asset = textured_sphere(rings, side)
        case: Case = {"triangles": len(asset.mesh.faces), "texture": side}
        for name in names:
            if options.exceeds_limit(timings.get(name), 4):
                yield Row(case, name, "ours", None, note=options.omission_note(timings[name]))
                continue
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / f"asset.{name}"
                exporter = options.plugins.create("exporter", name, {})
                report = exporter.write(asset, path)
                timings[name] = measure(partial(exporter.write, asset, path), min(options.repeats, 3), False)
                errors, note = {"MB": sum(file.stat().st_size for file in report.files) / 1e6}, ""
                if report.files[0].suffix in READERS:
                    try:
                        errors["BRDF error"] = verify_file(report.files[0], asset).brdf
                    except HirError as error:
                        note = f"not read back: {error}"
                yield Row(case, name, "ours", timings[name], errors, note)
    if not options.quick:
        yield from export_command_rows(min(options.repeats, 3))


def textured_sphere(rings: int, side: int) -> Asset:
    """A glossy sphere with varying textures of side², under a light of noise."""

    def texture(channels: int, low: float, high: float, seed: int) -> NDArray[np.float32]:
        tile = waves(channels, low, high, seed)
        repeats = -(-side // tile.shape[0])
        return np.ascontiguousarray(np.tile(tile, (repeats, repeats, 1))[:side, :side])

    material: AssetMaterial = replace(
        textured_asset().material,
        diffuse_albedo=texture(3, 0.05, 0.8, 1),
        specular_albedo=texture(3, 0.02, 0.08, 2),
        roughness=texture(1, 0.05, 0.6, 3)[..., 0],
        normal=None,
        observed=None,
    )
    light = np.random.default_rng(0).gamma(0.5, 1.0, (64, 128, 3)).astype(np.float32)
    return Asset(ball(rings, 2 * rings), material, AssetEnvironment(light), name="ball")
