"""The base class of exporters, and the report of an export."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from hir_exporters.asset import Asset
from hir_exporters.errors import ExportError

Edit: TypeAlias = Callable[[Any, Asset], None]
"""Changes a finished document (a `pygltflib.GLTF2` or a `pxr.Usd.Stage`) in place before it is serialised.

`Any`: the type of the document depends on the format, and neither library has type information.
"""


@dataclass(frozen=True)
class ExportReport:
    """The files that an export wrote, its warnings and the error of its material conversion."""

    files: tuple[Path, ...]
    """The destination first, then the files beside it."""
    warnings: tuple[str, ...] = ()
    """One sentence each."""
    residuals: Mapping[str, float] = field(default_factory=dict)
    """Relative error of the material conversion by profile, computed from the converted values
    (`hir_exporters.materials.material_conversion`)."""
    seconds: float = 0.0


def companion_file(destination: Path, name: str) -> Path:
    """A file beside the destination that no other format writes: `a.gltf` and `color.png` give `a_gltf_color.png`."""
    return destination.with_name(f"{destination.stem}_{destination.suffix.removeprefix('.')}_{name}")


def shared_names(stem: str) -> tuple[str, str]:
    """Names that all formats of one asset give to its light and its picture."""
    return f"{stem}.hdr", f"{stem}_thumbnail.png"


def check_file_name(destination: Path, suffix: str) -> Path:
    """The destination as a path. Raises `ExportError` where its name does not end with the suffix of the format."""
    destination = Path(destination)
    if not destination.name.lower().endswith(suffix):
        raise ExportError(f"{destination} is not a file name of this format; it must end with {suffix}")
    return destination


class Exporter(ABC):
    """Writes assets in one format. Constructed from the format's options, a frozen dataclass."""

    @abstractmethod
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        """Writes `destination`, and further files beside it. Each file is written completely or not at all.

        The bytes depend on the asset, the options and `edit` only. Raises `InputError` for an invalid asset and
        `ExportError` where the asset cannot be expressed in the format or the destination cannot be written.
        """
