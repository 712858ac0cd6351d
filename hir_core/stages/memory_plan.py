"""How much memory the stages of a run take, estimated before they start, and settings that stay within a limit.

The estimates are sums of the arrays that live at the same time; docs/reliability.md compares them with what was
measured.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from hir_core.capture.capture_size import CaptureSize
from hir_core.capture.pixel_cache import DEFAULT_BYTES
from hir_core.config import RunConfig
from hir_core.errors import ConfigError, StageError

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import GeometryRenderer, ReflectanceRenderer
    from hir_core.plugins.manager import PluginManager

BASE_BYTES = 800 << 20
"""Python with torch, Mitsuba, Open3D and SciPy imported, and their compilers warm."""

DECODED = 12 + 4 + 1
"""Bytes of a pixel of a photograph: float32 colour, float32 mask, saturation."""

LEAST_CACHE = 64 << 20
MOST_DOWNSAMPLE = 8


@dataclass(frozen=True)
class MemoryPlan:
    """What a run may use, and what was changed to stay within a limit."""

    config: RunConfig
    cache_bytes: int
    stages: Mapping[str, Mapping[str, int]]
    """Estimated bytes of each stage, part by part."""
    limit: int = 0
    changes: tuple[str, ...] = field(default=())

    def total(self, stage: str) -> int:
        """Estimate of a stage; 0 where there is none."""
        return sum(self.stages.get(stage, {}).values())

    def sentences(self) -> dict[str, str]:
        """What is said before each stage starts; empty without a limit."""
        if not self.limit:
            return {}
        return {s: f"about {gigabytes(self.total(s))} of memory expected" for s in self.stages if self.total(s)}

    def document(self) -> dict[str, Any]:
        """For run.json; empty without a limit."""
        if not self.limit:
            return {}
        return {
            "limit_bytes": self.limit,
            "estimated_bytes": {stage: self.total(stage) for stage in self.stages},
            "changes": list(self.changes),
        }


def parse_size(text: str) -> int:
    """Bytes of `4GB` (10⁹), `4GiB` (2³⁰), `800MB`; 0 for an empty text."""
    from pydantic import ByteSize, TypeAdapter, ValidationError

    if not text.strip():
        return 0
    try:
        size = int(TypeAdapter(ByteSize).validate_python(text))
    except (ValidationError, OverflowError, ValueError):
        size = 0
    if size <= 0 or not re.search(r"[a-zA-Z]\s*$", text):  # a bare number is more likely a slip than bytes
        raise ConfigError(f"max_memory is {text!r}; write it as 4GB or 800MB")
    return size


def plan_memory(config: RunConfig, plugins: PluginManager, size: CaptureSize) -> MemoryPlan:
    """Settings under which no stage is expected to exceed `config.max_memory`; without one, the settings as they are.

    First the cache of photographs shrinks, then what components say can, then the photographs are taken at a half, a
    quarter, an eighth of their resolution. Raises `StageError` where even that does not fit.
    """
    limit = parse_size(config.max_memory)
    plan = _estimated(config, plugins, size, DEFAULT_BYTES, limit, ())
    while limit and max(plan.total(stage) for stage in plan.stages) > limit:
        smaller = _smaller(plan, plugins, size)
        if smaller is None:
            worst = max(plan.stages, key=plan.total)
            raise StageError(
                f"the {worst} stage needs about {gigabytes(plan.total(worst))}, more than --max-memory "
                f"{config.max_memory} allows even with all that can shrink; allow more or take fewer photographs"
            )
        plan = smaller
    return plan


def _smaller(plan: MemoryPlan, plugins: PluginManager, size: CaptureSize) -> MemoryPlan | None:
    """The next plan under which the largest stage takes less; None where nothing is left to shrink."""
    worst = max(plan.stages, key=plan.total)
    for config, cache, said in _candidates(plan, plugins, size, worst):
        changed = _estimated(config, plugins, size, cache, plan.limit, _with(plan.changes, said))
        if changed.total(worst) < plan.total(worst):
            return changed
    return None


def _candidates(
    plan: MemoryPlan, plugins: PluginManager, size: CaptureSize, worst: str
) -> Iterator[tuple[RunConfig, int, str]]:
    """Settings, bytes of the cache, and what is said of the change, gentlest first."""
    config, used = plan.config, min(plan.cache_bytes, size.pixels * DECODED)
    cache = max(LEAST_CACHE, used - (plan.total(worst) - plan.limit))
    if cache < used:
        yield config, cache, f"cache of decoded photographs={gigabytes(cache)}"
    if worst == "reflectance":
        name = config.reflectance.renderer
        if options := dict(_reflectance_renderer(config, plugins).smaller()):
            table = config.reflectance_renderer.get(name, {}) | options
            said = ", ".join(f"reflectance_renderer.{name}.{key}={value}" for key, value in options.items())
            yield (
                replace(config, reflectance_renderer=config.reflectance_renderer | {name: table}),
                plan.cache_bytes,
                said,
            )
    if worst == "geometry" and config.geometry.views_per_step > 1:
        fewer = replace(config.geometry, views_per_step=config.geometry.views_per_step // 2)
        yield replace(config, geometry=fewer), plan.cache_bytes, f"geometry.views_per_step={fewer.views_per_step}"
    if worst in ("geometry", "reflectance"):
        settings = getattr(config, worst)
        if settings.downsample * 2 <= MOST_DOWNSAMPLE:
            coarser = replace(settings, downsample=settings.downsample * 2)
            yield replace(config, **{worst: coarser}), plan.cache_bytes, f"{worst}.downsample={coarser.downsample}"


def _with(changes: tuple[str, ...], said: str) -> tuple[str, ...]:
    """Changes with a new one, in the place of an older one of the same settings."""
    about = said.partition("=")[0]
    return (*(c for c in changes if c.partition("=")[0] != about), said)


def _estimated(
    config: RunConfig, plugins: PluginManager, size: CaptureSize, cache: int, limit: int, changes: tuple[str, ...]
) -> MemoryPlan:
    cached = min(cache, size.pixels * DECODED)
    common = {"program": BASE_BYTES, "photographs": cached}
    stages: dict[str, dict[str, int]] = {
        # a field of distances and a mask for each view, and one picture under work
        "initializer": common | {"fields": size.pixels * 5, "picture": 8 * size.width * size.height * DECODED},
        "atlas": dict(common),
        "bake": dict(common),
        "export": dict(common),
    }
    if config.geometry.enabled:
        renderer: GeometryRenderer = plugins.create(
            "geometry_renderer", config.geometry.renderer, config.geometry_renderer.get(config.geometry.renderer, {})
        )
        shrunk = _downsampled(size, config.geometry.downsample)
        details = min(shrunk.pixels * 7, 512 << 20) if config.geometry.photographs == "auto" else 0
        targets = renderer.memory(shrunk, config.geometry.views_per_step)
        stages["geometry"] = common | {"masks": targets, "details": details}
    if config.reflectance.enabled:
        shrunk = _downsampled(size, config.reflectance.downsample)
        stages["reflectance"] = common | {"fit": _reflectance_renderer(config, plugins).memory(shrunk)}
    return MemoryPlan(config, cache, stages, limit, changes)


def _reflectance_renderer(config: RunConfig, plugins: PluginManager) -> ReflectanceRenderer:
    name = config.reflectance.renderer
    renderer: ReflectanceRenderer = plugins.create(
        "reflectance_renderer", name, config.reflectance_renderer.get(name, {})
    )
    return renderer


def _downsampled(size: CaptureSize, factor: int) -> CaptureSize:
    return CaptureSize(size.views, size.width // factor, size.height // factor)


def gigabytes(count: int) -> str:
    """Such as `1.5 GB`, of 10⁹ bytes."""
    return f"{count / 1e9:.2g} GB"
