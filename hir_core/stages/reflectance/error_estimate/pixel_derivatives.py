"""Derivatives of the pixels of the photographs in the maps of a material, by any reflectance renderer.

A pixel sees one place of the surface. So each map is changed by a step everywhere at once, and the change of a pixel is
its derivative in the map's value at its place. Differences with the same random numbers need no derivative of the
renderer: that of a lobe's width is mostly noise where directions are fixed (docs/studies/lobe_width.md).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from hir_core.capture import Capture
from hir_core.mesh.ray_casting import MeshQueries
from hir_core.plugins.interfaces import PreparedReflectance
from hir_core.rendering.take_radiance import radiance_in_takes
from hir_core.scene import Material, Mesh, Scene, Texture
from hir_core.scene.bilinear import texture_texels
from hir_core.scene.srgb import linear_to_srgb
from hir_core.stages.reflectance.gradient_fit import ObjectPixels, object_pixels

BASE_COLOR, SPECULAR, METALNESS, ROUGHNESS = "base_color", "specular", "metalness", "roughness"
STEPS = {BASE_COLOR: 0.03, METALNESS: 0.03, ROUGHNESS: 0.03, SPECULAR: 0.01}
"""Steps of the maps: large against rounding, small against their ranges, 0…1 and for ρs 0.02 to 0.08. Roughness is √α,
as in files."""


@dataclass(frozen=True, eq=False)
class PixelDerivatives:
    """P pixels with their places on the surface; colours in sRGB."""

    view: Int[Tensor, " P"]
    uv: Float[Tensor, "P 2"]
    residual: Float[Tensor, "P 3"]
    """Fit minus photograph."""
    known: Bool[Tensor, "P 3"]
    """Channels that are not clipped in the photograph."""
    base_color: Float[Tensor, "P 3"]
    """Derivative of each channel in the same channel of the base colour (of the diffuse albedo)."""
    others: Float[Tensor, "P K 3"]
    """Derivatives in the other maps, in the order of `names`."""
    names: tuple[str, ...]
    """Of `specular`, `metalness` and `roughness` those that the material has."""
    gain: Float[Tensor, "P 3"]
    """Linear radiance that a base colour of 1 would add."""
    specular_share: Float[Tensor, " P"]
    """Share of the linear radiance that does not depend on the base colour."""


def pixel_derivatives(
    scene: Scene, prepared: PreparedReflectance, capture: Capture, downsample: int, pixels_per_view: int, seed: int
) -> PixelDerivatives:
    """Pixels of all views, at most `pixels_per_view` of each, drawn from `seed`.

    `capture` has the exposures of the fit applied. Pixels whose ray misses the mesh are left out.
    """
    material = scene.material
    assert material is not None
    drawn = _drawn(capture, downsample, pixels_per_view, seed, str(scene.mesh.positions.device))
    uv, hit = _coordinates(scene.mesh, capture, downsample, drawn.index)
    index, color, saturated = drawn.index[hit], drawn.color[hit], drawn.saturated[hit]

    def radiance(changed: Material) -> Float[Tensor, "P 3"]:
        torch.manual_seed(seed)
        with torch.no_grad():
            return radiance_in_takes(prepared, scene, capture, index, changed).clamp_min(0)

    linear = radiance(material)

    def change_of(name: str) -> tuple[Float[Tensor, "P 3"], Float[Tensor, "P 3"]]:
        """Linear radiance below and above a step of one map."""
        below, above = (_changed(material, name, end) for end in (0.0, 1.0))
        return linear if below is material else radiance(below), radiance(above)

    below, above = change_of(BASE_COLOR)
    gain = (above - below) / STEPS[BASE_COLOR]
    names = map_names(material)
    others = [_encoded_slope(*change_of(name), STEPS[name]) for name in names]
    diffuse = (gain * _at(map_values(material, BASE_COLOR), uv)).mean(dim=1)
    return PixelDerivatives(
        view=index[:, 0],
        uv=uv,
        residual=linear_to_srgb(linear) - linear_to_srgb(color),
        known=~saturated.expand(-1, 3),
        base_color=_encoded_slope(below, above, STEPS[BASE_COLOR]),
        others=torch.stack(others, dim=1) if others else linear.new_zeros(len(index), 0, 3),
        names=names,
        gain=gain,
        specular_share=(1 - diffuse / linear.mean(dim=1).clamp_min(1e-6)).clamp(0, 1),
    )


def map_names(material: Material) -> tuple[str, ...]:
    """The maps and constants of a material beside its base colour. A metal has no metalness that could differ."""
    if not bool((material.specular_albedo > 0).any()):
        return ()
    if material.metalness is None:
        return (SPECULAR, ROUGHNESS)
    return (METALNESS, ROUGHNESS) if material.metalness.ndim == 3 else (ROUGHNESS,)


def is_constant(material: Material, name: str) -> bool:
    """Whether a map is one value for the whole surface."""
    return map_values(material, name).ndim == 1


def _encoded_slope(below: Tensor, above: Tensor, step: float) -> Tensor:
    return (linear_to_srgb(above) - linear_to_srgb(below)) / step


def map_values(material: Material, name: str) -> Texture:
    """A map in 0…1, a texture or a constant; roughness as √α."""
    if name == BASE_COLOR:
        return material.diffuse_albedo if material.metalness is None else material.base_color
    if name == METALNESS:
        assert material.metalness is not None
        return material.metalness
    return material.specular_albedo if name == SPECULAR else material.roughness.clamp_min(0).sqrt()


def _changed(material: Material, name: str, end: float) -> Material:
    """The material at the lower (0) or upper end (1) of a step of one map.

    The step begins at the map's values, and below them where it would leave 0…1; the same object where nothing changes.
    """
    values, step = map_values(material, name), STEPS[name]
    low = values.clamp_max(1 - step)
    if end == 0 and bool((low == values).all()):
        return material
    moved = low + end * step
    if name == ROUGHNESS:
        return replace(material, roughness=moved.square())
    if material.metalness is None:
        if name == BASE_COLOR:
            return replace(material, diffuse_albedo=moved)
        return replace(material, specular_albedo=moved)
    base_color, metalness = (moved if name == each else map_values(material, each) for each in (BASE_COLOR, METALNESS))
    return Material.metallic(
        base_color, metalness, material.roughness, material.normal, material.observed, material.dielectric_f0
    )


def _drawn(capture: Capture, downsample: int, pixels_per_view: int, seed: int, device: str) -> ObjectPixels:
    parts, first = [], [0]
    for view in range(len(capture.views)):
        pixels = object_pixels(capture, [view], downsample, device)
        order = np.random.default_rng((seed, view)).permutation(len(pixels.index))[:pixels_per_view]
        rows = torch.from_numpy(np.sort(order)).to(pixels.index.device)
        parts.append((pixels.index[rows], pixels.color[rows], pixels.saturated[rows]))
        first.append(first[-1] + len(rows))
    index, color, saturated = (torch.cat([part[k] for part in parts]) for k in range(3))
    return ObjectPixels(index, color, saturated, first)


def _coordinates(
    mesh: Mesh, capture: Capture, downsample: int, index: Int[Tensor, "P 3"]
) -> tuple[Float[Tensor, "N 2"], Bool[Tensor, " P"]]:
    """Texture coordinates of the places that pixels show, and which of the pixels show the mesh."""
    assert mesh.uvs is not None and mesh.topology.uv_faces is not None
    queries = MeshQueries(mesh.positions.detach().cpu().numpy(), mesh.faces.cpu().numpy())
    rows = index.cpu().numpy()
    origins, directions = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
    for view in np.unique(rows[:, 0]):
        of_view = rows[:, 0] == view
        camera = capture.cameras[int(view)].downsampled(downsample)
        origins[of_view], directions[of_view] = camera.rays(rows[of_view, 1:] + 0.5)
    face, barycentric = queries.first_hits(origins, directions)
    hit = torch.from_numpy(face >= 0).to(index.device)
    corners = mesh.uvs[mesh.topology.uv_faces[torch.from_numpy(face[face >= 0]).to(index.device)]]
    weights = torch.from_numpy(barycentric[face >= 0]).to(mesh.uvs)
    return (corners * weights[..., None]).sum(dim=1), hit


def _at(values: Texture, uv: Float[Tensor, "P 2"]) -> Float[Tensor, "#P C"]:
    """Bilinear lookup; a constant gives one row."""
    if values.ndim == 1:
        return values[None]
    height, width, channels = values.shape
    texel, weight = texture_texels(uv, height, width)
    return (values.reshape(-1, channels)[texel] * weight[..., None]).sum(dim=1)
