"""File names that are valid on every platform."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    pass


def file_stem(name: str) -> str:
    """A file name that every system takes, from any text."""
    return re.sub(r"[^\w.-]+", "_", name).strip("._") or "asset"
