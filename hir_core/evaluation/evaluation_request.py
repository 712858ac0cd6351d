"""What an evaluation is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    pass


@dataclass(frozen=True)
class Question:
    """What is compared with what."""

    split: str = "test"
    capture: Path | None = None
    """The run's own where it is None."""
    relight: str = ""
    """`FILE` or `FILE*STRENGTH`, in the capture's axes; replaces the light."""
    renderer: str = ""
    """Reflectance renderer; the reference one where it is empty."""
    options: dict[str, Any] | None = None
    """Options of the renderer."""
    device: str = "cpu"
    download: bool = False
    """Fetch LPIPS's weights where they are missing."""
    mesh: Path | None = None
    """The true mesh, in the axes of the capture's own files."""
    albedo: str = ""
    """A split of the true diffuse albedo."""
    views: int = 0
    """At most so many views, spread over the split; 0 takes all."""
    truth: bool = False
    """Compare with all the truth that lies in the capture: its mesh, the split's albedo, its light."""
