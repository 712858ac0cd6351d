"""The checks as a pytest parametrization: one test for each component and check."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any

from hir_core.errors import PluginError
from hir_core.plugins import Component
from hir_core.plugins.manager import PluginManager, Registered
from hir_core.testing.contract import Check, NotApplicable, PluginSubject, Subject
from hir_core.testing.running import checks_for, named, plugin_checks, subject_of, whole_plugin


class BoundCheck:
    """A check that skips, as pytest does, where it has nothing to say."""

    def __init__(self, check: Check) -> None:
        self._check = check
        self.name = check.name

    def __call__(self, component: Any) -> None:
        """Runs the check on the `component` argument of the test."""
        import pytest

        try:
            self._check(component)
        except NotApplicable as why:
            pytest.skip(str(why))


def parametrize_with_checks(
    components: Iterable[str | Component | Registered],
    *,
    expected_failures: Mapping[str, Mapping[str, str]] | None = None,
    options: Mapping[str, Mapping[str, Any]] | None = None,
    plugins: PluginManager | None = None,
    slow_marks: Iterable[Any] = (),
    slow: Iterable[str] = (),
) -> Callable[[Any], Any]:
    """Decorates `def test(component, check): check(component)`.

    `components`: names, descriptors, or the name of a distribution for all of its components and the plugin as a whole.
    `expected_failures` maps
    component and check to a reason; such a test must fail (`xfail`, strict). `options` maps a component to the options
    that it is tested with. `slow_marks` go to checks that take seconds, and to all of the components named in `slow`.
    """
    import pytest

    manager = plugins or PluginManager.discover()
    subjects: list[Subject | PluginSubject] = []
    for component in components:
        if isinstance(component, str):
            whole = whole_plugin(component, manager)
            subjects += [whole] if whole is not None else []
            subjects += [subject_of(registered, manager) for registered in named(component, manager)]
        else:
            subjects.append(subject_of(component, manager))
    expected, cases = dict(expected_failures or {}), []
    for subject in subjects:
        name = subject.name
        reasons = dict(expected.pop(name, {}))
        if isinstance(subject, Subject):
            subject.options = dict((options or {}).get(name, {}))
        for check in checks_for(subject.registered) if isinstance(subject, Subject) else plugin_checks():
            marks = list(slow_marks) if check.slow or name in slow else []
            if check.name in reasons:
                marks.append(pytest.mark.xfail(reason=reasons.pop(check.name), strict=True))
            test_id = f"{subject.kind}-{name}-{check.name}"
            cases.append(pytest.param(subject, BoundCheck(check), id=test_id, marks=marks))
        if reasons:
            raise PluginError(f"expected_failures of {name!r}: there is no check {next(iter(reasons))!r} for it")
    if expected:
        raise PluginError(f"expected_failures: {next(iter(expected))!r} is none of the components")
    return pytest.mark.parametrize(("component", "check"), cases)
