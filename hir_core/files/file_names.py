"""File names that are valid on every platform."""

from __future__ import annotations

import re


def file_stem(name: str) -> str:
    """A file name that is valid on all systems, from any text."""
    return re.sub(r"[^\w.-]+", "_", name).strip("._") or "asset"
