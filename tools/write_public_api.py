"""Writes docs/reference/public_api.txt: the plugin interface as names and signatures, and a hash for CHANGELOG.md."""

from __future__ import annotations

import hashlib
import inspect
from abc import ABC
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

FILE = Path(__file__).resolve().parent.parent / "docs" / "reference" / "public_api.txt"

TYPES = {
    "hir_core.plugins": ("Component", "NoOptions"),
    "hir_core.plugins.interfaces": (
        "CaptureReader",
        "MaskSource",
        "Initializer",
        "GeometryRenderer",
        "PreparedReflectance",
        "ReflectanceSolver",
        "ReflectanceRenderer",
        "Regularizer",
        "CheckpointLocation",
        "WeightedTerm",
        "Solved",
    ),
    "hir_core.plugins.model_spec": ("ModelSpec",),
    "hir_core.stages.reflectance.gradient_solver": ("GradientSolver",),
    "hir_exporters.exporter": ("Exporter", "ExportReport"),
    "hir_core.capture": ("Camera", "Pixels", "View", "OrientedPoints", "EnvironmentSource", "Capture"),
    "hir_core.scene": ("Topology", "Mesh", "Material", "CameraLamp", "EnvironmentMap", "Scene"),
    "hir_core.scene.scan": ("Scan",),
    "hir_core.scene.silhouette_targets": ("SilhouetteTargets",),
    "hir_core.plugins.progress": ("Progress",),
    "hir_core.mesh.ray_casting": ("MeshQueries",),
    "hir_core.errors": (
        "CaptureError",
        "ConfigError",
        "HirError",
        "InputError",
        "MissingExtraError",
        "PluginError",
        "StageError",
    ),
    "hir_exporters.asset": ("Asset", "AssetMesh", "AssetMaterial", "AssetEnvironment"),
    "hir_exporters.asset_lamp": ("AssetLamp",),
}

FUNCTIONS = {
    "hir_core.plugins.options": ("build_options", "seed_of_run", "device_of_run", "takes_effect_with"),
    "hir_core.run.determinism": ("threads",),
    "hir_core.testing": (
        "check_component",
        "check_whole_plugin",
        "whole_plugin",
        "parametrize_with_checks",
        "checks_for",
    ),
    "hir_exporters.files.atomic": ("atomic_write", "atomic_path", "atomic_directory", "write_bytes_atomic"),
    "hir_exporters.asset": ("validate_asset",),
}

MANAGER = ("discover", "create", "find", "components", "presets", "observers", "commands")


def lines() -> Iterator[str]:
    """One line for each hook, method, field, function, trait and check."""
    from hir_core.plugins import API_VERSION, hookspecs
    from hir_core.plugins.manager import PluginManager
    from hir_core.plugins.traits import TRAITS
    from hir_core.testing import all_checks

    yield f"api {API_VERSION}"
    for name, function in vars(hookspecs).items():
        if name.startswith("hir_"):
            first = " firstresult" if function.hir_spec["firstresult"] else ""
            yield f"hook {name}{_signature(function)}{first}"
    for module, names in TYPES.items():
        for name in names:
            yield from _type(module, getattr(import_module(module), name))
    for module, names in FUNCTIONS.items():
        for name in names:
            yield f"function {module}.{name}{_signature(getattr(import_module(module), name))}"
    for name in MANAGER:
        yield f"method hir_core.plugins.manager.PluginManager.{name}{_signature(getattr(PluginManager, name))}"
    for kind, arguments in TRAITS.items():
        yield f"traits {kind}: {' '.join(sorted(arguments)) or '-'}"
    for _, check in sorted(all_checks().items()):
        traits = [*sorted(check.traits), *(f"not {trait}" for trait in sorted(check.unless))]
        yield f"check {check.name}: {' '.join(sorted(check.kinds))}{' if ' + ', '.join(traits) if traits else ''}"


def _type(module: str, kind: type) -> Iterator[str]:
    bases = " ".join(b.__name__ for b in kind.__bases__ if b not in (object, ABC))
    yield f"class {module}.{kind.__name__}{f' of {bases}' if bases else ''}"
    if is_dataclass(kind):
        for field in fields(kind):
            required = field.default is field.default_factory  # both are MISSING
            yield f"  field {field.name}: {field.type}{' required' if required else ''}"
    elif inspect.isfunction(kind.__init__) and "__init__" in vars(kind):
        yield f"  constructor {_signature(kind.__init__)}"
    for name, member in vars(kind).items():
        if name.startswith("_"):
            continue
        if isinstance(member, property):
            yield f"  property {name}"
        elif inspect.isfunction(member) or isinstance(member, classmethod):
            function = member.__func__ if isinstance(member, classmethod) else member
            abstract = " abstract" if getattr(function, "__isabstractmethod__", False) else ""
            yield f"  method {name}{_signature(function)}{abstract}"


def _signature(function: Any) -> str:
    return str(inspect.signature(function)).replace("'", "")


def interface_hash(text: str) -> str:
    """Hash of the interface, eight hexadecimal digits; CHANGELOG.md notes a change with it."""
    return hashlib.blake2b(text.encode(), digest_size=4).hexdigest()


def page() -> str:
    """The whole file."""
    return "\n".join(lines()) + "\n"


if __name__ == "__main__":
    text = page()
    FILE.parent.mkdir(parents=True, exist_ok=True)
    FILE.write_text(text, encoding="utf-8")
    print(f"note the change in CHANGELOG.md with the hash: plugin interface {interface_hash(text)}")
