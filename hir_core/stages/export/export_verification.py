"""Each export proves itself: its files are read back from disk, compared with the asset, and rendered again.

Reading back is light and always possible; rendering needs the packages of `hir[reconstruct]` and the cameras of a run
(`hir_core.stages.export.export_rerendering`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from hir_exporters.asset import Asset
from hir_exporters.engines.engine_shaders import engine_psnr
from hir_exporters.errors import HirError
from hir_exporters.exporter import ExportReport
from hir_exporters.light.environment_map import mean_radiance
from hir_exporters.reading.file_verification import READERS, compare, read_back
from hir_exporters.reading.written_asset import written_asset, written_light

from hir_core.stages.export.export_rerendering import GOOD_PSNR

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_core.stages.export.export_rerendering import Rerender


LIGHT_SUFFIXES: Final = (".hdr", ".exr")


@dataclass(frozen=True)
class Verified:
    """What was found out about the files of one format."""

    report: Mapping[str, Any]
    """JSON-able: what was read back and its errors, what was rendered and its PSNR; what could not be done and why."""
    warnings: tuple[str, ...]
    """One sentence for each thing that the files should have kept and did not."""

    def sentence(self) -> str:
        """One line for a person."""
        if "not_read" in self.report:
            return str(self.report["not_read"])
        if "mean_radiance" in self.report:
            return f"read back: mean radiance off by {self.report['mean_radiance']:.2g}"
        parts = ["read back"]
        if "brdf" in self.report:
            parts = [f"read back: material off by {self.report['brdf']:.1%} on the BRDF slice"]
        if "psnr" in self.report:
            psnr = self.report["psnr"]
            parts.append(
                f"re-rendered from {len(psnr['views'])} cameras: {psnr['object']:.1f} dB (worst "
                f"{min(psnr['views'].values()):.1f})"
            )
        elif "not_rendered" in self.report:
            parts.append(f"not re-rendered: {self.report['not_rendered']}")
        if "engines" in self.report:
            shown = ", ".join(f"{name} {value:.0f}" for name, value in self.report["engines"].items())
            parts.append(f"by the formulas of engines, in dB: {shown}")
        return "; ".join(parts)


def verify_export(
    written: ExportReport,
    asset: Asset,
    options: Mapping[str, Any] | None = None,
    rerender: Rerender | None = None,
    why_not: str = "",
) -> Verified:
    """Reads the first file of an export back, compares it with the asset, and renders it where `rerender` is given.

    `options` are those that the format was written with; `why_not` says why nothing is rendered.
    """
    path = written.files[0]
    try:
        if path.suffix in LIGHT_SUFFIXES:
            return _light(path, asset)
        if path.suffix not in READERS:
            return Verified({"not_read": f"no independent reader reads {path.suffix} files"}, ())
        return _surface(written, path, asset, dict(options or {}), rerender, why_not)
    except HirError as error:
        return Verified({"not_read": str(error)}, (f"the file that was written cannot be read back: {error}",))


def _light(path: Path, asset: Asset) -> Verified:
    if asset.environment is None:
        return Verified({"not_read": "the asset has no light to compare with"}, ())
    want = mean_radiance(asset.environment.radiance)
    have = mean_radiance(written_light(path).radiance)
    off = float(np.abs(have - want).max() / max(float(want.max()), 1e-30))
    problem = (f"{path.name}: the light's mean is off by {off:.1%}",) if off > 0.01 else ()
    return Verified({"file": path.name, "mean_radiance": off}, problem)


def _surface(
    export: ExportReport, path: Path, asset: Asset, options: dict[str, Any], rerender: Rerender | None, why_not: str
) -> Verified:
    profile = str(options.get("profile", "khr"))
    back = read_back(path)
    compared = compare(path, asset, back, profile)
    report: dict[str, Any] = {"file": path.name}
    problems = list(compared.problems)
    if any("triangles were reduced" in warning for warning in export.warnings):
        report["geometry"] = "reduced to a budget: not compared corner by corner"
        problems = []
    else:
        report |= {
            "positions": compared.positions,
            "uvs": compared.uvs,
            "normals_degrees": compared.normals_degrees,
            "brdf": round(compared.brdf, 4),
        }
    report["engines"] = engine_psnr(asset, back.surface, back.legacy, usd=path.suffix.startswith(".usd"))
    if rerender is None:
        return Verified(report | ({"not_rendered": why_not} if why_not else {}), tuple(problems))
    light = next((f for f in export.files[1:] if f.suffix in LIGHT_SUFFIXES), None)
    written = written_asset(back, profile)
    found = rerender.compare(written, None if light is None else written_light(light))
    report |= found
    report["light"] = "the run's own" if light is None or not rerender.light_in_world else light.name
    psnr = found["psnr"]["object"]
    if psnr < GOOD_PSNR:
        costs = found["costs"]
        dearest = min(costs, key=lambda name: costs[name])
        problems.append(
            f"{path.name}: re-rendered it has {psnr:.1f} dB against the fitted scene; what costs most is {dearest} "
            f"(alone {costs[dearest]:.1f} dB; read as: {written.understood})"
        )
    return Verified(report, tuple(problems))


def rerender_of_run(run: Path, asset: Asset, plugins: PluginManager) -> tuple[Rerender | None, str]:
    """What renders the files of a finished run again; or None and why not: no run, no light, packages missing."""
    from hir_core.run.run_directory import RunDirectory

    if not (run / "run.json").is_file():
        return None, "a scene that is not a run has no cameras"
    if asset.environment is None:
        return None, "the asset has no light"
    renderers = plugins.components("reflectance_renderer")
    missing = sorted({name for r in renderers if "reference" in r.component.traits for name in r.missing})
    if missing:
        return None, f"needs {', '.join(missing)}; install them with: pip install 'hir[reconstruct]'"
    from hir_core.capture.capture_store import read_cameras
    from hir_core.rendering.reference_renderer import open_for_rendering
    from hir_core.stages.export.export_rerendering import Rerender

    opened = open_for_rendering(RunDirectory(run))
    cameras = read_cameras(opened.directory.cameras)
    if not cameras:
        return None, "the run has no cameras"
    return Rerender(asset, cameras, opened.working_from_asset, plugins, side=256, bounces=opened.bounces), ""
