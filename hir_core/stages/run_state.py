"""What a run knows between two stages: the capture, the settings, and the results so far. Replaced, never changed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.capture import Capture, CoordinateFrames
from hir_core.capture.pixel_cache import PixelCache
from hir_core.config import RunConfig
from hir_core.plugins.manager import PluginManager
from hir_core.run.run_directory import RunDirectory

if TYPE_CHECKING:
    from hir_exporters.asset import Asset
    from torch import Tensor

    from hir_core.scene import Scene


@dataclass(frozen=True)
class CaptureSource:
    """Where the photographs came from."""

    path: Path
    name: str
    """Of the asset and its files."""
    fingerprint: str
    """Hash of all that a fit may look at."""
    view_names: tuple[str, ...]
    """All photographs, those without a camera included."""


@dataclass(frozen=True)
class RunState:
    """Inputs of a run, and the value of each stage that has run."""

    config: RunConfig
    """Final settings: the memory plan is applied and the chain of initializers is resolved."""
    plugins: PluginManager
    directory: RunDirectory
    device: str
    source: CaptureSource
    photographs: PixelCache
    capture: Capture
    """In the capture's own frame before the initializer stage, in the working frame after it."""
    frames: CoordinateFrames | None = None
    """From the initializer stage."""
    scan_file: str = ""
    """Name of the file that the initializer stage's mesh was read from, for messages; empty where it made the mesh."""
    scene: Scene | None = None
    """The latest scene, in the working frame."""
    unchanged_scene: Scene | None = None
    """From the initializer stage: before the first initializer with the trait `revises_mesh`; None where none of them
    changed the mesh."""
    silhouette_positions: Tensor | None = None
    """From the geometry stage: the vertices (V, 3) before photo-consistency moved them; None where it did not."""
    bounces: int | None = None
    """From the reflectance stage: reflections between parts of the object in the chosen model; None: not modelled."""
    asset: Asset | None = None
    """From the bake stage."""
