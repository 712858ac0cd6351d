"""Some pixels with everything that predicts them: what a gradient step, a judgement and the closed form look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.scene.srgb import linear_to_srgb
from hir_plugins.reflectance_renderers.transport_ggx.fit.observed_pixels import Photographed
from hir_plugins.reflectance_renderers.transport_ggx.fit.parameters import Unknowns
from hir_plugins.reflectance_renderers.transport_ggx.fit.shading_normals import bent, bent_irradiance
from hir_plugins.reflectance_renderers.transport_ggx.operator.light_transport import Transport
from hir_plugins.reflectance_renderers.transport_ggx.operator.linear_maps import LinearMap
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_lobes import Lobes
from hir_plugins.reflectance_renderers.transport_ggx.operator.specular_radiance import SpecularBlock


@dataclass(frozen=True, eq=False)
class ShownPixels:
    """What photographs show in some pixels."""

    color_srgb: Float[Tensor, "P 3"]
    saturated: Bool[Tensor, "P 3"]
    view: Int[Tensor, " P"]

    @classmethod
    def of(cls, photographs: Photographed) -> ShownPixels:
        """Of points with their colours."""
        return ShownPixels(linear_to_srgb(photographs.color), photographs.saturated, photographs.points.view)


@dataclass(frozen=True, eq=False)
class Block(ShownPixels):
    """Some pixels with everything that predicts them."""

    lobes: Lobes | None
    """None for a diffuse model."""
    vertices: LinearMap
    cells: LinearMap | None
    direct: LinearMap | None
    """Irradiance from the pyramid for each pixel, where the light moves with the camera."""
    normal: Float[Tensor, "P 3"]
    """Of the mesh."""


def predict(
    transport: Transport, block: Block, specular: SpecularBlock | None, unknowns: Unknowns, bounces: int
) -> Float[Tensor, "P 3"]:
    """Linear radiance of the pixels of a block."""
    gain, lobe = gain_and_lobe(transport, block, specular, unknowns, bounces)
    diffuse = (block.vertices @ unknowns.diffuse_albedo) * gain
    return diffuse if lobe is None else diffuse + lobe


def gain_and_lobe(
    transport: Transport, block: Block, specular: SpecularBlock | None, unknowns: Unknowns, bounces: int
) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"] | None]:
    """What each pixel shows of its diffuse albedo, and the radiance of its lobe; None for a diffuse model."""
    if block.direct is not None:
        sources = transport.sky_only(unknowns.radiance)
        arriving = block.direct @ sources
    else:
        assert block.cells is not None
        sources, irradiance = transport.sources(unknowns.radiance, unknowns.diffuse_albedo, bounces)
        arriving = block.cells @ irradiance
        if unknowns.tilt is not None:
            bent_normal = normals_at_pixels(block, unknowns.tilt)
            vectors = block.cells @ transport.vector_irradiance(unknowns.radiance).reshape(-1, 9)
            arriving = bent_irradiance(block.normal, bent_normal, arriving, vectors.reshape(-1, 3, 3))
    gain = arriving / torch.pi
    if specular is None or unknowns.specular is None:
        return gain, None
    rho_s = at_pixels(block, unknowns.specular_albedo)
    alpha = at_pixels(block, unknowns.alpha)
    normal = in_lobes(block, unknowns.tilt)
    return gain * specular.diffuse_share(rho_s), specular.radiance(sources, rho_s, alpha, normal)


def exposed(block: Block, radiance: Float[Tensor, "P 3"], unknowns: Unknowns) -> Float[Tensor, "P 3"]:
    """What the photographs show of a radiance: each has its own exposure, where that is fitted."""
    exposure = unknowns.exposure
    return radiance if exposure is None else radiance * exposure[block.view][:, None]


def at_pixels(block: Block, values: Float[Tensor, "#V C"]) -> Float[Tensor, "#P C"]:
    """Vertex values at the pixels of a block; a uniform value stays one row."""
    return values if len(values) == 1 else block.vertices @ values


def normals_at_pixels(block: Block, tilt: Float[Tensor, "V 3"]) -> Float[Tensor, "P 3"]:
    """Bent normals of the pixels of a block."""
    return bent(block.normal, block.vertices @ tilt)


def in_lobes(block: Block, tilt: Float[Tensor, "V 3"] | None) -> Float[Tensor, "P 3"] | None:
    """Bent normals in the axes of each pixel's lobe; None where they are the mesh's."""
    if tilt is None or block.lobes is None:
        return None
    return (block.lobes.axes @ normals_at_pixels(block, tilt)[..., None])[..., 0]


def residual(pixels: ShownPixels, radiance: Float[Tensor, "P 3"]) -> Float[Tensor, "P 3"]:
    """Fit minus photograph in sRGB; a clipped pixel never pulls the fit below white."""
    difference = linear_to_srgb(radiance) - pixels.color_srgb
    return torch.where(pixels.saturated & (difference > 0), torch.zeros_like(difference), difference)


def specular_blocks(blocks: Sequence[Block], model: str) -> list[SpecularBlock | None]:
    """The specular matrices of each block; none for a diffuse model."""
    return [None if b.lobes is None or model == "diffuse" else SpecularBlock(b.lobes, model) for b in blocks]  # type: ignore[arg-type]


def refresh(blocks: Sequence[Block], specular: Sequence[SpecularBlock | None], unknowns: Unknowns) -> None:
    """Brings the specular matrices to the current α."""
    for block, matrices in zip(blocks, specular, strict=True):
        if matrices is not None:
            with torch.no_grad():
                alpha, rho_s = at_pixels(block, unknowns.alpha), at_pixels(block, unknowns.specular_albedo)
                matrices.refresh(alpha, rho_s, in_lobes(block, unknowns.tilt))
