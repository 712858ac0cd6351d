"""Discovers plugins, reports broken ones, and looks up components by kind and name."""

from __future__ import annotations

import importlib.util
import inspect
import sys
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import EntryPoint, distributions
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pluggy

from hir_core.errors import ConfigError, MissingExtraError, PluginError
from hir_core.plugins import hookspecs
from hir_core.plugins.component import API_VERSION, Component
from hir_core.plugins.options import build_options, with_seed_of_run

if TYPE_CHECKING:
    from hir_core.capture import Capture

GROUP = "hir"

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
    def missing(self) -> tuple[str, ...]:
        """Required modules that are not installed."""
        return tuple(name for name in self.component.requires if not _is_installed(name))

    @property
    def install_command(self) -> str:
        """The command that installs what is missing."""
        if not self.version:  # a plugin file or module, not an installed distribution
            return f"pip install {' '.join(self.missing)}"
        extra = f"[{self.component.extra}]" if self.component.extra else ""
        return f"pip install '{self.distribution}{extra}'"


class PluginManager:
    """The components and hooks of installed plugins; `discover()` makes one with all of them."""

    def __init__(self) -> None:
        self._pluggy = pluggy.PluginManager(GROUP)
        self._pluggy.add_hookspecs(hookspecs)
        self._registered: dict[tuple[str, str], Registered] = {}
        self._presets: dict[str, tuple[Path, str]] = {}
        self._observers: dict[str, tuple[type, str]] = {}
        self._named: set[str] = set()
        self.problems: list[str] = []
        self.notices: list[str] = []
        """Deprecations that plugins should follow; the plugins are loaded."""

    @classmethod
    def discover(cls, plugins: tuple[str, ...] = ()) -> PluginManager:
        """Loads every entry point of the group `hir`, then the `.py` files or modules in `plugins`."""
        manager = cls()
        for distribution, version, entry_point in _entry_points():
            manager._load(entry_point, distribution, version)
        for name in plugins:
            manager.register_named(name)
        return manager

    def register_named(self, name: str) -> None:
        """Registers a `.py` file or a module, once; a broken one raises `PluginError`."""
        if name in self._named:
            return
        try:
            module = module_from_file(Path(name)) if name.endswith(".py") else import_module(name)
        except Exception as error:
            raise PluginError(f"plugin {name!r} cannot be imported ({type(error).__name__}: {error})") from error
        before = len(self.problems)
        self.register(module, distribution=name, version="")
        if len(self.problems) > before:
            raise PluginError("; ".join(self.problems[before:]))
        self._named.add(name)

    def register(self, plugin: object, distribution: str, version: str) -> None:
        """Registers one plugin object; its faults go to `problems` and do not affect other plugins."""
        name = f"{distribution}:{getattr(plugin, '__name__', type(plugin).__name__)}"
        incompatibility = _incompatibility(getattr(plugin, "hir_api", API_VERSION))
        if incompatibility:
            self.problems.append(f"{name}: not loaded: it {incompatibility}")
            return
        try:
            with warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                self._pluggy.register(plugin, name=name)
                self._pluggy.check_pending()
        except Exception as error:
            self._pluggy.unregister(name=name)
            self.problems.append(f"{name}: not loaded: {' '.join(str(error).split())}")
            return
        # hookspecs list deprecated arguments (`warn_on_impl_args`); pluggy warns about plugins that use them
        self.notices += [f"{name}: {warning.message}" for warning in caught]
        for kind, hook in KINDS.items():
            for component in self._call_registration(plugin, hook, name) or ():
                self._add(kind, component, distribution, version, name, plugin)
        for observer, options in (self._call_registration(plugin, "hir_register_observers", name) or {}).items():
            if observer in self._observers:
                self.problems.append(
                    f"observer {observer!r} of {distribution} is ignored: "
                    f"{self._observers[observer][1]} has one of that name"
                )
            else:
                self._observers[observer] = (options, distribution)
        for preset, path in (self._call_registration(plugin, "hir_register_presets", name) or {}).items():
            if preset in self._presets:
                self.problems.append(
                    f"preset {preset!r} of {distribution} is ignored: {self._presets[preset][1]} has one of that name"
                )
            else:
                self._presets[preset] = (Path(path), distribution)

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

    def create(self, kind: str, name: str, options: Mapping[str, Any] | None = None, seed: int = 0) -> Any:
        """Builds a component; `ConfigError` for unknown options, `MissingExtraError` for missing packages.

        `seed` is the run's: the default of options that are declared with `seed_of_run`.
        """
        registered = self.find(kind, name)
        kind_of_options = registered.component.config
        values = with_seed_of_run(kind_of_options, options or {}, seed)
        config: Any = build_options(kind_of_options, values, f"{kind} {name!r}")
        if registered.missing:
            raise MissingExtraError(
                f"{kind.replace('_', ' ')} {name!r} (from {registered.distribution}) needs "
                f"{', '.join(registered.missing)}; install it with: {registered.install_command}"
            )
        return _resolve(registered)(config)

    def presets(self) -> dict[str, Path]:
        """Preset names and their TOML files."""
        return {name: path for name, (path, _) in sorted(self._presets.items())}

    def preset(self, name: str) -> Path:
        """The TOML file of a preset."""
        if name not in self._presets:
            raise ConfigError(f"there is no preset {name!r}; installed: {', '.join(self.presets()) or 'none'}")
        return self._presets[name][0]

    def observers(self) -> dict[str, type]:
        """Observer names and the dataclasses of their options."""
        return {name: options for name, (options, _) in sorted(self._observers.items())}

    def notify(self, hook: str, **arguments: Any) -> None:
        """Calls an observer hook of every plugin; an exception is recorded once and does not stop the run."""
        for implementation in list(getattr(self._pluggy.hook, hook).get_hookimpls()):
            try:
                _call(implementation, arguments)
            except Exception as error:
                problem = f"{implementation.plugin_name}: {hook} raised {type(error).__name__}: {error}"
                if problem not in self.problems:
                    self.problems.append(problem)

    def suggest_initializers(self, capture: Capture) -> list[str]:
        """The first suggestion of a plugin for a capture; empty if there is none."""
        for implementation in reversed(self._pluggy.hook.hir_suggest_initializers.get_hookimpls()):
            suggestion = _call(implementation, {"capture": capture})
            if suggestion is not None:
                return list(suggestion)
        return []

    def asset_page(self, run_folder: Path) -> str | None:
        """The first viewer page that a plugin offers for a finished asset, or None."""
        for implementation in reversed(self._pluggy.hook.hir_asset_page.get_hookimpls()):
            page: str | None = _call(implementation, {"run_folder": run_folder})
            if page is not None:
                return page
        return None

    def edit(self, hook: str, document: Any, asset: Any, argument: str) -> None:
        """Lets plugins edit a finished document in place; a failure raises, because the document may be half edited."""
        for implementation in getattr(self._pluggy.hook, hook).get_hookimpls():
            try:
                _call(implementation, {argument: document, "asset": asset})
            except Exception as error:
                who = implementation.plugin_name
                raise PluginError(f"{who}: {hook} raised {type(error).__name__}: {error}") from error

    def _load(self, entry_point: EntryPoint, distribution: str, version: str) -> None:
        try:
            plugin = entry_point.load()
            if inspect.isclass(plugin):  # an observer with state: one instance for each manager
                plugin = plugin()
        except Exception as error:
            self.problems.append(
                f"{distribution}: entry point {entry_point.name!r} cannot be imported "
                f"({type(error).__name__}: {error}); reinstall or remove {distribution}"
            )
            return
        self.register(plugin, distribution, version)

    def _call_registration(self, plugin: object, hook: str, name: str) -> Any:
        function = getattr(plugin, hook, None)
        if function is None or self._pluggy.parse_hookimpl_opts(plugin, hook) is None:
            return None
        try:
            return function()
        except Exception as error:
            self.problems.append(f"{name}: {hook} raised {type(error).__name__}: {error}")
            return None

    def _add(self, kind: str, component: Any, distribution: str, version: str, name: str, plugin: object) -> None:
        if not isinstance(component, Component):
            self.problems.append(f"{name}: registers {component!r} as a {kind}; a Component is needed")
            return
        incompatibility = _incompatibility(component.api)
        if incompatibility:
            self.problems.append(f"{kind} {component.name!r} of {distribution} {incompatibility}")
            return
        other = self._registered.get((kind, component.name))
        if other is not None:
            self.problems.append(
                f"{kind} {component.name!r} of {distribution} is ignored: "
                f"{other.distribution} has one of that name; remove one of the two"
            )
            return
        module = getattr(plugin, "__name__", None) or type(plugin).__module__
        self._registered[kind, component.name] = Registered(kind, component, distribution, version, module)


def _incompatibility(api: object) -> str:
    """Why a plugin for another interface version is not loaded; empty for ours."""
    if api == API_VERSION:
        return ""
    made = f"is made for plugin interface {api}, this hir has {API_VERSION}"
    if isinstance(api, int) and api > API_VERSION:
        return f"{made}; upgrade hir, or install an older version of the plugin"
    return f"{made}; upgrade the plugin, or install an older hir"


def _call(implementation: Any, arguments: Mapping[str, Any]) -> Any:
    return implementation.function(*[arguments[name] for name in implementation.argnames])


def _entry_points() -> list[tuple[str, str, EntryPoint]]:
    # not pluggy's loader, which silently skips a second entry point of the same name
    found: dict[tuple[str, str], tuple[str, str, EntryPoint]] = {}
    for distribution in distributions():
        for entry_point in distribution.entry_points.select(group=GROUP):
            key = (distribution.name, entry_point.name)
            found.setdefault(key, (distribution.name, distribution.version, entry_point))
    # ours first, so that a conflict is reported for the other plugin; then by name, independent of the file system
    return [found[key] for key in sorted(found, key=lambda k: (k[0] != "hir", k))]


def module_from_file(path: Path) -> Any:
    """The module in a `.py` file; it can then be imported as `hir_plugin_<stem>`."""
    if not path.is_file():
        raise FileNotFoundError(f"{path} does not exist")
    name = f"hir_plugin_{path.stem}"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


def _resolve(registered: Registered) -> Any:
    module, _, attribute = registered.component.target.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise PluginError(
            f"{registered.kind} {registered.component.name!r} of {registered.distribution} cannot be "
            f"loaded from {registered.component.target!r}: {error}"
        ) from error
    if not inspect.isclass(found):
        raise PluginError(f"{registered.component.target!r} of {registered.distribution} is not a class")
    return found


def _is_installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except (ImportError, ValueError):
        return False
