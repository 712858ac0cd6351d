"""Contracts of a plugin as a whole: that it loads, what it names, its presets, observers and commands."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from hir_core.errors import HirError
from hir_core.plugins import hookspecs
from hir_core.plugins.manager import Fault, LoadedPlugin
from hir_core.plugins.progress import Progress
from hir_core.testing.checks.every_kind import (
    require_documented_options,
    require_light_import,
    require_quick_import,
    require_sound_options,
)
from hir_core.testing.contract import PLUGIN, NotApplicable, PluginSubject, contract, require
from hir_core.testing.exercise import digest

STAGES: Final = ("initializer", "geometry", "atlas", "reflectance", "bake", "export")
REGISTERING: Final = "hir_register_"
HOOKS: Final = tuple(name for name in vars(hookspecs) if name.startswith("hir_"))
TUTORIALS: Final = "docs/writing_plugins/index.md"
MISSING_PATH: Final = "no_such_folder"
OBSERVING: Final = ("hir_run_started", "hir_progress", "hir_stage_finished")


def _require_no_problem(subject: PluginSubject, fault: Fault) -> None:
    found = [p.sentence for loaded in subject.loaded for p in loaded.problems if p.fault == fault]
    require(not found, "; ".join(found))


@contract(PLUGIN, first=True)
def is_loaded(subject: PluginSubject) -> None:
    """Its module can be imported; each of its hooks is one that `hir` calls; hooks that register return descriptors
    and raise nothing.
    """
    _require_no_problem(subject, "is_loaded")


@contract(PLUGIN)
def is_made_for_this_interface(subject: PluginSubject) -> None:
    """`Component.api`, and `hir_api` of a module that has one, are the interface version of this `hir`."""
    _require_no_problem(subject, "is_made_for_this_interface")


@contract(PLUGIN)
def names_are_free(subject: PluginSubject) -> None:
    """No component of its kind, preset, observer or command of that name exists: the name of the plugin loaded first
    is kept, and the commands of `hir` cannot be replaced.
    """
    _require_no_problem(subject, "names_are_free")


@contract(PLUGIN)
def registers_something(subject: PluginSubject) -> None:
    """Each entry point, file or module of it has a hook of `hir`, and each function with the name of a hook is marked
    by `@hookimpl`; one whose hooks only register registers at least one component, observer, preset or command.
    """
    judged = [loaded for loaded in subject.loaded if not loaded.problems]
    if not judged:
        raise NotApplicable("it has a problem that another contract names")
    for loaded in judged:
        named = sorted(name for name in dir(loaded.plugin) if name in HOOKS)
        unmarked = [name for name in named if not subject.plugins.implements(loaded, name)]
        which = ", ".join(unmarked)
        require(not unmarked, f"{loaded.module}: hir does not call {which}; write @hookimpl above it ({TUTORIALS})")
        require(
            named,
            f"{loaded.module} registers nothing; write @hookimpl above a function whose name begins with {REGISTERING} "
            f"({TUTORIALS})",
        )
        own = [r for r in subject.components if r.module == loaded.module]
        acts = subject.plugins.implements(loaded, *(hook for hook in HOOKS if not hook.startswith(REGISTERING)))
        require(
            own or loaded.observers or loaded.presets or loaded.commands or acts,
            f"{loaded.module} registers nothing: {', '.join(named)} must return, or add, at least one ({TUTORIALS})",
        )


@contract(PLUGIN)
def plugin_imports_light(subject: PluginSubject) -> None:
    """The module of a plugin without components, such as an observer's, loads nothing heavy: all `hir` commands import
    it.
    """
    for module in _modules_without_components(subject):
        require_light_import(module)


@contract(PLUGIN)
def plugin_imports_quickly(subject: PluginSubject) -> None:
    """The module of a plugin without components is imported in a quarter of a second, or in twice what the interface
    of `hir` itself takes where that is more: every `hir` command waits for it.
    """
    for module in _modules_without_components(subject):
        require_quick_import(module)


def _modules_without_components(subject: PluginSubject) -> list[str]:
    own = {registered.module for registered in subject.components}
    modules = [module for module in subject.modules if module not in own]
    if not modules:
        raise NotApplicable("its components are tested for it")
    return modules


@contract(PLUGIN)
def presets_are_settings(subject: PluginSubject) -> None:
    """Each preset that it ships is a TOML file of settings that `hir` accepts, with names of components and options
    that exist; none declares itself the default.
    """
    from hir_core.config import DEFAULT_PRESET, load_config, read_toml

    presets = {name: path for loaded in subject.loaded for name, path in loaded.presets.items()}
    if not presets:
        raise NotApplicable("it ships no preset")
    for name, path in presets.items():
        try:
            table = read_toml(path)
            load_config(subject.plugins, preset=name)
        except HirError as error:
            require(False, f"preset {name!r}: {error}")
        require(
            table.get(DEFAULT_PRESET) is not True or "hir" in {loaded.distribution for loaded in subject.loaded},
            f"preset {name!r} sets {DEFAULT_PRESET} = true, so that no run without --preset can begin; remove the line",
        )


@contract(PLUGIN)
def observer_options_are_sound(subject: PluginSubject) -> None:
    """The options of each observer are a frozen dataclass; each has a default that can be written as JSON and as TOML,
    and a docstring.
    """
    observers = {name: options for loaded in subject.loaded for name, options in loaded.observers.items()}
    if not observers:
        raise NotApplicable("it registers no observer")
    for name, options in observers.items():
        require_sound_options(options, f"observer {name!r}")
        require_documented_options(options)


@contract(PLUGIN)
def observer_raises_nothing(subject: PluginSubject) -> None:
    """Its observers go through a run without an exception, switched on with their default options and switched off:
    stages without and with a scene, progress with and without scalars.
    """
    try:
        for switched_on in (False, True):
            for _ in _observed(subject, switched_on):
                pass
    except ObserverRaisedError as error:
        require(False, str(error))


@contract(PLUGIN)
def observer_is_off_without_its_table(subject: PluginSubject) -> None:
    """An observer that has a table `observers.<name>` writes nothing in a run whose settings have none."""
    observing = [loaded for loaded in _observing(subject) if loaded.observers]
    if not observing:
        raise NotApplicable("it registers no observer that could be switched off")
    for observed in _undisturbed(subject, switched_on=False):
        if not observed.loaded.observers:
            continue
        there = sorted(p.relative_to(observed.run).as_posix() for p in observed.run.rglob("*"))
        require(
            not there,
            f"without a table [observers.{next(iter(observed.loaded.observers))}] in the settings it writes "
            f"{', '.join(there)}; look into config.observers first",
        )


@contract(PLUGIN)
def observer_stays_in_its_run(subject: PluginSubject) -> None:
    """An observer writes below the folder of the run, and changes nothing that it is given: settings, scene, scalars,
    report.
    """
    for observed in _undisturbed(subject, switched_on=True):
        require(not observed.changed, f"it changed what it was given: {', '.join(observed.changed)}; copy, then change")
        beside = sorted(p.name for p in observed.run.parent.iterdir() if p != observed.run)
        require(not beside, f"it writes {', '.join(beside)} beside the run's folder; write below `run_folder`")


class ObserverRaisedError(Exception):
    """A hook of an observer raised; the message says which, where and what."""


@dataclass(frozen=True)
class Observed:
    """What a run left after an observer went through it."""

    loaded: LoadedPlugin
    run: Path
    changed: tuple[str, ...]


def _observing(subject: PluginSubject) -> list[LoadedPlugin]:
    found = [loaded for loaded in subject.loaded if subject.plugins.implements(loaded, *OBSERVING)]
    if not found:
        raise NotApplicable(f"it has none of the hooks {', '.join(OBSERVING)}")
    return found


def _observed(subject: PluginSubject, switched_on: bool) -> Iterator[Observed]:
    """Each observing plugin after a made-up run of six stages; an exception of a hook is a broken contract."""
    from hir_core.config import RunConfig

    for loaded in _observing(subject):
        run = subject.folder() / "run"
        run.mkdir()
        config = RunConfig(observers={name: {} for name in loaded.observers} if switched_on else {})
        calls: list[tuple[str, dict[str, Any]]] = [("hir_run_started", {"config": config, "run_folder": run})]
        for stage in STAGES:
            scalars = {"loss": np.array([2.0, 1.5]), "seconds of a step": np.array([0.1, 0.1])}
            calls += [
                ("hir_progress", {"progress": Progress(stage, 2, 4, 0.2, scalars)}),
                ("hir_progress", {"progress": Progress(stage, 4, 4, 0.4, message="done", milestone="model_fitted")}),
                (
                    "hir_stage_finished",
                    {
                        "stage": stage,
                        "scene": _scene(stage),
                        "report": {"iou": 0.9, "views": [1, 2], "name": "a", "x": None},
                    },
                ),
            ]
        changed = []
        for hook, arguments in calls:
            before = {name: digest(value) for name, value in arguments.items() if name != "run_folder"}
            try:
                subject.plugins.call(loaded, hook, **arguments)
            except Exception as error:
                of = f" of the stage {arguments['stage']}" if "stage" in arguments else ""
                how = "switched on with its default options" if switched_on else "switched off"
                raise ObserverRaisedError(
                    f"{hook}{of} raises {type(error).__name__}: {error} ({how}); catch what can go wrong, such as a "
                    "full disk, and leave out what a stage does not have: `scene` may be None, `report` may lack a key"
                ) from error
            changed += [f"{name} of {hook}" for name, hashed in before.items() if digest(arguments[name]) != hashed]
        yield Observed(loaded, run, tuple(dict.fromkeys(changed)))


def _undisturbed(subject: PluginSubject, switched_on: bool) -> list[Observed]:
    try:
        return list(_observed(subject, switched_on))
    except ObserverRaisedError:
        raise NotApplicable("it raises, which the contract 'observer_raises_nothing' names") from None


def _scene(stage: str) -> Any:
    """The scene after a stage: none before there is a mesh, a mesh alone, then all. None where torch is missing."""
    try:
        from hir_core.scene import Scene
        from hir_core.testing.scenes import bumpy_scene, sphere
    except ImportError:
        return None
    if stage in ("initializer", "export"):
        return None
    return Scene(sphere()) if stage in ("geometry", "atlas") else bumpy_scene()


@contract(PLUGIN)
def commands_have_help(subject: PluginSubject) -> None:
    """Each command it adds prints its help with `--help`, and says in a line what it does."""
    import click
    from click.testing import CliRunner

    commands = {name: command for loaded in subject.loaded for name, command in loaded.commands.items()}
    if not commands:
        raise NotApplicable("it adds no command")
    for name, command in commands.items():
        require(isinstance(command, click.Command), f"`hir {name}` is {command!r}, not a click command")
        require(
            inspect.cleandoc(command.help or ""), f"`hir {name}` has no docstring: `hir --help` shows an empty line"
        )
        done = CliRunner().invoke(command, ["--help"], prog_name=f"hir {name}")
        require(done.exit_code == 0, f"`hir {name} --help` ends with {done.exception!r}")


@contract(PLUGIN)
def commands_refuse_what_is_missing(subject: PluginSubject) -> None:
    """A command that is given the name of a folder that does not exist, for each argument that it needs, ends with a
    sentence and an exit status that is not 0: it raises a `HirError` or an exception of click, and no other.
    """
    import click
    from click.testing import CliRunner

    commands = [
        (name, leaf)
        for loaded in subject.loaded
        for top, command in loaded.commands.items()
        for name, leaf in _leaves(top, command)
        if any(isinstance(p, click.Argument) and p.required for p in leaf.params)
    ]
    if not commands:
        raise NotApplicable("none of its commands needs an argument")
    for name, command in commands:
        arguments = [MISSING_PATH for p in command.params if isinstance(p, click.Argument) and p.required]
        given = [p for p in command.params if isinstance(p, click.Argument) and p.required]
        runner = CliRunner()
        with runner.isolated_filesystem(subject.folder()):
            done = runner.invoke(command, arguments, prog_name=f"hir {name}")
            left = sorted(p.name for p in Path.cwd().iterdir())
        line = f"`hir {name} {' '.join(arguments)}`"
        raised = done.exception
        known = raised is None or isinstance(raised, SystemExit | HirError | click.ClickException)
        require(
            known,
            f"{line} raises {type(raised).__name__}: {raised}; raise a HirError with a sentence, or let click check "
            "the argument: type=click.Path(exists=True)",
        )
        reads_paths = any(isinstance(p.type, click.Path | click.File) for p in given)
        require(
            done.exit_code != 0 or not reads_paths,
            f"{line} ends with exit status 0, though nothing of that name is there; raise a HirError that says so",
        )
        require(done.exit_code == 0 or not left, f"{line} fails and leaves {', '.join(left)}")


def _leaves(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    """A command, or those of a group, with their names."""
    import click

    if isinstance(command, click.Group):
        for below, found in command.commands.items():
            yield from _leaves(f"{name} {below}", found)
    elif isinstance(command, click.Command):
        yield name, command
