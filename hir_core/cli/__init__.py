"""The command line: `hir …`. Each command imports what it needs when it runs."""

from __future__ import annotations

from hir_core.cli.app import cli, main

__all__ = ["cli", "main"]
