"""The figures against scikit-image, and the one definition that all of them share."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hir_exporters.conventions import linear_to_srgb
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from hir_core import metrics
from hir_core.errors import InputError
from hir_core.metrics import perceptual_metrics


@pytest.fixture
def pictures() -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(1)
    truth = generator.random((40, 56, 3)).astype(np.float32)
    return np.clip(truth + generator.normal(0, 0.05, truth.shape), 0, 1).astype(np.float32), truth


def test_psnr_is_that_of_scikit_image(pictures: tuple[np.ndarray, np.ndarray]) -> None:
    fit, truth = pictures
    # the 8-bit range and 0…1 give the same dB
    expected = peak_signal_noise_ratio(truth.astype(np.float64) * 255, fit.astype(np.float64) * 255, data_range=255)
    assert metrics.psnr(fit, truth) == pytest.approx(expected, abs=1e-9)


def test_psnr_without_noise_is_that_of_what_the_renders_converge_to(pictures: tuple[np.ndarray, np.ndarray]) -> None:
    fit, truth = (picture.repeat(8, axis=0).repeat(8, axis=1) for picture in pictures)
    generator = np.random.default_rng(2)
    first, second = (fit + generator.normal(0, 0.05, fit.shape) for _ in range(2))
    wanted = metrics.psnr(fit, truth)
    assert metrics.psnr(first, truth) < wanted - 2, "the noise is as large as the error"
    assert metrics.psnr_without_noise(first, second, truth) == pytest.approx(wanted, abs=0.05)
    assert metrics.psnr_without_noise(fit, fit, truth) == pytest.approx(wanted, abs=1e-9)
    nowhere = np.zeros(truth.shape[:2], bool)
    assert metrics.psnr_without_noise(first, second, truth, nowhere) is None
    assert metrics.psnr_without_noise(truth, second, truth) == metrics.PSNR_MAX


def test_object_psnr_counts_pixels_of_true_coverage_above_half(pictures: tuple[np.ndarray, np.ndarray]) -> None:
    fit, truth = pictures
    coverage = np.zeros(truth.shape[:2], np.float32)
    coverage[:10], coverage[10:20], coverage[20:] = 1.0, 0.5, 0.2
    figures = metrics.compare(fit, truth, coverage)
    expected = peak_signal_noise_ratio(truth[:10].astype(np.float64), fit[:10].astype(np.float64), data_range=1)
    assert figures.object == pytest.approx(expected, abs=1e-9)
    assert figures.frame == metrics.psnr(fit, truth)


def test_ssim_is_that_of_wang_et_al(pictures: tuple[np.ndarray, np.ndarray]) -> None:
    fit, truth = pictures
    channels = [
        structural_similarity(
            truth[..., c].astype(np.float64),
            fit[..., c].astype(np.float64),
            data_range=1.0,
            gaussian_weights=True,
            sigma=1.5,
            use_sample_covariance=False,
        )
        for c in range(3)
    ]
    assert metrics.ssim(fit, truth) == pytest.approx(np.mean(channels), abs=1e-12)
    assert metrics.ssim(truth, truth) == pytest.approx(1.0)
    assert metrics.ssim(fit[:8], truth[:8]) is None, "smaller than the window"


def test_composite_is_srgb_times_coverage_not_srgb_of_the_product() -> None:
    color = np.full((1, 1, 3), 0.25, np.float32)
    picture = metrics.composite(color, np.full((1, 1), 0.5, np.float32))
    assert picture[0, 0, 0] == pytest.approx(float(linear_to_srgb(0.25)) * 0.5, abs=1e-6)
    assert picture[0, 0, 0] != pytest.approx(float(linear_to_srgb(0.125)), abs=0.05)


def test_composite_clips_before_coverage() -> None:
    """A highlight of radiance 8 under half coverage is half white, as a camera with alpha has it."""
    picture = metrics.composite(np.full((1, 1, 3), 8.0, np.float32), np.full((1, 1), 0.5, np.float32))
    np.testing.assert_allclose(picture[0, 0], 0.5, atol=1e-6)


def test_each_side_has_its_own_coverage() -> None:
    """A silhouette that is one row too large costs on the frame, though the true mask would hide it."""
    color = np.ones((16, 16, 3), np.float32)
    true_mask, fit_mask = np.zeros((2, 16, 16), np.float32)
    true_mask[:8], fit_mask[:9] = 1, 1
    figures = metrics.compare(metrics.composite(color, fit_mask), metrics.composite(color, true_mask), true_mask)
    assert figures.object == metrics.PSNR_MAX
    assert figures.frame == pytest.approx(10 * np.log10(16), abs=1e-4)


def test_a_render_is_unassociated_before_it_is_encoded() -> None:
    premultiplied = np.array([[[0.1, 0.2, 0.0, 0.5], [0.0, 0.0, 0.0, 0.0]]], np.float32)
    color, coverage = metrics.unassociate(premultiplied)
    np.testing.assert_allclose(color[0], [[0.2, 0.4, 0.0], [0.0, 0.0, 0.0]], rtol=1e-6)
    np.testing.assert_array_equal(coverage[0], np.array([0.5, 0.0], np.float32))


def test_nothing_non_finite_leaves() -> None:
    one, nan = np.ones((1, 1), np.float32), np.full((1, 1), np.nan, np.float32)
    clipped = metrics.composite(np.array([[[0.5, np.inf, -np.inf]]], np.float32), one)
    np.testing.assert_allclose(clipped[0, 0, 1:], [1, 0], atol=1e-6)
    for color, coverage in ((np.full((1, 1, 3), np.nan, np.float32), one), (np.ones((1, 1, 3), np.float32), nan)):
        with pytest.raises(InputError, match="no number"):
            metrics.composite(color, coverage)
    empty = np.zeros((0, 3), np.float32)
    assert metrics.psnr(empty, empty) is None
    assert metrics.mean([]) is None and metrics.mean([None, 2.0]) == 2.0


def test_channel_scale_is_the_least_squares_one_of_srgb() -> None:
    generator = np.random.default_rng(2)
    fit = generator.random((200, 3))
    truth = fit * [2.0, 0.5, 1.0] * (1 + generator.normal(0, 0.01, fit.shape))
    scale = metrics.ChannelScale()
    for part in np.array_split(np.arange(200), 7):
        scale.add(fit[part], truth[part])
    fit_srgb, truth_srgb = fit ** (1 / 2.4), truth ** (1 / 2.4)
    expected = [np.linalg.lstsq(fit_srgb[:, [c]], truth_srgb[:, c], rcond=None)[0][0] ** 2.4 for c in range(3)]
    np.testing.assert_allclose(scale.value, expected, rtol=1e-12)
    np.testing.assert_allclose(scale.value, [2.0, 0.5, 1.0], rtol=0.01)
    np.testing.assert_array_equal(metrics.ChannelScale().value, np.ones(3))


def test_a_highlight_beside_its_place_does_not_decide_the_scale() -> None:
    """A sun in polished metal is a few pixels, each as bright as thousands of others."""
    truth = np.full((4_000, 3), 0.3)
    fit = truth.copy()
    fit[:8], truth[8:16] = 18.0, 0.99
    scale = metrics.ChannelScale()
    scale.add(fit, truth)
    np.testing.assert_allclose(scale.value, np.ones(3), atol=0.15)
    of_linear = (fit * truth).sum(axis=0) / (fit * fit).sum(axis=0)
    assert (of_linear < 0.2).all()


def test_missing_lpips_weights_are_said_and_nothing_is_fetched(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(perceptual_metrics, "find_spec", lambda name: name)
    monkeypatch.setattr(perceptual_metrics, "backbone_weights", lambda network: tmp_path / "alexnet.pth")
    monkeypatch.setattr(perceptual_metrics, "_load_lpips", lambda network: pytest.fail("the network was asked for"))
    found, why = perceptual_metrics.find_lpips()
    assert found is None
    assert f"weights are not at {tmp_path}" in why and "--download" in why


def test_weights_are_looked_for_where_torch_keeps_them(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    import torch

    try:
        import torchvision  # noqa: F401
    except (ImportError, RuntimeError) as error:
        pytest.skip(f"no torchvision that fits torch, pip install 'hir[evaluate]': {error}")
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    assert perceptual_metrics.backbone_weights().parent == tmp_path / "checkpoints"


def test_an_installation_that_breaks_lpips_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(network: str) -> Path:
        raise RuntimeError("operator torchvision::nms does not exist")

    monkeypatch.setattr(perceptual_metrics, "find_spec", lambda name: name)
    monkeypatch.setattr(perceptual_metrics, "backbone_weights", broken)
    found, why = perceptual_metrics.find_lpips()
    assert found is None
    assert "cannot be loaded (RuntimeError: operator torchvision::nms" in why


def test_flip_is_that_of_its_authors_with_the_reference_first(pictures: tuple[np.ndarray, np.ndarray]) -> None:
    flip_evaluator = pytest.importorskip("flip_evaluator", reason="pip install 'hir[evaluate]'")
    fit, truth = pictures
    flip, why = perceptual_metrics.find_flip()
    assert flip is not None and why == ""
    _, expected, _ = flip_evaluator.evaluate(truth, fit, "LDR")
    assert flip(fit, truth) == pytest.approx(expected, abs=1e-7) and expected > 0.01
    assert flip(truth, truth) == 0
    assert metrics.compare(fit, truth, np.ones(truth.shape[:2], np.float32), flip=flip).flip == flip(fit, truth)


def test_missing_flip_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(perceptual_metrics, "find_spec", lambda name: None)
    found, why = perceptual_metrics.find_flip()
    assert found is None and "pip install 'hir[evaluate]'" in why


def test_mask_iou_counts_pixels() -> None:
    ours, theirs = np.zeros((2, 10, 10), np.float32)
    ours[:6], theirs[4:] = 1.0, 0.9
    assert metrics.mask_iou(ours, theirs) == pytest.approx(20 / 100)
    assert metrics.mask_iou(ours * 0.4, theirs * 0.4) is None, "half or less is outside"


def test_psnr_of_a_picture_with_a_pixel_that_is_not_finite_is_refused(pictures: tuple[np.ndarray, np.ndarray]) -> None:
    fit, truth = pictures
    for value in (np.nan, np.inf):
        broken = fit.copy()
        broken[3, 4, 1] = value
        with pytest.raises(InputError, match="not finite"):
            metrics.psnr(broken, truth)
        inside = np.ones(truth.shape[:2], bool)
        inside[3, 4] = False
        assert metrics.psnr(broken, truth, inside) == metrics.psnr(fit, truth, inside), "only compared pixels matter"


@pytest.mark.parametrize("missed", [0.0, 0.03], ids=["exact", "missed highlights"])
def test_the_nearest_exposure_has_the_least_error_in_srgb(missed: float) -> None:
    """Where the fit lacks a few highlights, too; least squares of linear colours would be far off there."""
    generator = np.random.default_rng(3)
    fit = generator.uniform(0.02, 0.3, (2000, 3))
    factors = np.array([0.8, 1.0, 1.3])
    truth = np.clip(fit * factors, 0, 1)
    truth[: round(missed * len(truth))] = 0.95
    found = metrics.nearest_exposure(fit.astype(np.float32), truth.astype(np.float32))
    tried = np.linspace(0.6, 2.0, 1401)
    errors = [((linear_to_srgb(np.clip(f * fit, 0, 1)) - linear_to_srgb(truth)) ** 2).mean(axis=0) for f in tried]
    np.testing.assert_allclose(found, tried[np.argmin(errors, axis=0)], rtol=0.002)
    if not missed:
        np.testing.assert_allclose(found, factors, rtol=1e-5)


def test_the_nearest_exposure_is_finite_for_what_is_black() -> None:
    black, grey = np.zeros((4, 3), np.float32), np.full((4, 3), 0.5, np.float32)
    assert metrics.nearest_exposure(black, grey).tolist() == [1, 1, 1]
    assert metrics.nearest_exposure(grey, black).tolist() == [0, 0, 0]
    assert metrics.nearest_exposure(grey[:0], grey[:0]).tolist() == [1, 1, 1]
