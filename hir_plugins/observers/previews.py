"""Observer: preview images of the scene after each stage, to inspect a run in progress."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from hir_core.plugins import hookimpl
from hir_core.plugins.options import build_options
from hir_plugins.observers.options import PreviewsOptions

if TYPE_CHECKING:
    from hir_core.config import RunConfig
    from hir_core.scene import Scene

NAME = "previews"


class PreviewsObserver:
    """Writes `RUN/previews/<stage>.png` if the settings have a table `observers.previews`."""

    def __init__(self) -> None:
        self._folder: Path | None = None
        self._options = PreviewsOptions()

    @hookimpl
    def hir_register_observers(self) -> Mapping[str, type]:
        return {NAME: PreviewsOptions}

    @hookimpl
    def hir_run_started(self, config: RunConfig, run_folder: Path) -> None:
        table = config.observers.get(NAME, False)
        self._folder = None if table is False else run_folder / NAME
        if table is not False:
            self._options = build_options(PreviewsOptions, table, "observer 'previews'")

    @hookimpl
    def hir_stage_finished(self, stage: str, scene: Scene | None, report: Mapping[str, object]) -> None:
        if self._folder is None or scene is None or not len(scene.mesh.faces):
            return
        from hir_exporters.textures.image_files import write_png

        from hir_plugins.observers.preview_pictures import preview_strip

        write_png(self._folder / f"{stage}.png", preview_strip(scene, self._options.size, self._options.sides))
