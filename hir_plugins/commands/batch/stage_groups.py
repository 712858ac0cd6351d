"""The groups of stages that a batch runs as one task each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from hir_core.run.run_directory import STAGE_NAMES


@dataclass(frozen=True)
class StageGroup:
    """Stages that one task runs one after the other."""

    name: str
    stages: tuple[str, ...]

    @property
    def last_stage(self) -> str:
        return self.stages[-1]


STAGE_GROUPS: Final = (
    StageGroup("initialization", ("initializer",)),
    StageGroup("geometry", ("geometry",)),
    StageGroup("reflectance", ("atlas", "reflectance")),
    StageGroup("export", ("bake", "export")),
)
"""In the order of a run; a capture is one task for each."""
assert tuple(stage for group in STAGE_GROUPS for stage in group.stages) == STAGE_NAMES

GPU_GROUPS: Final = ("geometry", "reflectance")
"""The groups that `--gpus` applies to; the others compute on the CPU."""
