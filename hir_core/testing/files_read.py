"""Files that a component says it reads, so that a change of one of them invalidates the cache."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from hir_core.plugins.registration import a_value
from hir_core.testing.contract import BrokenContract, require


def require_files(returned: object) -> None:
    """`files` returned paths of files that are there."""
    if isinstance(returned, str) or not isinstance(returned, Sequence):
        raise BrokenContract(f"files() returns {a_value(returned)}; return a list of paths, empty where it reads none")
    other = next((path for path in returned if not isinstance(path, Path)), None)
    require(other is None, f"files() returns {a_value(other)} among its paths; write Path(…)")
    missing = [str(path) for path in returned if not path.is_file()]
    require(not missing, f"files() names {', '.join(missing)}, which is no file; leave out what is not there")
