"""Masks with their cameras: the input of the geometry renderers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from hir_core.capture.camera import Camera
from hir_core.capture.capture import View
from hir_core.errors import CaptureError


@dataclass(frozen=True, eq=False)
class SilhouetteTargets:
    """Masks (one H W tensor a view, 0…1) with their cameras; `targets[[3, 5]]` chooses views."""

    cameras: tuple[Camera, ...]
    masks: tuple[Float[Tensor, "H W"], ...]

    @classmethod
    def from_views(cls, views: Sequence[View], downsample: int = 1) -> SilhouetteTargets:
        """Reads the masks; a view without camera or mask, or with one that is not finite, raises `CaptureError`."""
        cameras, masks = [], []
        for view in views:
            if view.camera is None:
                raise CaptureError(f"view {view.name} has no camera; run an initializer that finds cameras first")
            mask = view.pixels(downsample).mask
            if mask is None:
                raise CaptureError(
                    f"view {view.name} has no mask; set mask sources with --set 'masks=[…]' (`hir plugins` lists them)"
                )
            if not np.isfinite(mask).all():
                raise CaptureError(f"the mask of view {view.name} holds values that are not finite; write it again")
            cameras.append(view.camera.downsampled(downsample))
            masks.append(torch.from_numpy(np.ascontiguousarray(mask.clip(0, 1), dtype=np.float32)))
        return cls(tuple(cameras), tuple(masks))

    def __len__(self) -> int:
        return len(self.cameras)

    def __getitem__(self, chosen: Iterable[int]) -> SilhouetteTargets:
        indices = [int(i) for i in chosen]
        return SilhouetteTargets(tuple(self.cameras[i] for i in indices), tuple(self.masks[i] for i in indices))

    def to(self, device: torch.device) -> SilhouetteTargets:
        """The same targets with the masks on a device."""
        return SilhouetteTargets(self.cameras, tuple(m.to(device) for m in self.masks))

    @property
    def areas(self) -> Float[Tensor, " B"]:
        """Area of each mask in pixels."""
        return torch.stack([m.sum(dtype=torch.float64) for m in self.masks]) if self.masks else torch.zeros(0).double()


def intersection_over_union(
    area: Float[Tensor, " B"], intersection: Float[Tensor, " B"], mask_area: Float[Tensor, " B"]
) -> Float[Tensor, " B"]:
    """IoU of each view (Zhu et al. 2023, L_sil = 1 − IoU); 1 where both silhouette and mask are empty.

    For an empty mask the gradient shrinks the silhouette.
    """
    union = area + mask_area.to(area) - intersection
    # an empty silhouette and an empty mask agree; the epsilon avoids 0/0 and its gradient
    return (intersection + 1e-6) / (union + 1e-6)
