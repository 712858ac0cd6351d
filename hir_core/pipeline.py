"""A run, from a folder of photographs to an asset and its files: a loop over the stages."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hir_core.capture.capture_size import size_of
from hir_core.capture.photograph_exposures import check_recorded_exposures, with_recorded_exposures
from hir_core.capture.pixel_cache import PixelCache
from hir_core.config import RunConfig, load_config
from hir_core.errors import CaptureError
from hir_core.intake.reader_lookup import find_reader, read_capture
from hir_core.plugins.manager import PluginManager
from hir_core.run.capture_store import fingerprint
from hir_core.run.determinism import determinism
from hir_core.run.device import resolve_device
from hir_core.run.machine import processor_seconds
from hir_core.run.python_warnings import forward_user_warnings
from hir_core.run.run_directory import LAST_STAGE, STAGE_NAMES, RunDirectory, check_stage_name, claimed_run
from hir_core.run.run_log import write_log
from hir_core.run.run_records import RunRecords
from hir_core.run.stage_context import StageContext
from hir_core.run.stage_runner import StageRunner
from hir_core.stages.initialization import resolve_initializers
from hir_core.stages.memory_plan import MemoryPlan, gigabytes, plan_memory
from hir_core.stages.reflectance.take_support import check_takes
from hir_core.stages.run_state import CaptureSource, RunState
from hir_core.stages.settings_without_effect import (
    check_settings_take_effect,
    options_outside_the_chain,
    settings_of_disabled_stages,
)
from hir_core.stages.stage_list import STAGES

if TYPE_CHECKING:
    from hir_exporters.asset import Asset

    from hir_core.plugins.progress import Progress


@dataclass(frozen=True)
class Run:
    """What `reconstruct` returns."""

    directory: RunDirectory
    reused: tuple[str, ...]
    """Stages whose result was read from an earlier run."""

    @property
    def path(self) -> Path:
        """The run's folder."""
        return self.directory.path

    @property
    def asset(self) -> Asset:
        """The finished asset; an error where the run stopped before `bake`."""
        from hir_exporters.scene_format import load_scene

        return load_scene(self.directory.scene)


def reconstruct(
    capture: str | Path,
    run: str | Path,
    *,
    preset: str = "",
    config: RunConfig | str | Path | None = None,
    assignments: Sequence[str] = (),
    device: str | None = None,
    resume: bool = False,
    until: str | None = None,
    plugins: PluginManager | None = None,
    on_progress: Callable[[Progress], None] | None = None,
    on_message: Callable[[str], None] | None = None,
    **overrides: Any,
) -> Run:
    """Turns the photographs of `capture` into an asset in the folder `run`.

    `config` is a TOML file or a finished `RunConfig`; `assignments` are `key=value` as after `--set`; further keyword
    arguments are top-level settings. `until` names the last stage. `on_message` gets one sentence at a time. Raises
    `HirError` with one sentence.
    """
    last_stage = LAST_STAGE if until is None else check_stage_name(until)
    plugins = plugins or PluginManager.discover()
    if not isinstance(config, RunConfig):
        file = None if config is None else Path(config)
        config = load_config(plugins, preset, file, assignments, device=device, **overrides)
    check_settings_take_effect(config, plugins)
    resolved_device = resolve_device(config.device)
    find_reader(Path(capture), plugins, config.reader)  # before a folder is made for a capture that nobody can read
    for name in config.export if last_stage == LAST_STAGE else ():
        plugins.require_installed("exporter", name)  # before hours of work
    with claimed_run(run, resume) as directory, determinism(config.deterministic):

        def say(sentence: str) -> None:
            write_log(directory.log, sentence)
            if on_message is not None:
                on_message(sentence)

        for setting in settings_of_disabled_stages(config, plugins):
            say(f"warning: {setting} has no effect: its stage is switched off; remove one of the two settings")
        state, memory = prepare(Path(capture), config, plugins, directory, resolved_device, say)
        records = RunRecords(directory, plugins, say)
        records.start(_capture_document(state), asdict(state.config), memory.document(), resolved_device)
        plugins.notify("hir_run_started", config=state.config, run_folder=directory.path)
        runner = StageRunner(
            plugins=plugins,
            directory=directory,
            records=records,
            context=_stage_context(state),
            expected_memory=memory.sentences(),
            on_progress=on_progress,
            on_message=say,
            key=state.source.fingerprint,
        )
        run_stages(state, runner, last_stage)
        records.finish()
        if directory.has_finished_scene:
            started, processor_started = time.perf_counter(), processor_seconds()
            if _write_report(directory, plugins, state.config.report_side, runner.reused, on_message):
                seconds = time.perf_counter() - started
                records.add_report(seconds, processor_seconds() - processor_started)
                say(f"report: {seconds:.1f} s")
            records.add_problems()
    return Run(directory, tuple(runner.reused))


def run_stages(state: RunState, runner: StageRunner, last_stage: str = LAST_STAGE) -> RunState:
    """Runs the stages up to `last_stage`; each gets the values of those before it."""
    for stage in STAGES:
        state = runner.run(stage, state)
        if stage.name == last_stage:
            break
    return state


def prepare(
    path: Path,
    config: RunConfig,
    plugins: PluginManager,
    directory: RunDirectory,
    device: str,
    on_message: Callable[[str], None],
) -> tuple[RunState, MemoryPlan]:
    """Reads the train split and makes the settings final: the memory plan is applied, the initializers are chosen.

    Photographs are decoded when a stage asks for them, and at most once.
    """
    with forward_user_warnings(lambda sentence: on_message(f"warning: {sentence}")):
        capture = read_capture(path, "train", plugins, config.reader)
    if not capture.views:
        raise CaptureError(f"{path} holds no photographs to fit; is it the folder of a capture?")
    if config.reflectance.enabled and config.reflectance.exposures == "recorded":
        check_recorded_exposures(with_recorded_exposures(capture))  # before the minutes of the first stages
    if config.reflectance.enabled and config.reflectance.renderer:
        renderer = plugins.find("reflectance_renderer", config.reflectance.renderer)
        check_takes(capture, config.reflectance, renderer.component.traits)
    memory = plan_memory(config, plugins, size_of(capture))
    for change in memory.changes:
        on_message(f"to stay within {gigabytes(memory.limit)} of memory: {change}")
    source = CaptureSource(
        path.resolve(), path.resolve().name, fingerprint(capture), tuple(view.name for view in capture.views)
    )
    photographs = PixelCache(memory.cache_bytes)
    capture = photographs.wrap(capture)
    chain = resolve_initializers(capture, memory.config, plugins)
    if config.initializers == "auto":
        for sentence in options_outside_the_chain(config, plugins, chain):
            on_message(f"warning: {sentence}")
    final = replace(memory.config, initializers=chain)
    return RunState(final, plugins, directory, device, source, photographs, capture), memory


def _stage_context(state: RunState) -> StageContext:
    """What all stages are given."""
    config = state.config
    return StageContext(
        plugins=state.plugins,
        workspace=state.directory.path,
        options={
            "geometry_renderer": config.geometry_renderer,
            "reflectance_renderer": config.reflectance_renderer,
        },
        device=state.device,
        seed=config.seed,
        deterministic=config.deterministic,
        checkpoint_seconds=config.checkpoint_seconds,
    )


def _capture_document(state: RunState) -> dict[str, Any]:
    """What run.json says of the input."""
    return {
        "path": str(state.source.path),
        "name": state.source.name,
        "reader": state.capture.reader,
        "split": state.capture.split,
        "views": len(state.capture.views),
        "fingerprint": state.source.fingerprint,
    }


def _write_report(
    directory: RunDirectory,
    plugins: PluginManager,
    side: int,
    reused: Sequence[str],
    on_message: Callable[[str], None] | None,
) -> bool:
    """Writes the report; its pictures are rendered again only where a stage before the export was computed. Whether
    they were."""
    from hir_core.report import pictures_damage, refresh_page, write_report

    if set(reused) >= set(STAGE_NAMES[:-1]):
        damage = pictures_damage(directory, side)
        if damage is None:
            refresh_page(directory, plugins)
            return False
        if directory.report.exists() and on_message is not None:
            on_message(f"report: its pictures are rendered again ({damage})")
    write_report(directory, plugins, on_message=on_message)
    return True
