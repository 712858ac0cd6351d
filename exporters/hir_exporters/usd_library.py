"""The library of the USD formats, which is an extra: `pip install 'hir[usd]'`."""

from __future__ import annotations

from importlib.util import find_spec

from hir_exporters.errors import HirError


def require_usd(subject: object, error: type[HirError]) -> None:
    """Raises `error` where usd-core is not installed. `subject` is what needs it, such as a file."""
    if find_spec("pxr") is None:
        raise error(f"{subject}: USD files need usd-core; install it with: pip install 'hir[usd]'")
