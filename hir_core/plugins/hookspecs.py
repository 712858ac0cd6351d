"""Every hook of `hir`. Hooks run at start-up and at stage boundaries, never in an inner loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pluggy

from hir_core.plugins.component import Component

if TYPE_CHECKING:
    import click
    from hir_exporters.asset import Asset

    from hir_core.capture import Capture
    from hir_core.plugins.progress import Progress
    from hir_core.scene import Scene

hookspec = pluggy.HookspecMarker("hir")


@hookspec
def hir_register_capture_readers() -> Sequence[Component]:
    """Formats of captures: each a `CaptureReader`."""


@hookspec
def hir_register_mask_sources() -> Sequence[Component]:
    """Ways to separate the object from its background: each a `MaskSource`."""


@hookspec
def hir_register_initializers() -> Sequence[Component]:
    """Ways to cameras, points and a first mesh: each an `Initializer`."""


@hookspec
def hir_register_geometry_renderers() -> Sequence[Component]:
    """Differentiable silhouettes: each a `GeometryRenderer`."""


@hookspec
def hir_register_reflectance_renderers() -> Sequence[Component]:
    """Differentiable shading: each a `ReflectanceRenderer`."""


@hookspec
def hir_register_regularizers() -> Sequence[Component]:
    """Terms added to a stage's loss: each a `Regularizer`."""


@hookspec
def hir_register_exporters() -> Sequence[Component]:
    """File formats, one component for each `-f` name: each an `Exporter` of `hir_exporters`."""


@hookspec
def hir_register_presets() -> Mapping[str, Path]:
    """Presets: a name and the TOML file that holds its settings."""


@hookspec
def hir_register_observers() -> Mapping[str, type]:
    """Observers: a name and the frozen dataclass of its options; a table `observers.<name>` switches one on.

    The observer itself is the plugin's `hir_run_started`, `hir_progress` and `hir_stage_finished`, which find their
    table in `config.observers`.
    """


@hookspec(firstresult=True)
def hir_suggest_initializers(capture: Capture) -> Sequence[str] | None:
    """Names the chain of initializers that suits a capture; asked only when `initializers = "auto"`."""


@hookspec
def hir_run_started(config: Any, run_folder: Path) -> None:
    """A run begins; its directory exists."""


@hookspec
def hir_progress(progress: Progress) -> None:
    """A block of scalars of the running stage; at most four times a second and once at the end of a stage."""


@hookspec
def hir_stage_finished(stage: str, scene: Scene | None, report: Mapping[str, Any]) -> None:
    """A stage wrote its result."""


@hookspec
def hir_gltf_document(document: Any, asset: Asset) -> None:
    """Last step before the bytes of a glTF file: change the `pygltflib.GLTF2` document in place."""


@hookspec
def hir_usd_stage(stage: Any, asset: Asset) -> None:
    """Last step before the bytes of a USD file: change the `pxr.Usd.Stage` in place."""


@hookspec
def hir_register_commands(cli: click.Group) -> None:
    """Adds `hir <command>`."""


@hookspec(firstresult=True)
def hir_asset_page(run_folder: Path) -> str | None:
    """A self-contained HTML page that shows the finished asset of a run; the report embeds the first one offered."""
