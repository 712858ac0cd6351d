"""Estimates the memory of each stage before a run starts, and reduces settings until a limit is kept.

The estimates are sums of arrays that exist at the same time; docs/studies/memory_of_300_photographs.md compares
them with measurements.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from hir_core.capture.capture_size import CaptureSize
from hir_core.capture.pixel_cache import DEFAULT_BYTES, PIXEL_BYTES
from hir_core.config import RunConfig
from hir_core.errors import ConfigError, StageError

if TYPE_CHECKING:
    from hir_core.plugins.interfaces import GeometryRenderer, ReflectanceRenderer
    from hir_core.plugins.manager import PluginManager

BASE_PROCESS_BYTES = 1000 << 20
"""Python with torch, Mitsuba, Open3D and SciPy imported and their kernels compiled."""

SECOND_PASS_BYTES = 192 << 20
"""Of photo-consistency beside another pass (`passes_at_once`), at least; spot took 120 to 167 MB more with it."""

DECODED_PIXEL_BYTES = 12 + 4 + 1
"""Bytes of a decoded pixel: float32 colour, float32 mask, saturation."""

MIN_CACHE_BYTES = 64 << 20
MAX_DOWNSAMPLE = 8
MAX_REDUCTIONS = 16
"""Reductions of a component that are tried at once."""


@dataclass(frozen=True)
class MemoryPlan:
    """Settings and caches of a run within a memory limit, and what was changed for it."""

    config: RunConfig
    cache_bytes: int
    stages: Mapping[str, Mapping[str, int]]
    """Estimated bytes: stage → part → bytes."""
    limit: int = 0
    changes: tuple[str, ...] = field(default=())

    def total(self, stage: str) -> int:
        """Estimated bytes of a stage; 0 without an estimate."""
        return sum(self.stages.get(stage, {}).values())

    def sentences(self) -> dict[str, str]:
        """A message for each stage before it starts; empty without a limit."""
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

    The pixel cache is reduced first, then the components' own options, then the resolution of the photographs, down to
    an eighth. Raises `StageError` if that is not enough.
    """
    limit = parse_size(config.max_memory)
    plan = _estimated(config, plugins, size, DEFAULT_BYTES, limit, ())
    while limit and max(plan.total(stage) for stage in plan.stages) > limit:
        smaller = _smaller(plan, plugins, size)
        if smaller is None:
            worst = max(plan.stages, key=plan.total)
            raise StageError(
                f"the {worst} stage needs about {gigabytes(plan.total(worst))}, more than --max-memory "
                f"{config.max_memory} allows, even with all reductions; allow more memory or use fewer photographs"
            )
        plan = smaller
    return plan


def _smaller(plan: MemoryPlan, plugins: PluginManager, size: CaptureSize) -> MemoryPlan | None:
    """A plan with a smaller estimate for the largest stage; None if nothing can be reduced."""
    worst = max(plan.stages, key=plan.total)
    for config, cache, changed_settings in _candidates(plan, plugins, size, worst):
        changed = _estimated(config, plugins, size, cache, plan.limit, _with(plan.changes, changed_settings))
        if changed.total(worst) < plan.total(worst):
            return changed
    return None


def _candidates(
    plan: MemoryPlan, plugins: PluginManager, size: CaptureSize, worst: str
) -> Iterator[tuple[RunConfig, int, dict[str, str]]]:
    """Settings, bytes of the pixel cache, and what changed; the least harmful change first."""
    config, used = plan.config, min(plan.cache_bytes, size.pixels * PIXEL_BYTES)
    cache = max(MIN_CACHE_BYTES, used - (plan.total(worst) - plan.limit))
    if cache < used:
        yield config, cache, {"cache of decoded photographs": gigabytes(cache)}
    if worst == "reflectance":
        name, changed, options = config.reflectance.renderer, config, dict[str, int]()
        for _ in range(MAX_REDUCTIONS):  # one reduction alone may leave the largest part as it is
            smaller = dict(_reflectance_renderer(changed, plugins).smaller())
            if not smaller:
                break
            options |= smaller
            table = changed.reflectance_renderer.get(name, {}) | options
            changed = replace(changed, reflectance_renderer=changed.reflectance_renderer | {name: table})
            yield changed, plan.cache_bytes, {f"reflectance_renderer.{name}.{k}": str(v) for k, v in options.items()}
    if worst == "geometry" and config.geometry.views_per_step > 1:
        fewer = replace(config.geometry, views_per_step=config.geometry.views_per_step // 2)
        yield replace(config, geometry=fewer), plan.cache_bytes, {"geometry.views_per_step": str(fewer.views_per_step)}
    if worst in ("geometry", "reflectance"):
        settings = getattr(config, worst)
        if settings.downsample * 2 <= MAX_DOWNSAMPLE:
            coarser = replace(settings, downsample=settings.downsample * 2)
            yield (
                replace(config, **{worst: coarser}),
                plan.cache_bytes,
                {f"{worst}.downsample": str(coarser.downsample)},
            )


def _with(changes: tuple[str, ...], new: Mapping[str, str]) -> tuple[str, ...]:
    """The changes with new ones; each replaces an earlier change of the same setting."""
    return (*(c for c in changes if c.partition("=")[0] not in new), *(f"{key}={value}" for key, value in new.items()))


def _estimated(
    config: RunConfig, plugins: PluginManager, size: CaptureSize, cache: int, limit: int, changes: tuple[str, ...]
) -> MemoryPlan:
    cached = min(cache, size.pixels * PIXEL_BYTES)
    common = {"program": BASE_PROCESS_BYTES, "photographs": cached}
    picture = 8 * size.width * size.height * DECODED_PIXEL_BYTES
    stages: dict[str, dict[str, int]] = {
        # a distance field and a mask for each view, and one picture in work
        "initializer": common | {"fields": size.pixels * 5, "picture": picture},
        "atlas": dict(common),
        "bake": dict(common),
        "export": dict(common),
    }
    if config.geometry.enabled:
        renderer: GeometryRenderer = plugins.create(
            "geometry_renderer", config.geometry.renderer, config.geometry_renderer.get(config.geometry.renderer, {})
        )
        shrunk = _downsampled(size, config.geometry.downsample)
        details = min(shrunk.pixels * 7, 512 << 20) if config.geometry.photo_consistency == "auto" else 0
        targets = renderer.memory(shrunk, config.geometry.views_per_step)
        # two passes are fitted, and before them the details of two photographs computed, at the same time
        second = max(SECOND_PASS_BYTES, picture) if config.geometry.photo_consistency == "auto" else 0
        stages["geometry"] = common | {"masks": targets, "details": details, "second": second}
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
