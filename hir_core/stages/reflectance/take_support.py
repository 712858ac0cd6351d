"""What a fit of several takes, each under its own light, cannot be combined with."""

from __future__ import annotations

from collections.abc import Collection

from hir_core.capture import Capture
from hir_core.config import ReflectanceSettings
from hir_core.errors import CaptureError, ConfigError
from hir_core.scene.card_irradiance import measuring_views


def check_takes(capture: Capture, settings: ReflectanceSettings, traits: Collection[str]) -> None:
    """Raises `ConfigError` where settings need one light, `CaptureError` where two takes show the card.

    `traits` are those of the reflectance renderer. Only a solver with the trait `takes` fits several lights; without
    the trait `regularizers`, regularizers act in gradient steps after it.
    """
    if len(capture.takes) < 2:
        return
    fits_takes = {"solver", "takes"} <= set(traits) and settings.method != "gradient"
    if len({capture.take_numbers[view] for view in measuring_views(capture)}) > 1:
        raise CaptureError(f"{capture.path}: photographs of two takes show the card; keep the card in those of one")
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
    if settings.regularizers and "regularizers" not in traits:
        raise ConfigError(
            f"{photographs}, but regularizers act in gradient steps after the solver of {settings.renderer!r}, which "
            "have one light; set reflectance.regularizers={}"
        )
    if settings.path_tracing.iterations:
        raise ConfigError(
            f"{photographs}, but gradient steps by path tracing have one; set reflectance.path_tracing.iterations to 0"
        )
