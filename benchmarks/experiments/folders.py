"""Folders of the studies: their captures and their results."""

from __future__ import annotations

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
WORK = Path(os.environ.get("HIR_EXPERIMENTS", ROOT / "build" / "experiments"))
"""Captures and runs; they are large and can be recreated."""


def shared() -> Path:
    """The folder of captures and models."""
    return Path(os.environ.get("HIR_SHARED", ROOT.parent / "shared"))
