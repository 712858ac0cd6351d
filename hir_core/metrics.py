"""How far a fit is from a photograph: PSNR, SSIM, LPIPS (docs/evaluation.md). numpy in, numbers out.

One definition for all: fit and photograph are each composited over black with their **own** coverage, as
sRGB × coverage, in the 8-bit range and clipped, never rounded. `frame` is over all pixels, `object` over pixels of true
coverage > 0.5.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np
from hir_exporters.conventions import linear_to_srgb
from numpy.typing import NDArray

Image = NDArray[np.float32]

OBJECT_COVERAGE: Final = 0.5
"""True coverage above which a pixel belongs to the object."""

PSNR_MAX: Final = 100.0
"""dB reported for equal images: an infinity would make every mean infinite."""


def composite(color_linear: Image, coverage: Image) -> Image:
    """Picture (H, W, 3) in 0…1 over black: sRGB of the clipped colour (H, W, 3, unassociated) times coverage (H, W)."""
    color = np.clip(np.nan_to_num(color_linear, nan=0.0, posinf=1.0, neginf=0.0), 0.0, 1.0)
    alpha = np.clip(np.nan_to_num(coverage, nan=0.0), 0.0, 1.0)
    return np.asarray(linear_to_srgb(color) * alpha[..., None], dtype=np.float32)


def unassociate(premultiplied: Image) -> tuple[Image, Image]:
    """Colour (H, W, 3) and coverage (H, W) of a render (H, W, 4); black where nothing covers."""
    alpha = np.clip(premultiplied[..., 3], 0.0, 1.0)
    color = premultiplied[..., :3] / np.maximum(alpha, 1e-6)[..., None]
    return np.where(alpha[..., None] > 0, color, 0.0).astype(np.float32), alpha.astype(np.float32)


def psnr(fit: Image, truth: Image, where: NDArray[np.bool_] | None = None) -> float | None:
    """Peak signal to noise ratio in dB of pictures in 0…1; at most `PSNR_MAX`; None where no pixel counts."""
    difference = np.asarray(fit, dtype=np.float64) - np.asarray(truth, dtype=np.float64)
    if where is not None:
        difference = difference[where]
    if difference.size == 0:
        return None
    error = float(np.mean(difference**2))
    return min(PSNR_MAX, -10.0 * float(np.log10(error))) if error > 0 else PSNR_MAX


def ssim(fit: Image, truth: Image) -> float | None:
    """Structural similarity (Wang et al. 2004): Gaussian window of σ 1.5, population covariance, mean over channels.

    None where the picture is smaller than the window (11 pixels).
    """
    from skimage.metrics import structural_similarity

    if min(truth.shape[:2]) < 11:
        return None
    value = structural_similarity(  # type: ignore[no-untyped-call,unused-ignore]
        np.asarray(truth, np.float64), np.asarray(fit, np.float64), data_range=1.0, channel_axis=2,
        gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
    )  # fmt: skip
    return float(value)


class ChannelScale:
    """Linear scale (3,) of each channel that brings fits nearest to their truths, gathered picture by picture."""

    def __init__(self) -> None:
        self._power = np.zeros(3)
        self._product = np.zeros(3)

    def add(self, fit_linear: Image, true_linear: Image) -> None:
        """Takes linear colours (N, 3) of the fit and of the truth at the same places."""
        fit, truth = np.asarray(fit_linear, np.float64), np.asarray(true_linear, np.float64)
        self._power += (fit * fit).sum(axis=0)
        self._product += (fit * truth).sum(axis=0)

    @property
    def value(self) -> NDArray[np.float64]:
        """Least squares; 1 where the fit is black."""
        return np.where(self._power > 0, self._product / np.maximum(self._power, 1e-300), 1.0)


@dataclass(frozen=True)
class Figures:
    """Error of one picture."""

    frame: float | None
    object: float | None
    ssim: float | None
    lpips: float | None

    def document(self) -> dict[str, Any]:
        """As it stands in evaluation JSON."""
        return {"psnr": {"frame": self.frame, "object": self.object}, "ssim": self.ssim, "lpips": self.lpips}


def compare(fit: Image, truth: Image, true_coverage: Image, perceptual: Lpips | None = None) -> Figures:
    """All figures of two composited pictures."""
    inside = true_coverage > OBJECT_COVERAGE
    return Figures(
        psnr(fit, truth),
        psnr(fit, truth, inside),
        ssim(fit, truth),
        None if perceptual is None else perceptual(fit, truth),
    )


def mean(values: list[float | None]) -> float | None:
    """Mean of those that are there."""
    there = [value for value in values if value is not None]
    return float(np.mean(there)) if there else None


class Lpips:
    """Learned perceptual distance (Zhang et al. 2018), AlexNet, from the `lpips` package; `find_lpips` builds it."""

    def __init__(self, network: Any) -> None:
        self._network = network

    def __call__(self, fit: Image, truth: Image) -> float:
        """Distance of pictures (H, W, 3) in 0…1; 0 for equal ones."""
        import torch

        def tensor(image: Image) -> Any:
            return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None] * 2 - 1

        with torch.no_grad():
            return float(self._network(tensor(fit), tensor(truth)))


def find_lpips(download: bool = False) -> tuple[Lpips | None, str]:
    """The metric, or None and one sentence that says why it is not there. Nothing is fetched unless `download`."""
    from importlib.util import find_spec

    if find_spec("lpips") is None or find_spec("torchvision") is None:
        return None, "LPIPS is left out: it needs lpips and torchvision; install them with: pip install 'hir[evaluate]'"
    try:
        weights = backbone_weights()
        if not weights.is_file() and not download:
            return None, f"LPIPS is left out: its backbone's weights are not at {weights}; --download fetches them"
        return _load_lpips(), ""
    except Exception as error:  # whatever the network raises, or a torchvision that does not fit torch
        return None, f"LPIPS is left out: it cannot be loaded ({type(error).__name__}: {error})"


def backbone_weights() -> Path:
    """Where torchvision keeps (and looks for) AlexNet's weights."""
    import torch
    from torchvision.models import AlexNet_Weights

    name = AlexNet_Weights.IMAGENET1K_V1.url.rpartition("/")[2]
    return Path(str(torch.hub.get_dir())) / "checkpoints" / str(name)


@cache
def _load_lpips() -> Lpips:
    import warnings

    import lpips

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torchvision's old argument names, which lpips still uses
        return Lpips(lpips.LPIPS(net="alex", verbose=False).eval())
