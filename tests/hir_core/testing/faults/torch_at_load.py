"""Imports torch where only descriptors belong."""

from __future__ import annotations

import torch

from hir_core.plugins import Component, hookimpl
from tests.hir_core.testing.faults.sound import Dispersion, descriptor


class Term(Dispersion):
    dtype = torch.float32


@hookimpl
def hir_register_regularizers() -> list[Component]:
    return [descriptor(f"{__name__}:Term", requires=("torch",))]
