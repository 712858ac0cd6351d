"""Discovers plugins, reports broken ones, and looks up components by kind and name."""

from __future__ import annotations

import inspect
import re
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from importlib import import_module
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import pluggy

from hir_core.errors import ConfigError, HirError, MissingExtraError, PluginError
from hir_core.plugins import hookspecs
from hir_core.plugins.component import API_VERSION, Component
from hir_core.plugins.engine_commands import ENGINE_COMMANDS
from hir_core.plugins.loading import GROUP, class_of, entry_points, is_installed, module_from_file
from hir_core.plugins.options import build_options, with_device_of_run, with_seed_of_run
from hir_core.plugins.registration import (
    RegistrationError,
    a_value,
    check_descriptor,
    components_of,
    observer_options,
    preset_path,
    table_of,
)

if TYPE_CHECKING:
    import click

    from hir_core.capture import Capture

KINDS: Mapping[str, str] = {
    "capture_reader": "hir_register_capture_readers",
    "mask_source": "hir_register_mask_sources",
    "initializer": "hir_register_initializers",
    "geometry_renderer": "hir_register_geometry_renderers",
    "reflectance_renderer": "hir_register_reflectance_renderers",
    "regularizer": "hir_register_regularizers",
    "exporter": "hir_register_exporters",
}
"""The kinds of component and the hook that registers each."""


@dataclass(frozen=True)
class Registered:
    """A component and the distribution that provides it."""

    kind: str
    component: Component
    distribution: str
    version: str
    module: str = ""
    """The module that registered it."""

    @property
    def label(self) -> str:
        """`the exporter 'glb' of hir`, for messages."""
        return f"the {self.kind.replace('_', ' ')} {self.component.name!r} of {self.distribution}"

    @property
    def missing(self) -> tuple[str, ...]:
        """Required modules that are not installed."""
        return tuple(name for name in self.component.requires if not is_installed(name))

    @property
    def install_command(self) -> str:
        """The command that installs what is missing."""
        if not self.version:  # a plugin file or module, not an installed distribution
            return f"pip install {' '.join(self.missing)}"
        extra = f"[{self.component.extra}]" if self.component.extra else ""
        return f"pip install '{self.distribution}{extra}'"


Fault = Literal["is_loaded", "is_made_for_this_interface", "names_are_free"]
"""The contract of a plugin that a problem breaks."""


@dataclass(frozen=True)
class PluginProblem:
    """Why a plugin, or one of its parts, is not used."""

    fault: Fault
    sentence: str


@dataclass
class LoadedPlugin:
    """One entry point, file or module that was loaded, or could not be."""

    distribution: str
    version: str
    module: str = ""
    """The module of its hooks; empty where it could not be imported."""
    plugin: object | None = None
    """The object with its hooks; None where it could not be loaded."""
    problems: list[PluginProblem] = field(default_factory=list)
    observers: dict[str, type] = field(default_factory=dict)
    presets: dict[str, Path] = field(default_factory=dict)
    commands: dict[str, click.Command] = field(default_factory=dict)
    """Filled by `PluginManager.commands`."""


class PluginManager:
    """The components and hooks of installed plugins; `discover()` makes one with all of them."""

    def __init__(self) -> None:
        self._pluggy = pluggy.PluginManager(GROUP)
        self._pluggy.add_hookspecs(hookspecs)
        self._registered: dict[tuple[str, str], Registered] = {}
        self._presets: dict[str, tuple[Path, str]] = {}
        self._observers: dict[str, tuple[type, str]] = {}
        self._named: set[str] = set()
        self._commands: dict[str, tuple[click.Command, str]] | None = None
        self.loaded: list[LoadedPlugin] = []
        """Every plugin in the order of loading, those with problems included."""
        self.problems: list[str] = []
        self.notices: list[str] = []
        """Deprecations that plugins should follow; the plugins are loaded."""

    @classmethod
    def discover(cls, plugins: tuple[str, ...] = (), strict: bool = True) -> PluginManager:
        """Loads every entry point of the group `hir`, then the `.py` files or modules in `plugins`.

        A problem of one of `plugins` raises `PluginError`, or goes to `problems` where `strict` is False.
        """
        manager = cls()
        for distribution, version, entry_point in entry_points():
            manager._load(entry_point, distribution, version)
        for name in plugins:
            before = len(manager.problems)
            manager._load_named(name)
            if strict and len(manager.problems) > before:
                raise PluginError("; ".join(manager.problems[before:]))
        return manager

    def register_named(self, name: str) -> None:
        """Registers a `.py` file or a module, once; a broken one raises `PluginError`."""
        before = len(self.problems)
        self._load_named(name)
        if len(self.problems) > before:
            raise PluginError("; ".join(self.problems[before:]))

    def register(self, plugin: object, distribution: str, version: str) -> None:
        """Registers one plugin object; its faults go to `problems` and do not affect other plugins."""
        name = f"{distribution}:{getattr(plugin, '__name__', type(plugin).__name__)}"
        module = getattr(plugin, "__name__", None) or type(plugin).__module__
        loaded = LoadedPlugin(distribution, version, module)
        self.loaded.append(loaded)
        incompatibility = _incompatibility(getattr(plugin, "hir_api", 1))
        if incompatibility:
            self._report(loaded, "is_made_for_this_interface", f"{name}: not loaded: it {incompatibility}")
            return
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                self._pluggy.register(plugin, name=name)
                self._pluggy.check_pending()
        except Exception as error:
            self._pluggy.unregister(name=name)
            self._report(loaded, "is_loaded", f"{name}: not loaded: {_hook_advice(error)}")
            return
        loaded.plugin = plugin
        # hookspecs list deprecated arguments (`warn_on_impl_args`); pluggy warns about plugins that use them
        self.notices += [f"{name}: {warning.message}" for warning in caught]
        for kind, hook in KINDS.items():
            with self._reporting(loaded, name, hook):
                for component in components_of(hook, self._call_registration(loaded, hook)):
                    self._add(kind, component, loaded, name)
        hook = "hir_register_observers"
        with self._reporting(loaded, name, hook):
            for observer, value in table_of(hook, self._call_registration(loaded, hook), '"NAME": Options').items():
                self._add_observer(observer, value, loaded, name)
        hook = "hir_register_presets"
        with self._reporting(loaded, name, hook):
            for preset, value in table_of(hook, self._call_registration(loaded, hook), '"NAME": Path').items():
                self._add_preset(preset, value, loaded, name)

    def with_component(self, registered: Registered) -> PluginManager:
        """A copy in which `registered` replaces the component of its name; hooks are not copied."""
        other = PluginManager()
        other._registered = {**self._registered, (registered.kind, registered.component.name): registered}
        other._presets, other._observers = dict(self._presets), dict(self._observers)
        return other

    def components(self, kind: str | None = None) -> list[Registered]:
        """All components, or those of one kind, sorted by kind and name."""
        chosen = [r for r in self._registered.values() if kind in (None, r.kind)]
        order = list(KINDS)
        return sorted(chosen, key=lambda r: (order.index(r.kind), r.component.name))

    def find(self, kind: str, name: str) -> Registered:
        """Looks up one component; `PluginError` lists the known names."""
        try:
            return self._registered[kind, name]
        except KeyError:
            known = ", ".join(r.component.name for r in self.components(kind)) or "none"
            raise PluginError(f"there is no {kind.replace('_', ' ')} named {name!r}; installed: {known}") from None

    def create(
        self, kind: str, name: str, options: Mapping[str, Any] | None = None, seed: int = 0, device: str = ""
    ) -> Any:
        """Builds a component; `ConfigError` for unknown options, `MissingExtraError` for missing packages.

        `seed` and `device` are the run's: the defaults of options that are declared with `seed_of_run` and
        `device_of_run`.
        """
        registered = self.find(kind, name)
        kind_of_options = registered.component.config
        values = with_seed_of_run(kind_of_options, options or {}, seed)
        values = with_device_of_run(kind_of_options, values, device)
        config: Any = build_options(kind_of_options, values, f"{kind} {name!r}")
        self.require_installed(kind, name)
        return class_of(registered.component.target, f"{kind.replace('_', ' ')} {name!r} of {registered.distribution}")(
            config
        )

    def require_installed(self, kind: str, name: str) -> None:
        """Raises `MissingExtraError`, which names the command that installs them, where a component lacks packages."""
        registered = self.find(kind, name)
        if registered.missing:
            raise MissingExtraError(
                f"{kind.replace('_', ' ')} {name!r} (from {registered.distribution}) needs "
                f"{', '.join(registered.missing)}; install it with: {registered.install_command}"
            )

    def presets(self) -> dict[str, Path]:
        """Preset names and their TOML files."""
        return {name: path for name, (path, _) in sorted(self._presets.items())}

    def preset(self, name: str) -> Path:
        """The TOML file of a preset."""
        if name not in self._presets:
            raise ConfigError(f"there is no preset {name!r}; installed: {', '.join(self.presets()) or 'none'}")
        return self._presets[name][0]

    def commands(self) -> dict[str, click.Command]:
        """Names and commands that plugins add; a name of the engine or of an earlier plugin is a problem and ignored.

        The commands of each plugin are collected once, in a group of their own.
        """
        import click

        if self._commands is None:
            self._commands = {}
            hooks = {id(h.plugin): h for h in self._pluggy.hook.hir_register_commands.get_hookimpls()}
            for loaded in self.loaded:
                hook = hooks.get(id(loaded.plugin))
                if hook is None:
                    continue
                group = click.Group()
                try:
                    _call(hook, {"cli": group})
                except (Exception, SystemExit) as error:
                    sentence = f"{hook.plugin_name}: hir_register_commands raised {type(error).__name__}: {error}"
                    self._report(loaded, "is_loaded", sentence)
                for name, command in group.commands.items():
                    owner = "hir" if name in ENGINE_COMMANDS else self._commands.get(name, (None, ""))[1]
                    if owner:
                        self._conflict(loaded, "command", name, owner)
                    else:
                        self._commands[name] = (command, loaded.distribution)
                        loaded.commands[name] = command
        return {name: command for name, (command, _) in self._commands.items()}

    def observers(self) -> dict[str, type]:
        """Observer names and the dataclasses of their options."""
        return {name: options for name, (options, _) in sorted(self._observers.items())}

    def call(self, loaded: LoadedPlugin, hook: str, **arguments: Any) -> Any:
        """What one plugin's implementation of a hook returns; None where it has none. Its exceptions pass through."""
        for implementation in getattr(self._pluggy.hook, hook).get_hookimpls():
            if implementation.plugin is loaded.plugin:
                return _call(implementation, arguments)
        return None

    def implements(self, loaded: LoadedPlugin, *hooks: str) -> bool:
        """Whether a plugin implements one of these hooks."""
        return any(
            implementation.plugin is loaded.plugin
            for hook in hooks
            for implementation in getattr(self._pluggy.hook, hook).get_hookimpls()
        )

    def names_with(self, hook: str) -> list[str]:
        """The names of the plugins that implement a hook."""
        return [i.plugin_name for i in getattr(self._pluggy.hook, hook).get_hookimpls()]

    def notify(self, hook: str, **arguments: Any) -> None:
        """Calls an observer hook of every plugin; an exception is recorded once and does not stop the run."""
        for implementation in list(getattr(self._pluggy.hook, hook).get_hookimpls()):
            try:
                _call(implementation, arguments)
            except Exception as error:
                self._report_once(f"{implementation.plugin_name}: {hook} raised {type(error).__name__}: {error}")

    def suggest_initializers(self, capture: Capture) -> list[str]:
        """The first suggestion of a plugin for a capture; empty if there is none.

        A hook that raises, returns no list of text or names no installed initializer raises `PluginError`: another
        chain than that of the plugin would be another result.
        """
        hook = "hir_suggest_initializers"
        for implementation in reversed(self._pluggy.hook.hir_suggest_initializers.get_hookimpls()):
            who = implementation.plugin_name
            remedy = "mend the plugin, or set `initializers`"
            try:
                suggestion = _call(implementation, {"capture": capture})
            except HirError:
                raise
            except Exception as error:
                raise PluginError(f"{who}: {hook} raised {type(error).__name__}: {error}; {remedy}") from error
            if suggestion is None:
                continue
            if not isinstance(suggestion, list | tuple) or not all(isinstance(name, str) for name in suggestion):
                raise PluginError(f"{who}: {hook} returned {suggestion!r}; return a list of names of initializers")
            known = [registered.component.name for registered in self.components("initializer")]
            unknown = [name for name in suggestion if ("initializer", name) not in self._registered]
            if unknown:
                raise PluginError(
                    f"{who}: {hook} returned {unknown[0]!r}, which is no initializer; installed: {', '.join(known)}"
                )
            return list(suggestion)
        return []

    def asset_page(self, run_folder: Path) -> str | None:
        """The first viewer page that a plugin offers for a finished asset, or None.

        A hook that raises or returns no text is recorded once in `problems`, and the next plugin is asked.
        """
        for implementation in reversed(self._pluggy.hook.hir_asset_page.get_hookimpls()):
            who = f"{implementation.plugin_name}: hir_asset_page"
            try:
                page = _call(implementation, {"run_folder": run_folder})
            except Exception as error:
                self._report_once(f"{who} raised {type(error).__name__}: {error}")
                continue
            if isinstance(page, str):
                return page
            if page is not None:
                self._report_once(f"{who} returned {a_value(page)}; return a page of HTML as text, or None")
        return None

    def edit(self, hook: str, document: Any, asset: Any, argument: str) -> list[str]:
        """Lets plugins edit a finished document in place; the names of their hooks. A failure raises, because the
        document may be half edited.
        """
        edited: list[str] = []
        for implementation in getattr(self._pluggy.hook, hook).get_hookimpls():
            try:
                _call(implementation, {argument: document, "asset": asset})
            except Exception as error:
                who = implementation.plugin_name
                raise PluginError(f"{who}: {hook} raised {type(error).__name__}: {error}") from error
            edited.append(f"{hook} of {implementation.plugin_name}")
        return edited

    def _load(self, entry_point: EntryPoint, distribution: str, version: str) -> None:
        try:
            plugin = entry_point.load()
            if inspect.isclass(plugin):  # an observer with state: one instance for each manager
                plugin = plugin()
        except (Exception, SystemExit) as error:
            self.loaded.append(LoadedPlugin(distribution, version))
            self._report(
                self.loaded[-1],
                "is_loaded",
                f"{distribution}: entry point {entry_point.name!r} cannot be imported "
                f"({type(error).__name__}: {error}); reinstall or remove {distribution}",
            )
            return
        self.register(plugin, distribution, version)

    def _load_named(self, name: str) -> None:
        if name in self._named:
            return
        try:
            module = module_from_file(Path(name)) if name.endswith(".py") else import_module(name)
        except (Exception, SystemExit) as error:
            self.loaded.append(LoadedPlugin(name, ""))
            sentence = f"plugin {name!r} cannot be imported ({type(error).__name__}: {error})"
            self._report(self.loaded[-1], "is_loaded", sentence)
            return
        self.register(module, distribution=name, version="")
        if not self.loaded[-1].problems:
            self._named.add(name)

    def _report(self, loaded: LoadedPlugin, fault: Fault, sentence: str) -> None:
        loaded.problems.append(PluginProblem(fault, sentence))
        self.problems.append(sentence)

    def _report_once(self, sentence: str) -> None:
        if sentence not in self.problems:
            self.problems.append(sentence)

    def _conflict(self, loaded: LoadedPlugin, what: str, name: str, owner: str) -> None:
        sentence = f"{what} {name!r} of {loaded.distribution} is ignored: {owner} has one of that name; "
        sentence += "rename one of the two, or remove it"
        self._report(loaded, "names_are_free", sentence)

    def _call_registration(self, loaded: LoadedPlugin, hook: str) -> Any:
        function = getattr(loaded.plugin, hook, None)
        if function is None or self._pluggy.parse_hookimpl_opts(loaded.plugin, hook) is None:
            return None
        return function()

    @contextmanager
    def _reporting(self, loaded: LoadedPlugin, name: str, hook: str) -> Iterator[None]:
        """Reports what the body raises as a problem of the plugin, and goes on after the body."""
        try:
            yield
        except RegistrationError as error:
            self._report(loaded, "is_loaded", f"{name}: {error}")
        except (Exception, SystemExit) as error:
            self._report(loaded, "is_loaded", f"{name}: {hook} raised {type(error).__name__}: {error}")

    def _add_observer(self, observer: str, value: object, loaded: LoadedPlugin, name: str) -> None:
        with self._reporting(loaded, name, "hir_register_observers"):
            options = observer_options(observer, value)
            if observer in self._observers:
                self._conflict(loaded, "observer", observer, self._observers[observer][1])
                return
            self._observers[observer] = (options, loaded.distribution)
            loaded.observers[observer] = options

    def _add_preset(self, preset: str, value: object, loaded: LoadedPlugin, name: str) -> None:
        with self._reporting(loaded, name, "hir_register_presets"):
            path = preset_path(preset, value)
            if preset in self._presets:
                self._conflict(loaded, "preset", preset, self._presets[preset][1])
                return
            self._presets[preset] = (path, loaded.distribution)
            loaded.presets[preset] = path

    def _add(self, kind: str, component: Any, loaded: LoadedPlugin, name: str) -> None:
        if not isinstance(component, Component):
            self._report(loaded, "is_loaded", f"{name}: registers {component!r} as a {kind}; a Component is needed")
            return
        distribution = loaded.distribution
        incompatibility = _incompatibility(component.api)
        if incompatibility:
            sentence = f"{kind} {component.name!r} of {distribution} {incompatibility}"
            self._report(loaded, "is_made_for_this_interface", sentence)
            return
        try:
            check_descriptor(component)
        except RegistrationError as error:
            who = f"{kind.replace('_', ' ')} {component.name!r}"
            self._report(loaded, "is_loaded", f"{name}: the {who} is not registered: {error}")
            return
        other = self._registered.get((kind, component.name))
        if other is not None:
            self._conflict(loaded, kind.replace("_", " "), component.name, other.distribution)
            return
        self._registered[kind, component.name] = Registered(
            kind, component, distribution, loaded.version, loaded.module
        )


def _incompatibility(api: object) -> str:
    """Why a plugin for another interface version is not loaded; empty for ours."""
    if api == API_VERSION:
        return ""
    if not isinstance(api, int):
        return f"says api={api!r}, which is no version of the plugin interface; write api={API_VERSION}"
    made = f"is made for plugin interface {api}, this hir has {API_VERSION}"
    if api > API_VERSION:
        return f"{made}; upgrade hir, or install an older version of the plugin"
    return f"{made}; upgrade the plugin, or install an older hir"


def _hook_advice(error: Exception) -> str:
    """What pluggy says about a plugin's hooks, with the hooks that are like an unknown one."""
    said = " ".join(str(error).split())
    unknown = re.search(r"unknown hook '(\w+)'", said)
    if unknown is None:
        return said
    near = get_close_matches(unknown[1], [name for name in vars(hookspecs) if name.startswith("hir_")], 1)
    return f"{said}; did you mean {near[0]!r}?" if near else said


def _call(implementation: Any, arguments: Mapping[str, Any]) -> Any:
    return implementation.function(*[arguments[name] for name in implementation.argnames])
