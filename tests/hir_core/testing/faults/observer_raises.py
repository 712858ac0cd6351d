"""Expects a figure that not every stage reports."""

from __future__ import annotations

from typing import Any

from hir_core.plugins import hookimpl


@hookimpl
def hir_stage_finished(stage: str, report: Any) -> None:
    print(stage, report["psnr"])
