"""The captures of the materials benchmark in a folder that `python -m benchmarks.materials make` filled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import TypeAdapter

from hir_core.errors import InputError
from hir_core.files.json_documents import read_json
from hir_plugins.commands.bench.materials_options import Half

MAKE_COMMAND: Final = "python -m benchmarks.materials make"
TRUTH: Final = "truth.json"
"""Written last: a capture without it is not complete."""
INDEX: Final = "captures.json"
"""In the benchmark's folder: name and half of every capture that the benchmark has, rendered or not."""


@dataclass(frozen=True)
class MaterialsCapture:
    """One rendered capture and what is true of it."""

    folder: Path
    half: Half
    kind: Literal["dielectric", "metal", "mixed"]
    light_frame: Literal["world", "camera"]
    within_model: bool
    """Whether the BRDFs of `hir` can represent the material."""

    @property
    def name(self) -> str:
        """The capture's name: number, shape, material, light."""
        return self.folder.name


@dataclass(frozen=True)
class BenchmarkCaptures:
    """The captures that were selected, and those that are not rendered."""

    captures: tuple[MaterialsCapture, ...]
    missing: Mapping[str, Half]


def find_captures(root: Path, halves: Sequence[Half], only: Sequence[str] = ()) -> BenchmarkCaptures:
    """The rendered captures of some halves in the order of their names; `only` selects by name or number.

    `InputError` names the command that renders them where there are none, and for names that the benchmark has not.
    """
    known = _index(root)
    selected = [name for name in known if known[name] in halves and _is_selected(name, only)]
    for wanted in only:
        if not any(_is_selected(name, (wanted,)) for name in selected):
            raise InputError(
                f"the materials benchmark has no capture {wanted!r} in the half {' or '.join(halves)}; "
                "python -m benchmarks.materials list prints them"
            )
    found: list[MaterialsCapture] = []
    missing: dict[str, Half] = {}
    for name in selected:
        folder = root / known[name] / name
        if (folder / TRUTH).is_file():
            found.append(_capture(folder, known[name]))
        else:
            missing[name] = known[name]
    if not found:
        numbers = " ".join(name.partition("_")[0] for name in missing)
        raise InputError(
            f"{root} has none of the {len(missing)} captures; render them with: {MAKE_COMMAND} {root} --only {numbers}"
        )
    return BenchmarkCaptures(tuple(found), missing)


def _index(root: Path) -> dict[str, Half]:
    """Name → half of every capture of the benchmark."""
    path = root / INDEX
    if not path.is_file():
        raise InputError(f"{root} is not a folder of the materials benchmark; make it with: {MAKE_COMMAND} {root}")
    try:
        return TypeAdapter(dict[str, Half]).validate_python(read_json(path)["captures"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path} is damaged ({_line(error)}); write it again with: {MAKE_COMMAND} {root}") from error


def _is_selected(name: str, only: Sequence[str]) -> bool:
    return not only or name in only or name.partition("_")[0] in only


def _capture(folder: Path, half: Half) -> MaterialsCapture:
    document: dict[str, Any] = read_json(folder / TRUTH)
    fields = {key: document.get(key) for key in ("kind", "light_frame", "within_model")}
    try:
        return TypeAdapter(MaterialsCapture).validate_python({"folder": folder, "half": half, **fields})
    except ValueError as error:
        raise InputError(
            f"{folder / TRUTH} is damaged ({_line(error)}); delete the capture and render it again"
        ) from error


def _line(error: Exception) -> str:
    return " ".join(str(error).split())
