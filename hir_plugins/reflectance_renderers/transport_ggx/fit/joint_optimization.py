"""Light and material fitted together on cached transport: a few hundred noise-free steps of Adam, then closed form.

Albedos, ρs and α live at the vertices of the refined surface (or are one value for all), the light in texels of its
logarithm. Textures are solved afterwards at their own resolution (`textures.py`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Literal

import torch
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.errors import StageError
from hir_core.optimization.optimization_loop import PATIENCE_NONFINITE
from hir_plugins.reflectance_renderers.brdf_torch import Model
from hir_plugins.reflectance_renderers.transport_ggx.fit.final_albedo import with_solved_albedo
from hir_plugins.reflectance_renderers.transport_ggx.fit.fit_checkpoints import FitFile, Loop
from hir_plugins.reflectance_renderers.transport_ggx.fit.mini_batches import Stream
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.fit.pixel_batches import (
    Block,
    at_pixels,
    exposed,
    in_lobes,
    predict,
    refresh,
    residual,
    specular_blocks,
)
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_radiance import SpecularBlock

REDRAW = 1.5
"""Lobes are drawn anew when α has moved by this factor."""

TILTED = 1.0
"""Lobes are drawn anew when normals have turned by this many of their widths."""

ALBEDO_NOISE = 0.02
"""Differences of log albedo between neighbours below this cost little: no edge, but noise and slow change."""


@dataclass(frozen=True)
class FitSettings:
    """How the unknowns are moved."""

    steps: int
    model: Model | Literal["diffuse"]
    bounces: int
    light_rate: float = 0.08
    diffuse_rate: float = 0.06
    specular_rate: float = 0.05
    width_rate: float = 0.08
    gain_rate: float = 0.02
    tilt_rate: float = 0.03
    width_hold: float = 0.7
    """Share of the steps before α moves: under a flat light every lobe would widen, under a blurred one narrow."""
    refresh: int = 15
    """Steps between updates of the lobes to the current α."""
    light_smoothness: float = 1e-4
    light_whiteness: float = 1e-3
    albedo_smoothness: float = 1e-3
    map_smoothness: float = 3e-3
    tilt_smoothness: float = 1e-3
    tilt_hold: float = 1e-4
    """On normals that leave the mesh's."""
    huber: float = 0.1
    known_light: bool = False
    solve_albedo: bool = True
    """End with the albedos in closed form."""


def fit(
    transport: Transport,
    stream: Stream,
    start: Unknowns,
    settings: FitSettings,
    edges: Int[Tensor, "E 2"],
    on_step: Callable[[int, float], None],
    file: FitFile | None = None,
) -> Unknowns:
    """Runs Adam with a cosine schedule over blocks in turn, drawn again when α moved far; those that memory does not
    hold at once are drawn in turns, one between two updates of the lobes.

    With `file` the state is kept there and gone on from. A step without a finite gradient is skipped and told with its
    term and views; `PATIENCE_NONFINITE` of them in a row raise `StageError`.
    """
    unknowns = _leaves(start.detached(), settings)
    groups = [
        {"params": [p], "lr": rate}
        for p, rate in (
            (unknowns.light, settings.light_rate),
            (unknowns.diffuse, settings.diffuse_rate),
            (unknowns.specular, settings.specular_rate),
            (unknowns.width, settings.width_rate),
            (unknowns.gain, settings.gain_rate),
            (unknowns.tilt, settings.tilt_rate),
        )
        if p is not None and p.requires_grad
    ]
    optimizer = torch.optim.Adam(groups, betas=(0.9, 0.99))
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(settings.steps, 1))
    loop = Loop(optimizer, schedule, start.detached())
    if file is not None:
        file.restore(loop)
    blocks = stream.draw(loop.drawn, 0) if stream.turns == 1 else []
    specular = specular_blocks(blocks, settings.model)
    trouble, in_a_row = "", 0
    for step in range(loop.step, settings.steps):
        if step % settings.refresh == 0:
            if file is not None and not in_a_row:
                loop.step = step
                file.save(loop)
            if stream.turns > 1 or _drifted(blocks[0], unknowns):
                loop.drawn = unknowns.detached()
                blocks, specular = [], []  # the old ones go before there are new ones: each takes gigabytes
                blocks = stream.draw(loop.drawn, step // settings.refresh)
                specular = specular_blocks(blocks, settings.model)
            refresh(blocks, specular, unknowns)
        index = step % len(blocks)
        optimizer.zero_grad()
        loss, difference, smoothness = _descend(transport, blocks[index], specular[index], unknowns, settings, edges)
        if unknowns.width is not None and step < settings.width_hold * settings.steps:
            unknowns.width.grad = None
        if not _finite(optimizer):
            loop.skipped, in_a_row = loop.skipped + 1, in_a_row + 1
            trouble = trouble or f"step {step}: {_trouble(blocks[index], difference, smoothness, unknowns)}"
            if in_a_row >= PATIENCE_NONFINITE:
                raise StageError(
                    f"the {settings.model} fit had no finite gradient in {in_a_row} steps in a row ({trouble}); "
                    "look for broken pixels or triangles with: hir check"
                )
            continue
        in_a_row = 0
        optimizer.step()
        schedule.step()
        on_step(step, float(loss))
    if loop.skipped:
        warnings.warn(
            f"{loop.skipped} of {settings.steps} steps of the {settings.model} fit had no finite gradient and were "
            f"skipped ({trouble}); look for broken pixels or triangles with: hir check",
            stacklevel=2,
        )
    found = unknowns.detached()
    if not settings.solve_albedo:
        return found
    if stream.turns > 1:
        del blocks, specular
        return with_solved_albedo(transport, stream.each(found, settings.model), found, settings.bounces)
    refresh(blocks, specular, found)
    return with_solved_albedo(transport, zip(blocks, specular, strict=True), found, settings.bounces)


def _descend(
    transport: Transport,
    block: Block,
    specular: SpecularBlock | None,
    unknowns: Unknowns,
    settings: FitSettings,
    edges: Tensor,
) -> tuple[Tensor, Tensor, Tensor]:
    """Leaves gradients; loss, difference to the photographs and smoothness without their graph, which holds lobes."""
    radiance = predict(transport, block, specular, unknowns, settings.bounces)
    difference = residual(block, exposed(block, radiance, unknowns))
    loss = torch.nn.functional.huber_loss(difference, torch.zeros_like(difference), delta=settings.huber)
    smoothness = _smoothness(unknowns, settings, edges)
    (loss + smoothness).backward()
    return loss.detach(), difference.detach(), smoothness.detach()


def _trouble(block: Block, difference: Tensor, smoothness: Tensor, unknowns: Unknowns) -> str:
    """Which term is not finite, in which views, or which unknown's gradient."""
    if not bool(torch.isfinite(smoothness)):
        return "the smoothness is not finite"
    bad = ~torch.isfinite(difference).all(dim=1)
    if bool(bad.any()):
        views = block.view[bad].unique().tolist()
        return f"the difference to the photographs is not finite in {int(bad.sum())} pixels of views {views}"
    named = {field.name: getattr(unknowns, field.name) for field in fields(unknowns)}
    broken = [n for n, v in named.items() if v is not None and v.grad is not None and not torch.isfinite(v.grad).all()]
    return f"the gradient of {' and '.join(broken)} is not finite"


def _drifted(block: Block, unknowns: Unknowns) -> bool:
    if block.lobes is None or unknowns.width is None:
        return False
    with torch.no_grad():
        normal = in_lobes(block, unknowns.tilt)
        if normal is not None and float((normal[:, :2].norm(dim=1) / block.lobes.drawn_alpha[:, 0]).mean()) > TILTED:
            return True
        ratio = (at_pixels(block, unknowns.alpha) / block.lobes.drawn_alpha).log().abs().mean()
    return float(ratio) > math.log(REDRAW)


def _leaves(unknowns: Unknowns, settings: FitSettings) -> Unknowns:
    for value in (unknowns.diffuse, unknowns.specular, unknowns.width, unknowns.gain, unknowns.tilt):
        if value is not None:
            value.requires_grad_()
    unknowns.light.requires_grad_(not settings.known_light)
    if settings.model == "diffuse":
        return replace(unknowns, specular=None, width=None)
    return unknowns


def light_energy(light: Float[Tensor, "H W 3"], smoothness: float, whiteness: float) -> Tensor:
    """What holds the logarithm of a light smooth and white: of a tint that both could explain, the surface has it."""
    rough = (light - light.roll(1, 1)).square().mean() + (light[1:] - light[:-1]).square().mean()
    chroma = (light - light.mean(dim=-1, keepdim=True)).square().mean()
    return smoothness * rough + whiteness * chroma


def _smoothness(unknowns: Unknowns, settings: FitSettings, edges: Tensor) -> Tensor:
    energy = light_energy(unknowns.light, settings.light_smoothness, settings.light_whiteness)
    if settings.albedo_smoothness and len(edges):
        # albedo changes in few places: a gradient that shading explains, too, is shading
        albedo = torch.nn.functional.logsigmoid(unknowns.diffuse)
        change = (albedo[edges[:, 0]] - albedo[edges[:, 1]]).square().sum(dim=1)
        energy = energy + settings.albedo_smoothness * ((change + ALBEDO_NOISE**2).sqrt() - ALBEDO_NOISE).mean()
    for value in (unknowns.specular, unknowns.width):
        if value is not None and len(value) > 1:
            energy = energy + settings.map_smoothness * (value[edges[:, 0]] - value[edges[:, 1]]).square().mean()
    if unknowns.tilt is not None:
        change = (unknowns.tilt[edges[:, 0]] - unknowns.tilt[edges[:, 1]]).square().sum(dim=1)
        energy = energy + settings.tilt_smoothness * change.mean()
        energy = energy + settings.tilt_hold * unknowns.tilt.square().sum(dim=1).mean()
    return energy


def _finite(optimizer: torch.optim.Optimizer) -> bool:
    gradients = [p.grad.sum() for g in optimizer.param_groups for p in g["params"] if p.grad is not None]
    return bool(torch.isfinite(torch.stack(gradients)).all())
