"""The parameters of a fit: light, albedos, metalness and lobe width, each as an unconstrained number."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace

import torch
from hir_exporters.metallic_parameters import MAX_DIELECTRIC_F0
from jaxtyping import Float, Int
from torch import Tensor

from hir_core.scene import CameraLamp

MIN_ALPHA = 0.01
"""Narrowest lobe that the cached directions resolve in a light of 64 rows."""
MAX_FITTED_F0 = 0.08
"""Of the `dielectric` model and of the dielectric part of `metallic`: the upper end of the `specular` scale of Disney's
principled BRDF and of Unreal Engine (index of refraction 1.8; plastic has 0.04, sapphire 0.077, diamond 0.17). A
dielectric with a larger F0, a dark albedo and a bright light looks like a metal of one colour."""
MAX_LOG_EXPOSURE = 2.0
"""Exposures are limited to a factor of e² from their geometric mean; a larger one means another scene."""
LAMP_OFFSET_UNIT, LAMP_EXPONENT_UNIT, LAMP_RADIUS_UNIT = 0.1, 4.0, 0.1
"""Change of the lamp's place and radius, in its unit of length, and of its exponent, with a change of the parameter by
about 1."""
MAX_LAMP_OFFSET = 0.6
"""Of the lamp's place along each axis of the camera, and of its radius, in units of the mean distance between cameras
and object: a lamp that is farther away or larger is no flash."""
MAX_RADIANCE = 1e5
"""Upper limit of the light: it admits a sun of 1e4 and prevents overflow."""


@dataclass(frozen=True, eq=False)
class Parameters:
    """What is optimised, each unconstrained: logarithm of the light, logits of albedos and width.

    With `metalness` they are those of the `metallic` BRDF: `diffuse` holds the base colour and `specular` the F0 of the
    dielectric part, from which the albedos of both lobes follow.
    """

    light: Float[Tensor, "TH W 3"]
    """Of several takes their lights, one below another (`operator/take_lights.py`)."""
    diffuse: Float[Tensor, "V 3"]
    """Of ρd; of the base colour where there is a metalness."""
    specular: Float[Tensor, "#V C"] | None
    """Of ρs; of one F0 where there is a metalness."""
    width: Float[Tensor, "#V 1"] | None
    log_exposure: Float[Tensor, "views 3"] | None = None
    """Logarithm of the exposure of each photograph and channel; None if all have the same."""

    closed_form_diffuse: Float[Tensor, "V 3"] | None = None
    """As `diffuse`, in closed form for the other parameters, set when a fit ends. A later fit starts from `diffuse`: a
    closed-form albedo has absorbed errors of the light, and gradient steps would not undo that."""
    normal_offset: Float[Tensor, "V 3"] | None = None
    """Offset of shading normals from the mesh's, in the world (`shading_normals.py`); None for the mesh's normals."""
    metalness: Float[Tensor, "#V 1"] | None = None
    """Logit of metalness; one infinite row for a metal, which is not optimised. None for other BRDFs."""

    exposure_take: Int[Tensor, " views"] | None = None
    """Index of each view's take, where exposures are fitted beside a light for each take; None elsewhere."""

    lamp: Float[Tensor, " 8"] | None = None
    """Of a lamp near the camera: logarithm of its intensity (3), its place (3), its emission lobe and its radius; None
    for none.
    Lengths are in units of the mean distance between cameras and object (`operator/camera_lamp.py`)."""

    @property
    def with_closed_form_albedo(self) -> Parameters:
        """With the closed-form albedo, if there is one, in place of the optimised one: the result of a fit."""
        if self.closed_form_diffuse is None:
            return self
        return replace(self, diffuse=self.closed_form_diffuse, closed_form_diffuse=None)

    @property
    def exposure(self) -> Float[Tensor, "views 3"] | None:
        """Factor of each photograph and channel: brightness and white balance.

        The geometric mean over photographs is 1, because a common factor belongs to the light; over those of each take,
        where exposures are fitted and each take has its light.
        """
        if self.log_exposure is None:
            return None
        centered = self.log_exposure - mean_of_takes(self.log_exposure, self.exposure_take)
        return centered.clamp(-MAX_LOG_EXPOSURE, MAX_LOG_EXPOSURE).exp()

    @property
    def radiance(self) -> Float[Tensor, "TH W 3"]:
        """The light."""
        return self.light.clamp_max(torch.log(torch.tensor(MAX_RADIANCE)).item()).exp()

    @property
    def camera_lamp(self) -> CameraLamp | None:
        """The lamp near the camera, in its own unit of length."""
        if self.lamp is None:
            return None
        intensity = self.lamp[:3].clamp_max(math.log(MAX_RADIANCE)).exp()
        place = MAX_LAMP_OFFSET * torch.tanh(self.lamp[3:6] * (LAMP_OFFSET_UNIT / MAX_LAMP_OFFSET))
        exponent, radius = torch.nn.functional.softplus(self.lamp[6:8])
        radius = (LAMP_RADIUS_UNIT * radius).clamp_max(MAX_LAMP_OFFSET)
        return CameraLamp(intensity, place, LAMP_EXPONENT_UNIT * exponent, radius)

    @property
    def base_color(self) -> Float[Tensor, "V 3"]:
        """What is solved in closed form: ρd, or the base colour of the `metallic` BRDF.

        Also the share of light that the surface reflects onto itself, without the lobe of its dielectric part.
        """
        return torch.sigmoid(self.diffuse)

    @property
    def metal_share(self) -> Float[Tensor, "#V 1"]:
        """Metalness m in 0…1; one row if it is uniform."""
        assert self.metalness is not None
        return torch.sigmoid(self.metalness)

    @property
    def is_metal(self) -> bool:
        """Is m 1 everywhere, and not optimised?"""
        return self.metalness is not None and len(self.metalness) == 1 and bool(torch.isinf(self.metalness).all())

    def has_new_lobe(self, before: Parameters) -> bool:
        """Is there a lobe, or a metalness, that an earlier fit did not have?"""
        if self.width is None or before.width is None:
            return self.width is not None
        return self.metalness is not None and (before.metalness is None or before.is_metal != self.is_metal)

    @property
    def dielectric_f0(self) -> Float[Tensor, "1 1"]:
        """F0 of the dielectric part of the `metallic` BRDF."""
        assert self.specular is not None
        return torch.sigmoid(self.specular).clamp_max(MAX_DIELECTRIC_F0)

    @property
    def diffuse_albedo(self) -> Float[Tensor, "V 3"]:
        """ρd at vertices; (1 − m)·base for the `metallic` BRDF."""
        return self.base_color if self.metalness is None else (1 - self.metal_share) * self.base_color

    @property
    def specular_albedo(self) -> Float[Tensor, "#V C"]:
        """ρs; one row if it is uniform. (1 − m)·F0 + m·base for the `metallic` BRDF."""
        assert self.specular is not None
        if self.metalness is None:
            return torch.sigmoid(self.specular)
        return (1 - self.metal_share) * self.dielectric_f0 + self.metal_share * self.base_color

    @property
    def alpha(self) -> Float[Tensor, "#V 1"]:
        """GGX width; one row if it is uniform."""
        assert self.width is not None
        return MIN_ALPHA + (1 - MIN_ALPHA) * torch.sigmoid(self.width)

    def to(self, device: torch.device | str) -> Parameters:
        """The same on another device."""
        return Parameters(*(None if v is None else v.to(device) for v in self._values()))  # type: ignore[arg-type]

    def detached(self) -> Parameters:
        """A copy outside the graph."""
        return Parameters(*(None if v is None else v.detach().clone() for v in self._values()))  # type: ignore[arg-type]

    def _values(self) -> list[Tensor | None]:
        return [getattr(self, field.name) for field in fields(self)]


def mean_of_takes(values: Float[Tensor, "views C"], take: Int[Tensor, " views"] | None) -> Float[Tensor, "#views C"]:
    """The mean of the values of each view's take, in a row for each view; without takes one row for all."""
    if take is None:
        return values.mean(dim=0, keepdim=True)
    total = values.new_zeros(int(take.max()) + 1, values.shape[1]).index_add(0, take, values)
    return (total / torch.bincount(take).clamp_min(1)[:, None])[take]


def logit_of_alpha(alpha: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The unconstrained value (`Parameters.width`) of α."""
    return torch.logit(((alpha - MIN_ALPHA) / (1 - MIN_ALPHA)).clamp(1e-3, 1 - 1e-3))
