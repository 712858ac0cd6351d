"""Where the scale between albedo and light comes from: photographs of the object alone do not show it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

from hir_core.capture import Capture
from hir_core.scene import Scene
from hir_core.scene.card_irradiance import measured_over_found, measuring_views

MAX_DISAGREEMENT = 0.15
"""Of the fitted light and the card, as a fraction, above which a warning says so."""


@dataclass(frozen=True)
class LightScaleReport:
    """Which observation fixes the scale, and how well the light agrees with it."""

    source: Literal["assumed", "card", "known light"]
    sentence: str
    """All of it in words."""
    card_views: int = 0
    """Photographs that show the card."""
    card_deviation: float | None = None
    """Standard deviation of the card's irradiance over photographs, as a fraction."""
    found_over_measured: tuple[float, float, float] | None = None
    """Irradiance of the light on the card over the measured one, by channel."""


ASSUMED = LightScaleReport("assumed", "assumed, because photographs of the object alone do not show it")

UNDER_LAMP = LightScaleReport(
    "assumed", "assumed, because the lamp near the camera lit the card from another place in each photograph"
)


def light_scale_report(fitted: Scene, capture: Capture, light_is_known: bool) -> LightScaleReport:
    """The source of the scale, and the fitted light beside the card if there is one."""
    source: Literal["card", "known light"] = "known light" if light_is_known else "card"
    shown = len(measuring_views(capture))
    if shown and fitted.environment is not None and fitted.environment.lamp is not None:
        return LightScaleReport(source, "from the known light") if light_is_known else UNDER_LAMP
    if capture.irradiance is None or not shown or fitted.environment is None:
        return LightScaleReport(source, "from the known light") if light_is_known else ASSUMED
    light = fitted.in_take(capture.views[measuring_views(capture)[0]].take).environment
    assert light is not None
    red, green, blue = (round(1 / float(each), 4) for each in measured_over_found(light, capture))
    deviation = capture.irradiance.relative_deviation
    worst = max(abs(each - 1) for each in (red, green, blue))
    sentence = (
        f"from the {source}; the light agrees to {worst:.1%} with the card in {shown} photographs, which differ by "
        f"{deviation:.1%}"
    )
    return LightScaleReport(source, sentence, shown, round(deviation, 4), (red, green, blue))


def disagreement_warning(report: LightScaleReport) -> str | None:
    """One sentence where light and card contradict each other."""
    ratio = report.found_over_measured
    if ratio is None or max(abs(math.log(each)) for each in ratio if each > 0) <= math.log(1 + MAX_DISAGREEMENT):
        return None
    return (
        f"the light brings the card {', '.join(f'{each:.2f}' for each in ratio)} times the measured irradiance (red, "
        "green, blue): photograph the card beside the object, facing up, without shadow or gloss, and set "
        "initializer.fiducial_markers.paper_reflectance to that of its paper (for a ColorChecker: "
        "initializer.color_checker.reflectance_factor)"
    )
