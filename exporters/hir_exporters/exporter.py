"""The base class of file formats, and what an export reports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

from hir_exporters.asset import Asset

Edit: TypeAlias = Callable[[Any, Asset], None]
"""Changes a finished document in place before it becomes bytes: a `pygltflib.GLTF2` or a `pxr.Usd.Stage`."""


@dataclass(frozen=True)
class ExportReport:
    """What an export wrote and what it could not express."""

    files: tuple[Path, ...]
    """The file asked for first, then its siblings."""
    warnings: tuple[str, ...] = ()
    """One sentence each."""
    residuals: Mapping[str, float] = field(default_factory=dict)
    """Errors of the material conversion, computed from the values written
    (`hir_exporters.materials.material_conversion`)."""
    seconds: float = 0.0


class Exporter(ABC):
    """Writes assets in one format; built from the format's frozen dataclass config."""

    @abstractmethod
    def write(self, asset: Asset, destination: Path, edit: Edit | None = None) -> ExportReport:
        """Write `destination` (and siblings beside it), completely or not at all.

        The bytes are a pure function of the asset, the config and `edit`. Raises `InputError` for an asset that cannot
        be written and `ExportError` for a destination that cannot.
        """
