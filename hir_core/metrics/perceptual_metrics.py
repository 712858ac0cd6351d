"""Perceptual distances by their authors' packages: LPIPS (Zhang et al. 2018), FLIP (Andersson et al. 2020).

Where a package or the weights of a network are missing, the figure is left out with a sentence as the reason. Nothing
is substituted.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal, final

import numpy as np

from hir_core.metrics.image_metrics import Image

if TYPE_CHECKING:
    import torch

Network = Literal["alex", "vgg"]
"""Backbone of LPIPS: its authors recommend `alex` for evaluation; Stanford-ORB reports `vgg`."""


@final
class Lpips:
    """Learned perceptual distance; `find_lpips` builds it."""

    def __init__(self, network: torch.nn.Module) -> None:
        self._network = network

    def __call__(self, fit: Image, truth: Image) -> float:
        """Distance of pictures (H, W, 3) in 0…1; 0 for equal ones."""
        import torch

        def tensor(image: Image) -> torch.Tensor:
            return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None] * 2 - 1

        with torch.no_grad():
            return float(self._network(tensor(fit), tensor(truth)))


@final
class Flip:
    """The difference that an observer perceives when two images alternate; `find_flip` builds it."""

    def __call__(self, fit: Image, truth: Image) -> float:
        """Mean of the error map of sRGB pictures (H, W, 3) in 0…1, at the authors' 67 pixels a degree."""
        import flip_evaluator

        truth, fit = (np.ascontiguousarray(np.clip(image, 0, 1), np.float32) for image in (truth, fit))
        _, value, _ = flip_evaluator.evaluate(truth, fit, "LDR", applyMagma=False)
        return float(value)


def find_lpips(download: bool = False, network: Network = "alex") -> tuple[Lpips | None, str]:
    """The metric, or None and one sentence with the reason. Weights are downloaded only with `download`."""
    if find_spec("lpips") is None or find_spec("torchvision") is None:
        return None, "LPIPS is left out: it needs lpips and torchvision; install them with: pip install 'hir[evaluate]'"
    try:
        weights = backbone_weights(network)
        if not weights.is_file() and not download:
            return None, f"LPIPS is left out: its backbone's weights are not at {weights}; --download fetches them"
        return _load_lpips(network), ""
    except Exception as error:  # errors of the network, or of a torchvision built for another torch
        return None, f"LPIPS is left out: it cannot be loaded ({type(error).__name__}: {error})"


def find_flip() -> tuple[Flip | None, str]:
    """The metric, or None and one sentence with the reason."""
    if find_spec("flip_evaluator") is None:
        return None, "FLIP is left out: it needs flip-evaluator; install it with: pip install 'hir[evaluate]'"
    return Flip(), ""


def backbone_weights(network: Network = "alex") -> Path:
    """The path at which torchvision stores the weights of the backbone."""
    import torch
    from torchvision.models import AlexNet_Weights, VGG16_Weights

    weights = {"alex": AlexNet_Weights, "vgg": VGG16_Weights}[network].IMAGENET1K_V1
    return Path(str(torch.hub.get_dir())) / "checkpoints" / str(weights.url.rpartition("/")[2])


@cache
def _load_lpips(network: Network) -> Lpips:
    import warnings

    import lpips

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # lpips uses deprecated arguments of torchvision
        return Lpips(lpips.LPIPS(net=network, verbose=False).eval())
