"""Contract checks: what a check is, the component that it tests, and how it reports a broken contract."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from typing import Any, Final, TypeVar

from hir_exporters.exporter import Exporter

from hir_core.errors import PluginError
from hir_core.plugins import Component, interfaces
from hir_core.plugins.manager import LoadedPlugin, PluginManager, Registered
from hir_core.testing.workspace import Workspace

INTERFACES: Final[Mapping[str, type]] = {
    "capture_reader": interfaces.CaptureReader,
    "mask_source": interfaces.MaskSource,
    "initializer": interfaces.Initializer,
    "geometry_renderer": interfaces.GeometryRenderer,
    "reflectance_renderer": interfaces.ReflectanceRenderer,
    "regularizer": interfaces.Regularizer,
    "exporter": Exporter,
}
"""The base class of each kind."""

PLUGIN: Final = "plugin"
"""The kind of checks that test a plugin as a whole."""

PAGE: Final = "docs/writing_plugins/contracts.md"
"""The page with one section per check, named as the check."""


class BrokenContract(AssertionError):  # noqa: N818 - the outcome of a check, not a failure of the program
    """A contract is broken; the message is the observation."""


class NotApplicable(Exception):  # noqa: N818 - the outcome of a check, not a failure of the program
    """A check cannot test this component on this machine; the message is the reason."""


class ContractError(AssertionError):
    """One or more checks of a component failed. The message has contract, observation and page of the docs for each."""


def require(condition: object, observation: str) -> None:
    """Raises `BrokenContract` with the observation unless `condition` is true."""
    if not bool(condition):
        raise BrokenContract(observation)


@dataclass
class Subject(Workspace):
    """One component under test, and folders for its files."""

    registered: Registered
    plugins: PluginManager
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the test that replace defaults."""
    memory: dict[str, Any] = field(default_factory=dict)
    """Results that the checks of one component share, so that nothing slow runs twice."""

    @property
    def kind(self) -> str:
        """The kind, such as `regularizer`."""
        return self.registered.kind

    @property
    def name(self) -> str:
        """The component's name."""
        return self.component.name

    @property
    def component(self) -> Component:
        """The descriptor."""
        return self.registered.component

    @property
    def label(self) -> str:
        """`kind 'name'`, for messages."""
        return f"{self.kind.replace('_', ' ')} {self.component.name!r}"

    @cached_property
    def implementation(self) -> Any:
        """The class that `Component.target` names."""
        module, _, attribute = self.component.target.partition(":")
        return getattr(import_module(module), attribute)

    @cached_property
    def testing(self) -> Callable[..., Any] | None:
        """The function that `Component.testing` names; None where the component names none."""
        if not self.component.testing:
            return None
        module, _, attribute = self.component.testing.partition(":")
        try:
            found: Callable[..., Any] = getattr(import_module(module), attribute)
        except (ImportError, AttributeError) as error:
            raise PluginError(f"{self.label}: testing={self.component.testing!r} cannot be loaded: {error}") from error
        return found

    def create(self, **options: Any) -> Any:
        """An instance, built as hir_core builds it."""
        return self.plugins.create(self.kind, self.component.name, {**self.options, **options})

    def has(self, trait: str) -> bool:
        """Whether the component declares a trait."""
        return trait in self.component.traits

    def close(self) -> None:
        """Removes the folders, and what the checks shared."""
        super().close()
        self.memory.clear()


@dataclass
class PluginSubject(Workspace):
    """A plugin as a whole: everything that one distribution, file or module registers."""

    name: str
    loaded: Sequence[LoadedPlugin]
    plugins: PluginManager
    kind: str = PLUGIN

    @property
    def label(self) -> str:
        """`plugin 'name'`, for messages."""
        return f"plugin {self.name!r}"

    @property
    def components(self) -> list[Registered]:
        """The components that it registers."""
        owners = {loaded.distribution for loaded in self.loaded}
        return [r for r in self.plugins.components() if r.distribution in owners]

    @property
    def modules(self) -> list[str]:
        """The modules that hold its hooks."""
        return sorted({loaded.module for loaded in self.loaded if loaded.module})


@dataclass(frozen=True)
class Check:
    """A function that raises `BrokenContract` where a component, or a plugin, breaks a contract of its kind."""

    name: str
    function: Callable[[Any], None]
    kinds: frozenset[str]
    traits: frozenset[str] = frozenset()
    """The check tests components with all of these."""
    unless: frozenset[str] = frozenset()
    """The check does not test components with one of these."""
    first: bool = False
    """The other checks are not run where this one fails."""
    slow: bool = False
    """Takes seconds for some components."""

    @property
    def contract(self) -> str:
        """The contract as text: the docstring of the function."""
        return inspect.cleandoc(self.function.__doc__ or "")

    @property
    def section(self) -> str:
        """The section of the documentation."""
        return f"{PAGE}#{self.name}"

    def applies(self, registered: Registered) -> bool:
        """Whether the check tests this component. Depends on kind and traits alone, so nothing heavy is imported."""
        traits = registered.component.traits
        return registered.kind in self.kinds and self.traits <= traits and not self.unless & traits

    def __call__(self, subject: Subject | PluginSubject) -> None:
        """Raises `ContractError`, or `NotApplicable` with the reason.

        Warnings break no contract, even where pytest turns them into errors: a term may warn that it has no effect.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.function(subject)
        except NotApplicable:
            raise
        except Exception as error:
            observation = (
                str(error) if isinstance(error, BrokenContract) else f"it raised {type(error).__name__}: {error}"
            )
            raise ContractError(
                f"{subject.label} breaks the contract {self.name!r}\n"
                f"  contract: {' '.join(self.contract.split())}\n"
                f"  seen:     {' '.join(observation.split())}\n"
                f"  see:      {self.section}"
            ) from error


CHECKS: dict[str, Check] = {}
"""Every check by its name."""

Function = TypeVar("Function", bound=Callable[[Any], None])


def contract(
    *kinds: str,
    traits: frozenset[str] | set[str] = frozenset(),
    unless: frozenset[str] | set[str] = frozenset(),
    first: bool = False,
    slow: bool = False,
) -> Callable[[Function], Function]:
    """Registers a check for the named kinds, or for every kind of component; the docstring is the contract's text."""

    def register(function: Function) -> Function:
        name = function.__name__
        assert name not in CHECKS, name
        CHECKS[name] = Check(
            name, function, frozenset(kinds or INTERFACES), frozenset(traits), frozenset(unless), first, slow
        )
        return function

    return register
