"""What a fit of several takes, each under its own light, cannot be combined with."""

from __future__ import annotations

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.errors import ConfigError


def check_takes(capture: Capture, settings: ReflectanceSettings, fits_takes: bool) -> None:
    """Raises `ConfigError` where the settings need one light.

    `fits_takes`: the fit is that of a solver with the trait `takes`.
    """
    if len(capture.takes) < 2:
        return
    names = ", ".join(repr(name) for name in capture.takes)
    photographs = f"the photographs have {len(capture.takes)} takes ({names}), each under its own light"
    if not fits_takes:
        raise ConfigError(
            f"{photographs}, but the fit of {settings.renderer!r} has one light; use reflectance.method=auto and a "
            "reflectance.renderer with the trait 'takes', or the photographs of one take"
        )
    if settings.known_environment:
        raise ConfigError(
            f"{photographs}, but reflectance.known_environment names one; leave it out, or use the photographs of the "
            "take that it lit"
        )
    if settings.path_tracing.iterations:
        raise ConfigError(
            f"{photographs}, but gradient steps by path tracing have one; set reflectance.path_tracing.iterations to 0"
        )
