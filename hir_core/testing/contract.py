"""What a contract check is, what it is given, and how it says that a contract is broken."""

from __future__ import annotations

import inspect
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Final, TypeVar

from hir_exporters.exporter import Exporter

from hir_core.errors import PluginError
from hir_core.plugins import Component, interfaces
from hir_core.plugins.manager import PluginManager, Registered

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

PAGE: Final = "docs/writing_plugins/contracts.md"
"""Where every contract has a section of its check's name."""


class Broken(AssertionError):  # noqa: N818 - the outcome of a check, not a failure of the program
    """A contract is broken; the message says what was seen."""


class NotApplicable(Exception):  # noqa: N818 - the outcome of a check, not a failure of the program
    """A check has nothing to say about this component here; the message says why."""


class ContractError(AssertionError):
    """One or more contracts of a component are broken: each with its contract, what was seen, and the doc section."""


def require(condition: object, seen: str) -> None:
    """Raises `Broken` with what was seen unless `condition` holds."""
    if not bool(condition):
        raise Broken(seen)


@dataclass
class Subject:
    """One component under test, and a place to try it in."""

    registered: Registered
    plugins: PluginManager
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options that it is tested with beyond its defaults."""
    _folders: list[tempfile.TemporaryDirectory[str]] = field(default_factory=list)
    memory: dict[str, Any] = field(default_factory=dict)
    """What checks of one component share, so that nothing slow is done twice."""

    @property
    def kind(self) -> str:
        """Its kind, such as `regularizer`."""
        return self.registered.kind

    @property
    def component(self) -> Component:
        """Its descriptor."""
        return self.registered.component

    @property
    def label(self) -> str:
        """`kind 'name'`, for messages."""
        return f"{self.kind.replace('_', ' ')} {self.component.name!r}"

    @cached_property
    def implementation(self) -> Any:
        """What `target` names."""
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
        """The component, built as the core builds it."""
        return self.plugins.create(self.kind, self.component.name, {**self.options, **options})

    def folder(self) -> Path:
        """A new empty folder that lives as long as the test."""
        self._folders.append(tempfile.TemporaryDirectory(prefix="hir-contract-", ignore_cleanup_errors=True))
        return Path(self._folders[-1].name).resolve()

    def has(self, trait: str) -> bool:
        """Whether the component declares a trait."""
        return trait in self.component.traits

    def close(self) -> None:
        """Removes the folders."""
        for folder in self._folders:
            folder.cleanup()
        self._folders.clear()
        self.memory.clear()


@dataclass(frozen=True)
class Check:
    """A plain function that raises `Broken` when a contract of its kinds is broken."""

    name: str
    function: Callable[[Subject], None]
    kinds: frozenset[str]
    traits: frozenset[str] = frozenset()
    """Only components with all of these are checked."""
    unless: frozenset[str] = frozenset()
    """Components with one of these are not."""
    first: bool = False
    """The other checks make no sense where this one fails."""
    slow: bool = False
    """Takes seconds for some components."""

    @property
    def contract(self) -> str:
        """The contract in words: the function's docstring."""
        return inspect.cleandoc(self.function.__doc__ or "")

    @property
    def section(self) -> str:
        """Where the documentation says more."""
        return f"{PAGE}#{self.name}"

    def applies(self, registered: Registered) -> bool:
        """Chosen by kind and traits alone, so that nothing heavy is imported."""
        traits = registered.component.traits
        return registered.kind in self.kinds and self.traits <= traits and not self.unless & traits

    def __call__(self, subject: Subject) -> None:
        """Raises `ContractError`, or `NotApplicable` with the reason.

        Warnings break no contract, also where a test suite makes errors of them: a term may say that it has no effect.
        """
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                self.function(subject)
        except NotApplicable:
            raise
        except Exception as error:
            seen = str(error) if isinstance(error, Broken) else f"it raised {type(error).__name__}: {error}"
            raise ContractError(
                f"{subject.label} breaks the contract {self.name!r}\n"
                f"  contract: {' '.join(self.contract.split())}\n"
                f"  seen:     {' '.join(seen.split())}\n"
                f"  see:      {self.section}"
            ) from error


CHECKS: dict[str, Check] = {}
"""Every check by its name, in the order in which they run."""

Function = TypeVar("Function", bound=Callable[[Subject], None])


def contract(
    *kinds: str,
    traits: frozenset[str] | set[str] = frozenset(),
    unless: frozenset[str] | set[str] = frozenset(),
    first: bool = False,
    slow: bool = False,
) -> Callable[[Function], Function]:
    """Registers a check for some kinds, all where none is named; its docstring is the contract in words."""

    def register(function: Function) -> Function:
        name = function.__name__
        assert name not in CHECKS, name
        CHECKS[name] = Check(
            name, function, frozenset(kinds or INTERFACES), frozenset(traits), frozenset(unless), first, slow
        )
        return function

    return register
