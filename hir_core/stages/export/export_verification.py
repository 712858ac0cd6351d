"""Verifies an export: its files are read back from disk, compared with the asset, and rendered.

Reading back needs no heavy package. Rendering needs the packages of `hir[reconstruct]` and the cameras of a run
(`hir_core.stages.export.export_rerendering`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from hir_exporters.asset import Asset
from hir_exporters.engines.engine_shaders import EngineComparison
from hir_exporters.errors import HirError
from hir_exporters.exporter import ExportReport
from hir_exporters.light.environment_map import mean_radiance
from hir_exporters.reading.asset_decoding import decode_asset
from hir_exporters.reading.environment_import import read_environment
from hir_exporters.reading.file_verification import READERS, compare_with_asset, read_back
from numpy.typing import NDArray

from hir_core.stages.export.render_threshold import GOOD_PSNR

if TYPE_CHECKING:
    from hir_core.plugins.manager import PluginManager
    from hir_core.stages.export.export_rerendering import Rerender


LIGHT_SUFFIXES: Final = (".hdr", ".exr")


@dataclass(frozen=True)
class ExportVerification:
    """The result for the files of one format."""

    report: Mapping[str, Any]
    """JSON-able: errors of the files that were read back, PSNR of their renders, and reasons for what was left out."""
    warnings: tuple[str, ...]
    """One sentence for each property that the files do not preserve."""

    def sentence(self) -> str:
        """The report in one line."""
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
                f"{min(psnr['views'].values()):.1f}) against the fitted scene, which measures the file and not the fit"
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
    engines: EngineComparison | None = None,
    edited_by: Sequence[str] = (),
) -> ExportVerification:
    """Reads the first file of an export back, compares it with the asset, and renders it with `rerender`.

    `options` are those that the format was written with; `why_not` is the reason where nothing is rendered. `engines`
    is the comparison with this asset that several formats share; without it a new one is made. `edited_by` names the
    hooks of plugins that edited the document of the file.
    """
    path = written.files[0]
    try:
        if path.suffix in LIGHT_SUFFIXES:
            return _light(path, asset)
        if path.suffix not in READERS:
            return ExportVerification({"not_read": f"no independent reader reads {path.suffix} files"}, ())
        comparison = EngineComparison(asset) if engines is None else engines
        return _surface(written, path, asset, dict(options or {}), rerender, why_not, comparison)
    except HirError as error:
        hooks = f" (its document was edited by {', '.join(edited_by)})" if edited_by else ""
        return ExportVerification({"not_read": str(error)}, (f"the written file cannot be read back: {error}{hooks}",))


def _light(path: Path, asset: Asset) -> ExportVerification:
    if asset.environment is None:
        return ExportVerification({"not_read": "the asset has no light"}, ())
    want = mean_radiance(asset.environment.radiance)
    have = mean_radiance(read_environment(path).radiance)
    off = float(np.abs(have - want).max() / max(float(want.max()), 1e-30))
    problem = (f"{path.name}: the light's mean is off by {off:.1%}",) if off > 0.01 else ()
    return ExportVerification({"file": path.name, "mean_radiance": off}, problem)


def _surface(
    export: ExportReport,
    path: Path,
    asset: Asset,
    options: dict[str, Any],
    rerender: Rerender | None,
    why_not: str,
    engines: EngineComparison,
) -> ExportVerification:
    profile = str(options.get("profile", "khr"))
    back = read_back(path)
    compared = compare_with_asset(path, asset, back, profile)
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
    if profile == "engine":
        rerender, why_not = None, "profile engine changes material and light for the shading of engines"
    else:  # the formulas of engines have no lights
        report["engines"] = engines.psnr(back.surface, back.specular_surface, usd=path.suffix.startswith(".usd"))
    if rerender is None:
        return ExportVerification(report | ({"not_rendered": why_not} if why_not else {}), tuple(problems))
    light = next((f for f in export.files[1:] if f.suffix in LIGHT_SUFFIXES), None)
    written = decode_asset(back, profile, as_metallic=asset.material.model == "metallic")
    found = rerender.compare(written, None if light is None else read_environment(light))
    report |= found
    report["light"] = "the run's own" if light is None or not rerender.light_in_world else light.name
    psnr = found["psnr"]["object"]
    if psnr < GOOD_PSNR:
        costs = found["costs"]
        worst_part = min(costs, key=lambda name: costs[name])
        problems.append(
            f"{path.name}: its render has {psnr:.1f} dB against the fitted scene; {worst_part} costs most "
            f"({costs[worst_part]:.1f} dB alone; read as: {written.interpretation})"
        )
    return ExportVerification(report, tuple(problems))


def rerender_of_run(
    run: Path, asset: Asset, plugins: PluginManager, placement: NDArray[np.float64]
) -> tuple[Rerender | None, str]:
    """The `Rerender` of a finished run; or None and the reason: no run, no light, missing packages, a scene of an
    earlier call, no cameras.

    `placement` is the matrix (4, 4) by which the asset was scaled and moved after it was read from the run.
    """
    if not (run / "run.json").is_file():
        return None, "only a run has cameras and a fitted scene to compare with"
    if asset.environment is None:
        return None, "the asset has no light"
    renderers = plugins.components("reflectance_renderer")
    missing = sorted({name for r in renderers if "reference" in r.component.traits for name in r.missing})
    if missing:
        return None, f"needs {', '.join(missing)}; install them with: pip install 'hir[reconstruct]'"
    from hir_core.run.capture_store import read_cameras
    from hir_core.run.finished_run import open_finished_run
    from hir_core.run.run_directory import RunDirectory
    from hir_core.stages.export.export_rerendering import Rerender

    if not RunDirectory(run).has_finished_scene:
        return None, "the run is not finished: its settings may be others than those of its scene"
    opened = open_finished_run(RunDirectory(run))
    cameras = read_cameras(opened.directory.cameras)
    if not cameras:
        return None, "the run has no cameras"
    placed = {name: camera.transformed(placement) for name, camera in cameras.items()}
    working_from_asset = opened.frames.working_from_asset @ np.linalg.inv(placement)
    device = str(opened.scene.mesh.positions.device)
    return Rerender(asset, placed, working_from_asset, plugins, side=256, bounces=opened.bounces, device=device), ""
