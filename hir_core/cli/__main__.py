"""`python -m hir_core.cli`, where the script `hir` is not on the path."""

from __future__ import annotations

from hir_core.cli.app import main

main()
