"""What is fitted on cached transport: light, albedos and lobe width, each as a number without bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

ALPHA_LOW = 0.01
"""Narrowest lobe the cached directions resolve in a light of 64 rows."""
GAIN_LIMIT = 2.0
"""A photograph's exposure is held within e² of the others': more is another scene."""
LIGHT_LIMIT = 1e5
"""Radiance is held below this: a sun of 1e4 fits, an overflow does not."""


@dataclass(frozen=True, eq=False)
class Unknowns:
    """What is fitted, each unconstrained: logarithm of the light, logits of albedos and width."""

    light: Float[Tensor, "H W 3"]
    diffuse: Float[Tensor, "V 3"]
    specular: Float[Tensor, "#V C"] | None
    width: Float[Tensor, "#V 1"] | None
    gain: Float[Tensor, " views"] | None = None
    """Logarithm of each photograph's brightness beside the others; None where all were exposed alike."""

    solved: Float[Tensor, "V 3"] | None = None
    """Logits of ρd in closed form under all the rest, once a fit has ended. Another fit goes on from `diffuse`: from an
    albedo that has taken up what the light lacks, it would not give it back."""
    tilt: Float[Tensor, "V 3"] | None = None
    """How far normals are bent from the mesh's, in the world (`bending.py`); None where they are the mesh's."""

    @property
    def settled(self) -> Unknowns:
        """With the albedo in closed form, where there is one: what a fit shows."""
        return self if self.solved is None else replace(self, diffuse=self.solved, solved=None)

    @property
    def exposure(self) -> Float[Tensor, " views"] | None:
        """Factor of each photograph; their geometric mean is 1, for a common one is the light's."""
        return None if self.gain is None else (self.gain - self.gain.mean()).clamp(-GAIN_LIMIT, GAIN_LIMIT).exp()

    @property
    def radiance(self) -> Float[Tensor, "H W 3"]:
        """The light."""
        return self.light.clamp_max(torch.log(torch.tensor(LIGHT_LIMIT)).item()).exp()

    @property
    def diffuse_albedo(self) -> Float[Tensor, "V 3"]:
        """ρd at vertices."""
        return torch.sigmoid(self.diffuse)

    @property
    def specular_albedo(self) -> Float[Tensor, "#V C"]:
        """ρs; one row where it is uniform."""
        assert self.specular is not None
        return torch.sigmoid(self.specular)

    @property
    def alpha(self) -> Float[Tensor, "#V 1"]:
        """GGX width; one row where it is uniform."""
        assert self.width is not None
        return ALPHA_LOW + (1 - ALPHA_LOW) * torch.sigmoid(self.width)

    def to(self, device: torch.device | str) -> Unknowns:
        """The same on another device."""
        return Unknowns(*(None if v is None else v.to(device) for v in self._values()))  # type: ignore[arg-type]

    def detached(self) -> Unknowns:
        """A copy outside the graph."""
        return Unknowns(*(None if v is None else v.detach().clone() for v in self._values()))  # type: ignore[arg-type]

    def _values(self) -> list[Tensor | None]:
        return [self.light, self.diffuse, self.specular, self.width, self.gain, self.solved, self.tilt]


def width_of(alpha: Float[Tensor, "*b"]) -> Float[Tensor, "*b"]:
    """The unconstrained value of a width α."""
    return torch.logit(((alpha - ALPHA_LOW) / (1 - ALPHA_LOW)).clamp(1e-3, 1 - 1e-3))
