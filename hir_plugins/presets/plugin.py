"""The built-in presets."""

from __future__ import annotations

from pathlib import Path

from hir_core.plugins import hookimpl


@hookimpl
def hir_register_presets() -> dict[str, Path]:
    folder = Path(__file__).parent
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}
