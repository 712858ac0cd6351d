"""Exporters: seconds and bytes as assets grow, and how far the material that is read back is from the asset's."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from hir_exporters.asset import Asset, AssetEnvironment, AssetMaterial
from hir_exporters.errors import HirError
from hir_exporters.reading.file_verification import READERS, verify_file

from hir_core.testing.assets import ball, textured_asset, waves
from hir_plugins.commands.bench.bench_plan import Plan
from hir_plugins.commands.bench.measurement import measure
from hir_plugins.commands.bench.results.bench_result import Case, Row, Timing

SIZES = ((36, 256), (72, 512), (144, 1024))
"""Rings of the ball (5k, 20k and 82k triangles) and the side of its textures."""


def export(plan: Plan) -> Iterator[Row]:
    """Rows for each size and each format that is installed."""
    names = [r.component.name for r in plan.plugins.components("exporter") if not r.missing]
    last: dict[str, Timing] = {}
    for rings, side in SIZES[:1] if plan.quick else SIZES:
        asset = textured_ball(rings, side)
        case: Case = {"triangles": len(asset.mesh.faces), "texture": side}
        for name in names:
            if plan.too_slow(last.get(name), 4):
                yield Row(case, name, "ours", None, note=plan.left_out(last[name]))
                continue
            with tempfile.TemporaryDirectory() as folder:
                place = Path(folder) / f"asset.{name}"
                exporter = plan.plugins.create("exporter", name, {})
                report = exporter.write(asset, place)
                last[name] = measure(partial(exporter.write, asset, place), min(plan.repeats, 3), False)
                size = sum(file.stat().st_size for file in report.files) / 1e6
                errors, note = {"MB": size}, ""
                if report.files[0].suffix in READERS:
                    try:
                        errors["BRDF error"] = verify_file(report.files[0], asset).brdf
                    except HirError as error:
                        note = f"not read back: {error}"
                yield Row(case, name, "ours", last[name], errors, note)


def textured_ball(rings: int, side: int) -> Asset:
    """A glossy ball whose textures vary everywhere, under a light of noise."""
    plain = textured_asset()

    def enlarged(channels: int, low: float, high: float, seed: int) -> np.ndarray:
        small = waves(channels, low, high, seed)
        times = -(-side // small.shape[0])
        return np.ascontiguousarray(np.tile(small, (times, times, 1))[:side, :side])

    material: AssetMaterial = replace(
        plain.material,
        diffuse_albedo=enlarged(3, 0.05, 0.8, 1),
        specular_albedo=enlarged(3, 0.02, 0.08, 2),
        roughness=enlarged(1, 0.05, 0.6, 3)[..., 0],
        normal=None,
        observed=None,
    )
    light = np.random.default_rng(0).gamma(0.5, 1.0, (64, 128, 3)).astype(np.float32)
    return Asset(ball(rings, 2 * rings), material, AssetEnvironment(light), name="ball")
