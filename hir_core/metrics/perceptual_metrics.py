"""Perceptual distances by their authors' packages: LPIPS (Zhang et al. 2018), FLIP (Andersson et al. 2020).

Where a package, or the weights of a network, are not there, the figure is left out and a sentence says why: nothing
takes its place.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, final

import numpy as np

from hir_core.metrics.image_metrics import Image

Network = Literal["alex", "vgg"]
"""LPIPS's backbone: `alex` is its authors' choice for judging, `vgg` is what Stanford-ORB reports."""


@final
class Lpips:
    """Learned perceptual distance; `find_lpips` builds it."""

    def __init__(self, network: Any) -> None:
        self._network = network

    def __call__(self, fit: Image, truth: Image) -> float:
        """Distance of pictures (H, W, 3) in 0…1; 0 for equal ones."""
        import torch

        def tensor(image: Image) -> Any:
            return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None] * 2 - 1

        with torch.no_grad():
            return float(self._network(tensor(fit), tensor(truth)))


@final
class Flip:
    """The difference that a person sees who alternates between two pictures; `find_flip` builds it."""

    def __call__(self, fit: Image, truth: Image) -> float:
        """Mean of the error map of sRGB pictures (H, W, 3) in 0…1, at the authors' 67 pixels a degree."""
        import flip_evaluator

        truth, fit = (np.ascontiguousarray(np.clip(image, 0, 1), np.float32) for image in (truth, fit))
        _, value, _ = flip_evaluator.evaluate(truth, fit, "LDR", applyMagma=False)
        return float(value)


def find_lpips(download: bool = False, network: Network = "alex") -> tuple[Lpips | None, str]:
    """The metric, or None and one sentence that says why it is not there. Nothing is fetched unless `download`."""
    if find_spec("lpips") is None or find_spec("torchvision") is None:
        return None, "LPIPS is left out: it needs lpips and torchvision; install them with: pip install 'hir[evaluate]'"
    try:
        weights = backbone_weights(network)
        if not weights.is_file() and not download:
            return None, f"LPIPS is left out: its backbone's weights are not at {weights}; --download fetches them"
        return _load_lpips(network), ""
    except Exception as error:  # whatever the network raises, or a torchvision that does not fit torch
        return None, f"LPIPS is left out: it cannot be loaded ({type(error).__name__}: {error})"


def find_flip() -> tuple[Flip | None, str]:
    """The metric, or None and one sentence that says why it is not there."""
    if find_spec("flip_evaluator") is None:
        return None, "FLIP is left out: it needs flip-evaluator; install it with: pip install 'hir[evaluate]'"
    return Flip(), ""


def backbone_weights(network: Network = "alex") -> Path:
    """Where torchvision keeps (and looks for) the backbone's weights."""
    import torch
    from torchvision.models import AlexNet_Weights, VGG16_Weights

    weights = {"alex": AlexNet_Weights, "vgg": VGG16_Weights}[network].IMAGENET1K_V1
    return Path(str(torch.hub.get_dir())) / "checkpoints" / str(weights.url.rpartition("/")[2])


@cache
def _load_lpips(network: Network) -> Lpips:
    import warnings

    import lpips

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torchvision's old argument names, which lpips still uses
        return Lpips(lpips.LPIPS(net=network, verbose=False).eval())
