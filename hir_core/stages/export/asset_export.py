"""Writes an asset in several formats. Imports no torch, so `hir export` starts fast."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_exporters.exporter import Edit, Exporter, ExportReport

from hir_core.errors import ConfigError
from hir_core.files.file_names import file_stem

if TYPE_CHECKING:
    from hir_exporters.asset import Asset

    from hir_core.plugins.manager import PluginManager, Registered

EDIT_HOOKS: Mapping[str, tuple[str, str]] = {
    "gltf": ("hir_gltf_document", "document"),
    "usd": ("hir_usd_stage", "stage"),
}
"""Trait of an exporter → the hook that edits its document, and the name of the hook's parameter for the document."""


def export_asset(
    asset: Asset,
    formats: Sequence[str],
    folder: Path,
    plugins: PluginManager,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    on_file: Callable[[str, ExportReport], None] | None = None,
) -> dict[str, ExportReport]:
    """Writes `folder/<name of the asset>.<format>` for each format.

    All formats and options are checked before the first file is written. `options` are those of each format; `on_file`
    is called after each format. `ConfigError` where no format is named.
    """
    exporters: dict[str, tuple[Registered, Exporter]] = {}
    for name in formats:
        exporter: Exporter = plugins.create("exporter", name, (options or {}).get(name))
        exporters[name] = (plugins.find("exporter", name), exporter)
    if not exporters:
        known = ", ".join(r.component.name for r in plugins.components("exporter"))
        raise ConfigError(f"no format is chosen; choose one or more with -f: {known}")
    reports = {}
    for name, (registered, exporter) in exporters.items():
        report = exporter.write(asset, folder / f"{file_stem(asset.name)}.{name}", _edit(registered, plugins))
        reports[name] = report
        if on_file is not None:
            on_file(name, report)
    return reports


def _edit(registered: Registered, plugins: PluginManager) -> Edit | None:
    for trait, (hook, argument) in EDIT_HOOKS.items():
        if trait in registered.component.traits:
            return lambda document, asset: plugins.edit(hook, document, asset, argument)
    return None
