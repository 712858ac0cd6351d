"""`hir new-plugin`: writes an installable plugin that passes the contract tests."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Final

from hir_exporters.files.atomic import atomic_directory, write_text_atomic

from hir_core.errors import ConfigError
from hir_core.plugins import API_VERSION
from hir_core.plugins.engine_commands import ENGINE_COMMANDS
from hir_core.plugins.manager import KINDS, PluginManager
from hir_core.scaffold.one_file import joined


@dataclass(frozen=True)
class KindTemplate:
    """The parts of a plugin that depend on its kind, without the implementation."""

    summary: str
    option: str
    """The option of the component, with its docstring."""
    requires: tuple[str, ...] = ()
    traits: tuple[str, ...] = ()
    testing: str = ""
    use: str = ""


KIND_TEMPLATES: Final[Mapping[str, KindTemplate]] = {
    "capture_reader": KindTemplate(
        "Reads captures whose cameras are in a JSON file.",
        "",  # no setting reaches the options of a reader
        testing="write_sample",
        use="hir check CAPTURE",
    ),
    "mask_source": KindTemplate(
        "Masks pixels that differ from the colour of the image border.",
        "tolerance: Annotated[float, Interval(ge=0, le=1)] = 0.06\n"
        '    """Distance in sRGB below which a pixel is background."""',
        use="hir reconstruct PHOTOS -o RUN --set 'masks=[\"$name\"]'",
    ),
    "initializer": KindTemplate(
        "Makes the convex hull of the capture's points the first mesh.",
        'min_points: Annotated[int, Interval(ge=4)] = 10\n    """Minimum number of points for a hull."""',
        ("torch", "jaxtyping", "scipy"),
        ("makes_surface",),
        use='hir reconstruct PHOTOS -o RUN --set \'initializers=["colmap", "$name"]\'',
    ),
    "geometry_renderer": KindTemplate(
        "Silhouettes; at first those of contour.",
        'lines: Annotated[int, Interval(ge=1, le=64)] = 4\n    """Rows and columns per pixel of a picture."""',
        ("torch", "jaxtyping"),
        ("differentiable",),
        use="hir reconstruct PHOTOS -o RUN --set geometry.renderer=$name",
    ),
    "reflectance_renderer": KindTemplate(
        "Shading; at first that of mitsuba_ggx.",
        'samples: Annotated[int, Interval(ge=1), Unit("paths")] = 64\n    """Paths per pixel and step."""',
        ("torch", "jaxtyping", "mitsuba"),
        ("material", "environment", "stochastic"),
        use="hir reconstruct PHOTOS -o RUN --set reflectance.renderer=$name",
    ),
    "regularizer": KindTemplate(
        "Keeps the diffuse albedo near its mean.",
        'strength: Annotated[float, Interval(ge=0)] = 1.0\n    """Factor of the term."""',
        ("torch", "jaxtyping"),
        ("differentiable", "material"),
        "ideal",
        use="hir reconstruct PHOTOS -o RUN --set reflectance.regularizers.$name.weight=1",
    ),
    "exporter": KindTemplate(
        "Writes positions and triangles as JSON.",
        'digits: Annotated[int, Interval(ge=1, le=17)] = 7\n    """Decimals of positions."""',
        testing="read_back",
        use="hir export RUN -f $name -o files/",
    ),
}

HOOK_TEMPLATES: Final[Mapping[str, KindTemplate]] = {
    "observer": KindTemplate(
        "Writes the scalars of a run as lines of JSON.",
        "",
        use="hir reconstruct PHOTOS -o RUN --set observers.$name={}",
    ),
    "command": KindTemplate("Prints the stages of a run.", "", use="hir $command RUN"),
}
"""What is a plugin by its hooks alone, without a component."""

TEMPLATES: Final = {**KIND_TEMPLATES, **HOOK_TEMPLATES}


def write_plugin(name: str, kind: str, folder: Path) -> list[Path]:
    """Writes an installable plugin into the new folder `folder/<distribution>`; returns its files."""
    values = _template_values(name, kind)
    destination = folder / values["distribution"]
    if destination.exists():
        raise ConfigError(f"{destination} exists; choose another name, or remove it")
    package = values["package"]
    layout = {
        "pyproject.toml": "pyproject",
        "README.md": "readme",
        f"{package}/plugin.py": kind,
        "tests/test_contracts.py": "tests",
    }
    if kind in KIND_TEMPLATES:
        layout |= {
            f"{package}/plugin.py": "plugin",
            f"{package}/options.py": "options",
            f"{package}/{values['module']}.py": kind,
        }
    with atomic_directory(destination) as temporary:
        for file, source in layout.items():
            write_text_atomic(temporary / file, _filled(source, values))
        write_text_atomic(temporary / package / "__init__.py", f'"""{values["summary"]}"""\n')
    return sorted(file for file in destination.rglob("*") if file.is_file())


def write_one_file(name: str, kind: str, folder: Path) -> tuple[Path, str]:
    """Writes a component as one .py file for `--plugin`; returns its path, and the command that uses it."""
    values = _template_values(name, kind, one_file=True)
    path = folder / f"{values['name']}.py"
    if path.exists():
        raise ConfigError(f"{path} exists; choose another name, or remove it")
    implementation, options, descriptor = (_filled(part, values) for part in (kind, "options", "plugin"))
    own = re.compile(rf"^from {values['package']}\.options import Options\n", re.MULTILINE)
    text = joined(own.sub("", implementation), options, own.sub("", descriptor), values["summary"])
    write_text_atomic(path, text)
    return path, f"{values['use']} --plugin {path}"


def refuse_taken_name(name: str, kind: str, plugins: PluginManager) -> None:
    """`ConfigError` where `hir` or an installed plugin has a component, an observer or a command of this name."""
    values = _template_values(name, kind)
    if kind == "command":
        owners = {**plugins.commands(), **ENGINE_COMMANDS}
        owner = "an installed command" if values["command"] in owners else ""
    elif kind == "observer":
        owner = "an installed observer" if values["name"] in plugins.observers() else ""
    else:
        owner = next((r.label for r in plugins.components(kind) if r.component.name == values["name"]), "")
    if owner:
        raise ConfigError(
            f"the name {values['name']!r} is taken by {owner}, which would be used in place of the new one; choose "
            "another"
        )


def _template_values(name: str, kind: str, one_file: bool = False) -> dict[str, str]:
    """The values of the templates, derived from the name and kind. `ConfigError` for an invalid name."""
    if "/" in name or "\\" in name:
        raise ConfigError(f"the name {name!r} is a path; give the name alone, and its parent folder with -o")
    if wrong := sorted(set(re.findall(r"[^A-Za-z0-9_ -]", name))):
        raise ConfigError(
            f"the name {name!r} contains {wrong[0]!r}; names have letters a to z, digits and hyphens, such as "
            "albedo-chroma-prior"
        )
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_").removeprefix("hir_")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", plain):
        raise ConfigError(f"the name {name!r} does not begin with a letter; an example is albedo-chroma-prior")
    template = TEMPLATES[kind]
    # a file given to --plugin is loaded under this name
    package, module = (f"hir_plugin_{plain}", "") if one_file else (f"hir_{plain}", "implementation")
    target = f"{package}.{module}".rstrip(".")
    class_name = "".join(part.capitalize() for part in plain.split("_"))
    values = {
        "name": plain,
        "package": package,
        "module": module,
        "target": target,
        "distribution": package.replace("_", "-"),
        "Class": class_name,
        "kind": kind,
        "kind_label": kind.replace("_", " "),
        "hook": KINDS.get(kind, ""),
        "command": plain.replace("_", "-"),
        # the entry point names a class, of which each run gets an object, or the module
        "attribute": f":{class_name}" if kind == "observer" else "",
        "where": f"The code is in `{package}/{module}.py`, its options in `{package}/options.py`, what `hir` loads "
        "at start "
        f"in `{package}/plugin.py`."
        if kind in KIND_TEMPLATES
        else f"The code is in `{package}/plugin.py`, which `hir` loads when it starts.",
        "summary": template.summary,
        "api": str(API_VERSION),
        "option": template.option,
        "annotations": _annotations(template.option),
        "requires": _tuple(template.requires),
        "extra": "reconstruct" if template.requires else "",
        "traits": "{" + ", ".join(f'"{trait}"' for trait in template.traits) + "}" if template.traits else "",
        "testing": f"{target}:{template.testing}" if template.testing else "",
    }
    return values | {"use": Template(template.use).substitute(values)}


def _annotations(option: str) -> str:
    """The imports of an option with a range or a unit."""
    used = [name for name in ("Interval", "Unit") if f"{name}(" in option]
    return f"from typing import Annotated\n\nfrom annotated_types import {', '.join(used)}\n" if used else ""


def _tuple(values: tuple[str, ...]) -> str:
    return "(" + ", ".join(f'"{word}"' for word in values) + ("," if len(values) == 1 else "") + ")"


def _filled(template: str, values: Mapping[str, str]) -> str:
    text = (files("hir_core.scaffold") / "templates" / f"{template}.txt").read_text(encoding="utf-8")
    return Template(text).substitute(values)
