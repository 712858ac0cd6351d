"""Writes an asset in several formats. Imports no torch, so `hir export` starts fast."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_exporters.errors import ExportError, HirError
from hir_exporters.exporter import Edit, Exporter, ExportReport, shared_names
from hir_exporters.files.atomic import move_atomic, staging_folder

from hir_core.errors import ConfigError, PluginError
from hir_core.files.file_names import file_stem
from hir_core.plugins.registration import a_value

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
    inputs: Sequence[Path] = (),
) -> dict[str, ExportReport]:
    """Writes `folder/<name of the asset>.<format>` for each format.

    All formats and options are checked before the first file is written. `options` are those of each format; `on_file`
    is called after each format. `ConfigError` where no format is named. `ExportError` where two formats write different
    content to one file name; the files of the first one stay. The same where the light or the picture that all formats
    share would be replaced by another one, beside a file of an earlier call that this call does not write, and where
    a file would replace one of `inputs`, from which the asset was made.
    """
    exporters: dict[str, tuple[Registered, Exporter]] = {}
    for name in formats:
        exporter: Exporter = plugins.create("exporter", name, (options or {}).get(name))
        exporters[name] = (plugins.find("exporter", name), exporter)
    if not exporters:
        known = ", ".join(r.component.name for r in plugins.components("exporter"))
        raise ConfigError(f"no format is chosen; choose one or more with -f: {known}")
    names = [r.component.name for r in plugins.components("exporter")]
    earlier = [folder / f"{file_stem(asset.name)}.{name}" for name in names if name not in exporters]
    reports: dict[str, ExportReport] = {}
    with staging_folder(folder) as staging:
        writers: dict[Path, str] = {}
        for name, (registered, exporter) in exporters.items():
            destination = staging / name / f"{file_stem(asset.name)}.{name}"
            try:
                report = _written(registered, exporter, asset, destination, plugins)
                _keep_inputs(destination.parent, folder, inputs)
                reports[name] = _publish(report, name, destination.parent, folder, writers, earlier)
            except HirError as error:
                if str(destination.parent) not in str(error):
                    raise
                raise type(error)(str(error).replace(str(destination.parent), str(folder))) from error
            if on_file is not None:
                on_file(name, reports[name])
    return reports


def _written(
    registered: Registered, exporter: Exporter, asset: Asset, destination: Path, plugins: PluginManager
) -> ExportReport:
    """What `write` returns. `PluginError` where it returns no report, or fails on a document that a plugin changed."""
    edited: list[str] = []
    try:
        report = exporter.write(asset, destination, _edit(registered, plugins, edited))
    except HirError:
        raise
    except Exception as error:
        if not edited:
            raise
        raise PluginError(
            f"{registered.label} raised {type(error).__name__}: {error} after its document was edited by "
            f"{', '.join(edited)}; mend or remove that plugin"
        ) from error
    if not isinstance(report, ExportReport):
        raise PluginError(f"{registered.label} returned {a_value(report)} from write; return an ExportReport")
    return report


def _publish(
    report: ExportReport, name: str, staged: Path, folder: Path, writers: dict[Path, str], earlier: Sequence[Path]
) -> ExportReport:
    """Moves the files of a format from `staged` to `folder`.

    `writers` has the format that wrote each file and is extended. A file that another format wrote with other content
    raises `ExportError`, and nothing is moved. So does a shared file that differs from the one beside a file of
    `earlier`, which this call does not write.
    """
    sources = [file for file in sorted(staged.rglob("*")) if file.is_file()]
    targets = [folder / file.relative_to(staged) for file in sources]
    for source, target in zip(sources, targets, strict=True):
        if target in writers and source.read_bytes() != target.read_bytes():
            raise ExportError(
                f"{target}: the formats {writers[target]} and {name} both write this file, with different content; "
                "export them into separate folders"
            )
        users = [file for file in earlier if file != target and file.is_file()]
        is_shared = target.name in shared_names(report.files[0].stem)
        if users and is_shared and target not in writers and _differs(target, source):
            raise ExportError(
                f"{target} would be replaced by another one, but {users[0].name} of an earlier export is beside it; "
                "name all formats in one call, or another folder"
            )
    for source, target in zip(sources, targets, strict=True):
        target.parent.mkdir(parents=True, exist_ok=True)
        move_atomic(source, target)
        writers[target] = name
    moved = dict(zip(sources, targets, strict=True))
    return replace(report, files=tuple(moved.get(Path(file), Path(file)) for file in report.files))


def _keep_inputs(staged: Path, folder: Path, inputs: Sequence[Path]) -> None:
    """Raises `ExportError` where a file of `staged` would replace one of `inputs` in `folder`."""
    kept = {file.resolve() for file in inputs}
    for file in sorted(staged.rglob("*")):
        target = folder / file.relative_to(staged)
        if file.is_file() and target.resolve() in kept:
            raise ExportError(
                f"{target} is a source of this export and would be replaced; choose another folder with -o"
            )


def _differs(existing: Path, new: Path) -> bool:
    return existing.is_file() and existing.read_bytes() != new.read_bytes()


def editors_of(name: str, plugins: PluginManager) -> list[str]:
    """The hooks that edit documents of a format, each with its plugin."""
    traits = plugins.find("exporter", name).component.traits
    hooks = [hook for trait, (hook, _) in EDIT_HOOKS.items() if trait in traits]
    return [f"{hook} of {plugin}" for hook in hooks for plugin in plugins.names_with(hook)]


def _edit(registered: Registered, plugins: PluginManager, edited: list[str]) -> Edit | None:
    """The hooks that edit the exporter's document; `edited` gets the hook and the plugin of each that did."""
    for trait, (hook, argument) in EDIT_HOOKS.items():
        if trait in registered.component.traits:
            return lambda document, asset: edited.extend(plugins.edit(hook, document, asset, argument))
    return None
