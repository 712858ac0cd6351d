"""Finds the plugin, and its component, in which an exception was raised, from the traceback.

Components are called in many places, on several threads, and return functions that are called later. The traceback
has them all, so that no call needs a guard.
"""

from __future__ import annotations

from collections.abc import Iterator
from types import FrameType

from hir_core.plugins.manager import PluginManager, Registered

OURS = ("hir", "")
"""Distributions whose components are built in, or stand for none."""
OUR_PACKAGES = ("hir_core", "hir_exporters")
"""Packages of this program, beside those of its own plugins."""


def origin_of(error: BaseException) -> str:
    """`the exporter 'x' of DISTRIBUTION`, or `the plugin DISTRIBUTION`; "" where no plugin of a third party raised."""
    frames = list(_frames(error))
    plugins = next((found for frame in reversed(frames) for found in _managers(frame)), None)
    if plugins is None:
        return ""
    components = [r for r in plugins.components() if r.distribution not in OURS]
    modules = [str(frame.f_globals.get("__name__", "")) for frame in frames]
    for module in reversed(modules):
        inside = [r for r in components if r.component.target.partition(":")[0] == module]
        if inside:
            return _component_of(frames, inside)
    ours = {*OUR_PACKAGES, *(_package(loaded.module) for loaded in plugins.loaded if loaded.distribution in OURS)}
    for module in reversed(modules):
        if _package(module) in ours:
            break  # a defect of this program, even where a command of a plugin called it
        for loaded in plugins.loaded:
            if loaded.distribution not in OURS and _package(loaded.module) == _package(module):
                return f"the plugin {loaded.distribution}"
    return ""


def _component_of(frames: list[FrameType], inside: list[Registered]) -> str:
    """The component of a module whose class is in the traceback; the plugin where the module has several and none is.

    A function inside of a method has the class in its qualified name, so that a term that `prepare` returned has it.
    """
    of_module = {r.component.target: r for r in inside}
    for frame in reversed(frames):
        owner = frame.f_code.co_qualname.partition(".")[0]
        found = of_module.get(f"{frame.f_globals.get('__name__', '')}:{owner}")
        if found is not None:
            return found.label
    return inside[0].label if len(inside) == 1 else f"the plugin {inside[0].distribution}"


def _frames(error: BaseException) -> Iterator[FrameType]:
    """From the outermost call to the one that raised."""
    traceback = error.__traceback__
    while traceback is not None:
        yield traceback.tb_frame
        traceback = traceback.tb_next


def _managers(frame: FrameType) -> Iterator[PluginManager]:
    """The functions that create and call components have the plugin manager in a variable."""
    return (value for value in frame.f_locals.values() if isinstance(value, PluginManager))


def _package(module: str) -> str:
    return module.partition(".")[0]
