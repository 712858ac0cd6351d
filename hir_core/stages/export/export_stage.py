"""The export stage: the asset in every format of the settings, each file read back, compared and rendered again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hir_exporters.asset_health import asset_health
from hir_exporters.engines.engine_shaders import EngineComparison
from hir_exporters.files.atomic import atomic_directory

from hir_core.run.capture_store import read_cameras
from hir_core.run.stage_context import StageContext
from hir_core.stages.export.asset_export import editors_of, export_asset
from hir_core.stages.export.export_rerendering import Rerender
from hir_core.stages.export.export_verification import verify_export

if TYPE_CHECKING:
    from hir_core.stages.run_state import RunState


@dataclass(frozen=True)
class FormatReport:
    """What was written in one format."""

    files: tuple[str, ...]
    residuals: Mapping[str, float]
    """Errors of the material conversion."""
    verified: Mapping[str, Any]
    """What reading back and rendering again measured, and the health of the asset."""


@dataclass(frozen=True)
class ExportStageReport:
    """One entry a format."""

    formats: Mapping[str, FormatReport]

    def as_document(self) -> dict[str, Any]:
        """For run.json."""
        return {
            name: {"files": list(report.files), "residuals": dict(report.residuals), "verified": dict(report.verified)}
            for name, report in self.formats.items()
        }


def export_stage(state: RunState, context: StageContext) -> ExportStageReport:
    """Replaces `exports/` as a whole, so that files of formats no longer wanted do not stay."""
    config, asset, plugins = state.config, state.asset, state.plugins
    assert asset is not None
    formats = [name for name in config.export if asset.environment is not None or not _is_light(name, state)]
    if len(formats) < len(config.export):
        context.warn("the asset has no light, so no light is exported; let the reflectance stage run to get one")
    verified = {}
    health = asset_health(asset).as_document()
    with atomic_directory(state.directory.exports) as folder:
        reports = export_asset(asset, formats, folder, plugins, config.exporter) if formats else {}
        rerender, engines = _rerender(state), EngineComparison(asset)
        for name, report in reports.items():
            options, hooks = config.exporter.get(name), editors_of(name, plugins)
            verified[name] = verify_export(report, asset, options, rerender, "no light", engines, hooks)
    for name, report in reports.items():
        for warning in (*report.warnings, *verified[name].warnings):
            context.warn(f"{name}: {warning}")
    return ExportStageReport(
        {
            name: FormatReport(
                tuple(file.name for file in report.files),
                dict(report.residuals),
                {**verified[name].report, "health": health},
            )
            for name, report in reports.items()
        }
    )


def _is_light(name: str, state: RunState) -> bool:
    return "environment" in state.plugins.find("exporter", name).component.traits


def _rerender(state: RunState) -> Rerender | None:
    """Small pictures with few paths: they show what an export costs, in seconds."""
    cameras = read_cameras(state.directory.cameras)
    if state.asset is None or state.asset.environment is None or not cameras or state.frames is None:
        return None
    frame, bounces = state.frames.working_from_asset, state.bounces
    return Rerender(state.asset, cameras, frame, state.plugins, bounces=bounces, device=state.device)
