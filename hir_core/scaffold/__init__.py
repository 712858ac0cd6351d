"""`hir new-plugin`: a plugin that can be installed and that passes the contract tests as it is written."""

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
from hir_core.plugins.manager import KINDS


@dataclass(frozen=True)
class Outline:
    """What differs between the kinds beside the implementation."""

    summary: str
    option: str
    """The one option of the scaffold, with its docstring."""
    requires: tuple[str, ...] = ()
    traits: tuple[str, ...] = ()
    testing: str = ""
    use: str = ""


OUTLINES: Final[Mapping[str, Outline]] = {
    "capture_reader": Outline(
        "Reads captures whose cameras lie in a JSON file.",
        'suffix: str = ".png"\n    """Ending of the photographs."""',
        testing="write_sample",
        use="hir check CAPTURE",
    ),
    "mask_source": Outline(
        "Masks what differs from the colour of a photograph's border.",
        'tolerance: float = 0.06\n    """Distance in sRGB below which a pixel is background."""',
        use="hir reconstruct PHOTOS -o RUN --set 'masks=[\"$name\"]'",
    ),
    "initializer": Outline(
        "Starts from the convex hull of the capture's points.",
        'min_points: int = 10\n    """With fewer points than this there is no hull."""',
        ("torch", "jaxtyping"),
        ("makes_surface",),
        use='hir reconstruct PHOTOS -o RUN --set \'initializers=["colmap", "$name"]\'',
    ),
    "geometry_renderer": Outline(
        "Silhouettes, for a start those of contour.",
        'lines: int = 4\n    """Rows and columns per pixel of a picture."""',
        ("torch", "jaxtyping"),
        ("differentiable",),
        use="hir reconstruct PHOTOS -o RUN --set geometry.renderer=$name",
    ),
    "reflectance_renderer": Outline(
        "Shading, for a start that of mitsuba_ggx.",
        'samples: int = 64\n    """Paths for each pixel of a step."""',
        ("torch", "jaxtyping", "mitsuba"),
        ("material", "environment", "stochastic"),
        use="hir reconstruct PHOTOS -o RUN --set reflectance.renderer=$name",
    ),
    "regularizer": Outline(
        "Keeps the diffuse albedo near its mean.",
        'strength: float = 1.0\n    """Factor of the term."""',
        ("torch", "jaxtyping"),
        ("differentiable", "material"),
        "ideal",
        use="hir reconstruct PHOTOS -o RUN --set reflectance.regularizers.$name.weight=1",
    ),
    "exporter": Outline(
        "Writes positions and triangles as JSON.",
        'digits: int = 7\n    """Decimals of positions."""',
        testing="read_back",
        use="hir export RUN -f $name -o files/",
    ),
}


def write_plugin(name: str, kind: str, folder: Path) -> list[Path]:
    """Writes an installable plugin into the new folder `folder/<distribution>`; returns its files."""
    values = _template_values(name, kind)
    outline = OUTLINES[kind]
    values["use"] = Template(outline.use).substitute(values)
    destination = folder / values["distribution"]
    if destination.exists():
        raise ConfigError(f"{destination} exists; choose another name, or remove it")
    package = values["package"]
    layout = {
        "pyproject.toml": "pyproject",
        "README.md": "readme",
        f"{package}/plugin.py": "plugin",
        f"{package}/options.py": "options",
        f"{package}/{values['module']}.py": kind,
        "tests/test_contracts.py": "tests",
    }
    with atomic_directory(destination) as temporary:
        for file, template in layout.items():
            write_text_atomic(temporary / file, _filled(template, values))
        write_text_atomic(temporary / package / "__init__.py", f'"""{outline.summary}"""\n')
    return sorted(file for file in destination.rglob("*") if file.is_file())


def write_one_file(name: str, folder: Path) -> Path:
    """Writes a regularizer as one file for `--plugin`; returns it."""
    values = _template_values(name, "regularizer")
    path = folder / f"{values['name']}.py"
    if path.exists():
        raise ConfigError(f"{path} exists; choose another name, or remove it")
    write_text_atomic(path, _filled("one_file", values))
    return path


def _template_values(name: str, kind: str) -> dict[str, str]:
    """All names that follow from the one that was given."""
    plain = re.sub(r"[^a-z0-9]+", "_", name.lower()).strip("_").removeprefix("hir_")
    if not re.fullmatch(r"[a-z][a-z0-9_]*", plain):
        raise ConfigError(f"the name {name!r} does not begin with a letter; such as albedo-chroma-prior")
    outline = OUTLINES[kind]
    package = f"hir_{plain}"
    return {
        "name": plain,
        "package": package,
        "module": "implementation",
        "distribution": package.replace("_", "-"),
        "Class": "".join(part.capitalize() for part in plain.split("_")),
        "kind": kind,
        "kind_label": kind.replace("_", " "),
        "hook": KINDS[kind],
        "summary": outline.summary,
        "option": outline.option,
        "requires": _tuple(outline.requires),
        "extra": "reconstruct" if outline.requires else "",
        "traits": "{" + ", ".join(f'"{trait}"' for trait in outline.traits) + "}" if outline.traits else "",
        "testing": f"{package}.implementation:{outline.testing}" if outline.testing else "",
    }


def _tuple(values: tuple[str, ...]) -> str:
    return "(" + ", ".join(f'"{word}"' for word in values) + ("," if len(values) == 1 else "") + ")"


def _filled(template: str, values: Mapping[str, str]) -> str:
    text = (files("hir_core.scaffold") / "templates" / f"{template}.txt").read_text(encoding="utf-8")
    return Template(text).substitute(values)
