"""Which device a run computes on."""

from __future__ import annotations

from hir_core.errors import ConfigError


def resolve_device(device: str) -> str:
    """`cpu` or `cuda`: what `auto` means here; an error where CUDA is requested and not available."""
    import torch

    if device not in ("auto", "cpu", "cuda"):
        raise ConfigError(f"device {device!r} is not known; it is auto, cpu or cuda")
    if device == "auto":
        return "cuda" if torch.cuda.is_available() else "cpu"
    if device == "cuda" and not torch.cuda.is_available():
        raise ConfigError(
            "device cuda: torch finds no CUDA device; use --device cpu (`hir doctor` lists what is found)"
        )
    return device
