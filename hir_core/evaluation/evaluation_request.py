"""The settings of one evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hir_core.files.file_names import file_stem
from hir_core.files.light_setting import parse_light_file


@dataclass(frozen=True)
class EvaluationRequest:
    """What a run is compared with, and how."""

    split: str = "test"
    capture: Path | None = None
    """Folder of the capture; None for the run's own."""
    relight: str = ""
    """`FILE` or `FILE*STRENGTH`, the light to render under, in place of the split's. It is in the
    axes of the light that the capture names, or in the asset's axes (+Y up) where it names none."""
    renderer: str = ""
    """Name of the reflectance renderer; empty for the reference renderer."""
    options: Mapping[str, Any] | None = None
    """Options of the renderer."""
    device: str = "cpu"
    download: bool = False
    """Download the weights of LPIPS where they are missing."""
    mesh: Path | None = None
    """The true mesh, in the axes of the capture's files."""
    albedo: str = ""
    """Name of a split whose images are the true diffuse albedo."""
    views: int = 0
    """Maximum number of views, evenly spaced over the split; 0 for all."""
    truth: bool = False
    """Compare with every ground truth in the capture: its mesh, the albedo of the split, its light."""

    @property
    def label(self) -> str:
        """Name of the result's folder and of its entry in run.json."""
        if not self.relight:
            return self.split
        return f"{self.split}-{file_stem(parse_light_file(self.relight)[0].stem)}"
