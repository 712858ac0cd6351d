"""Packages that commands need beyond the base install."""

from __future__ import annotations


def require_reconstruction_packages(command: str) -> None:
    """Raises `MissingExtraError`, which names the command, where the packages of hir[reconstruct] are not installed."""
    from importlib.util import find_spec

    from hir_core.errors import MissingExtraError

    missing = [name for name in ("torch", "jaxtyping", "scipy") if find_spec(name) is None]
    if missing:
        raise MissingExtraError(
            f"{command} needs {', '.join(missing)}; install it with: "
            "pip install 'hir[reconstruct]' (in a checkout: pip install -e '.[reconstruct]')"
        )
