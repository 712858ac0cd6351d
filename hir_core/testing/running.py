"""Selects the checks of a component and runs them, without pytest."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal

from hir_core.errors import PluginError
from hir_core.plugins import Component
from hir_core.plugins.manager import LoadedPlugin, PluginManager, Registered
from hir_core.testing.contract import (
    CHECKS,
    INTERFACES,
    PLUGIN,
    Check,
    ContractError,
    NotApplicable,
    PluginSubject,
    Subject,
)

Outcome = Literal["passed", "failed", "expected", "unexpected_pass", "skipped"]

_MODULES = (
    "every_kind",
    "requirements",
    "probing",
    "regularizer_checks",
    "geometry_renderer_checks",
    "reflectance_renderer_checks",
    "reflectance_light_checks",
    "reflectance_gradient_checks",
    "solver_checks",
    "initializer_checks",
    "capture_reader_checks",
    "mask_source_checks",
    "exporter_checks",
    "plugin_checks",
)


@dataclass(frozen=True)
class Result:
    """The result of one check."""

    component: str
    kind: str
    check: str
    outcome: Outcome
    """`expected`: a failure listed in `expected_failures`. `unexpected_pass`: it is listed there, but passed."""
    detail: str = ""
    """The message of a failure; the reason of a skipped or expected one."""
    seconds: float = 0.0

    @property
    def is_ok(self) -> bool:
        """Whether the component needs no change."""
        return self.outcome not in ("failed", "unexpected_pass")


def all_checks() -> dict[str, Check]:
    """Every check by name, in the order in which they run: a check runs after those that it depends on."""
    order = {import_module(f"hir_core.testing.checks.{name}").__name__: i for i, name in enumerate(_MODULES)}

    def place(item: tuple[str, Check]) -> tuple[bool, int]:
        return not item[1].first, order.get(item[1].function.__module__, len(order))

    return dict(sorted(CHECKS.items(), key=place))


def checks_for(registered: Registered) -> list[Check]:
    """The checks for the kind and traits of a component; imports no heavy package."""
    return [check for check in all_checks().values() if check.applies(registered)]


def plugin_checks() -> list[Check]:
    """The checks of a plugin as a whole."""
    return [check for check in all_checks().values() if PLUGIN in check.kinds]


def check_component(
    component: str | Component | Registered,
    *,
    expected_failures: Mapping[str, str] | None = None,
    only: Iterable[str] = (),
    options: Mapping[str, Any] | None = None,
    plugins: PluginManager | None = None,
    raises: bool = True,
) -> list[Result]:
    """Runs the checks of one component: a name (`laplacian` or `regularizer:laplacian`), or its descriptor.

    `expected_failures` maps names of checks to reasons; `only` selects checks; `options` replace the defaults.
    Raises `ContractError` with every failure, unless `raises` is False.
    """
    subject = subject_of(component, plugins, options)
    return _run_checks(subject, checks_for(subject.registered), expected_failures or {}, only, raises)


def check_whole_plugin(
    subject: PluginSubject,
    *,
    expected_failures: Mapping[str, str] | None = None,
    only: Iterable[str] = (),
    raises: bool = True,
) -> list[Result]:
    """Runs the checks of a plugin as a whole; those of its components are `check_component`'s."""
    return _run_checks(subject, plugin_checks(), expected_failures or {}, only, raises)


def _run_checks(
    subject: Subject | PluginSubject,
    chosen: Sequence[Check],
    expected_failures: Mapping[str, str],
    only: Iterable[str],
    raises: bool,
) -> list[Result]:
    results: list[Result] = []
    with opened(subject):
        known = {check.name for check in chosen}
        unknown = sorted((set(only) | set(expected_failures)) - known)
        if unknown:
            raise PluginError(
                f"{subject.label} has no check {unknown[0]!r}; its checks are: {', '.join(sorted(known))}"
            )
        for check in chosen:
            if not only or check.name in only or check.first:
                results.append(run_check(check, subject, expected_failures))
                if check.first and results[-1].outcome == "failed":
                    break
    failures = [result.detail for result in results if not result.is_ok]
    if failures and raises:
        raise ContractError("\n".join(failures))
    return results


def run_check(check: Check, subject: Subject | PluginSubject, expected_failures: Mapping[str, str]) -> Result:
    """Runs and times one check of one component or plugin."""
    start = time.perf_counter()
    outcome: Outcome = "passed"
    detail = ""
    reason = expected_failures.get(check.name)
    try:
        check(subject)
        if reason is not None:
            outcome = "unexpected_pass"
            detail = (
                f"{subject.label}: the check {check.name!r} passes, but is expected to fail "
                f"({reason}); remove it from expected_failures"
            )
    except NotApplicable as reason_to_skip:
        outcome, detail = "skipped", str(reason_to_skip)
    except ContractError as error:
        outcome, detail = ("failed", str(error)) if reason is None else ("expected", reason)
    seconds = time.perf_counter() - start
    return Result(subject.name, subject.kind, check.name, outcome, detail, seconds)


def subject_of(
    component: str | Component | Registered,
    plugins: PluginManager | None = None,
    options: Mapping[str, Any] | None = None,
) -> Subject:
    """The component of a name or descriptor, ready for checks; `PluginError` where the name is unknown or ambiguous."""
    manager = plugins or PluginManager.discover()
    if isinstance(component, str):
        found = named(component, manager)
        if not found:
            raise PluginError(f"the plugin {component!r} registers no component")
        if len(found) != 1:
            kinds = ", ".join(f"{r.kind}:{component}" for r in found)
            raise PluginError(f"{component!r} is the name of several components; choose one of: {kinds}")
        return Subject(found[0], manager, dict(options or {}))
    if isinstance(component, Registered):
        manager = _manager_with(component, manager)
        return Subject(component, manager, dict(options or {}))
    for registered in manager.components():
        if registered.component == component:
            return Subject(registered, manager, dict(options or {}))
    alone = as_registered(_kind_of(component), component)
    return Subject(alone, _manager_with(alone, manager), dict(options or {}))


def whole_plugin(name: str, plugins: PluginManager) -> PluginSubject | None:
    """The plugin that is a distribution, a file or a module of this name, or has an observer or a command of this name.

    None where `name` is none of these, or a component's. The plugins' commands are collected, so that those which take
    a name of ours are known.
    """
    plugins.commands()
    if any(r.component.name == name for r in plugins.components()):
        return None
    found = [loaded for loaded in plugins.loaded if _normal(loaded.distribution) == _normal(name)]
    found = found or _of_hooks(name, plugins)
    return PluginSubject(name, found, plugins) if found else None


def named(name: str, plugins: PluginManager) -> list[Registered]:
    """Components named `name` or `kind:name`; otherwise all of the distribution or plugin file of that name."""
    kind, colon, plain = name.partition(":")
    if colon and kind in INTERFACES:
        return [plugins.find(kind, plain)]
    every = plugins.components()
    found = [r for r in every if r.component.name == name]
    found = found or [r for r in every if _normal(r.distribution) == _normal(name)]
    known = {loaded.distribution for loaded in plugins.loaded} | {r.distribution for r in every}
    if not found and not _of_hooks(name, plugins) and all(_normal(each) != _normal(name) for each in known):
        distributions = ", ".join(sorted(known))
        problems = "".join(f"; {problem}" for problem in plugins.problems)
        raise PluginError(
            f"no component, observer, command or distribution has the name {name!r}; `hir plugins` lists them, "
            f"the distributions are: {distributions}{problems}"
        )
    return found


def _of_hooks(name: str, plugins: PluginManager) -> list[LoadedPlugin]:
    """The plugins with an observer or a command of this name; commands must have been collected."""
    return [loaded for loaded in plugins.loaded if name in loaded.observers or name in loaded.commands]


@contextlib.contextmanager
def opened(subject: Subject | PluginSubject) -> Iterator[Subject | PluginSubject]:
    """A context that removes the folders of the subject at its end."""
    try:
        yield subject
    finally:
        subject.close()


def _manager_with(registered: Registered, plugins: PluginManager) -> PluginManager:
    """A plugin manager in which the name of this component means this component."""
    try:
        if plugins.find(registered.kind, registered.component.name) == registered:
            return plugins
    except PluginError:
        pass
    return plugins.with_component(registered)


def _kind_of(component: Component) -> str:
    module, _, attribute = component.target.partition(":")
    try:
        found = getattr(import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise PluginError(
            f"component {component.name!r} cannot be loaded from {component.target!r}: {error}"
        ) from error
    for kind, interface in INTERFACES.items():
        if isinstance(found, type) and issubclass(found, interface):
            return kind
    raise PluginError(
        f"{component.target!r} has no known kind: it must be a subclass of one of "
        f"{', '.join(interface.__name__ for interface in INTERFACES.values())}"
    )


def _normal(name: str) -> str:
    return name.lower().replace("_", "-").replace(".", "-")


def as_registered(kind: str, component: Component) -> Registered:
    """A descriptor of a known kind that no plugin registers."""
    return Registered(kind, component, component.target.partition(".")[0].partition(":")[0], "")
