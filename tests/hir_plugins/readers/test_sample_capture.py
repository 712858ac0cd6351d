"""The capture that ships with the repository is whole, small, and faithful to the one it was made from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from hir_exporters.conventions import latlong_solid_angles
from hir_exporters.textures.image_files import read_hdr

from hir_core.plugins import NoOptions
from hir_plugins.readers.transforms_json import TransformsJsonReader

SAMPLE = Path(__file__).resolve().parents[3] / "examples" / "sample_capture"
READER = TransformsJsonReader(NoOptions())


def test_views_and_lights() -> None:
    assert {s: len(READER.read(SAMPLE, s).views) for s in READER.splits(SAMPLE)} == {
        "train": 24,
        "test": 6,
        "relight_0": 2,
    }
    train, test, relit = (READER.read(SAMPLE, s).environment for s in ("train", "test", "relight_0"))
    assert train is not None and test is not None and relit is not None
    # evaluation relights a split whose light is another file than train's
    assert train.path == test.path != relit.path
    assert sum(p.stat().st_size for p in SAMPLE.rglob("*") if p.is_file()) < 2_000_000


def test_pictures_are_area_averages_of_the_full_capture(shared: Path) -> None:
    full = {v.name: v for v in READER.read(shared / "captures" / "spot").views}
    for view in READER.read(SAMPLE).views[::6]:
        small, large = view.pixels(), full[view.name].pixels(2)
        assert small.mask is not None and large.mask is not None
        # 8 bits of sRGB: half a code is 0.002 of alpha, and at most 0.0045 of linear light where the curve is steep
        assert np.abs(small.mask - large.mask).max() < 0.5 / 255 + 1e-6
        solid = large.mask > 0.02
        assert np.abs(small.color_linear - large.color_linear)[solid].max() < 0.0046
        camera, big = view.camera, full[view.name].camera
        assert camera is not None and big is not None
        np.testing.assert_allclose(camera.intrinsics, big.downsampled(2).intrinsics, atol=1e-9)


def test_small_lights_keep_their_energy(shared: Path) -> None:
    for name in ("env_train.hdr", "env_relight_0.hdr"):
        small, large = read_hdr(SAMPLE / name), read_hdr(shared / "captures" / "spot" / name)
        energy = [(m * latlong_solid_angles(*m.shape[:2])[..., None]).sum(axis=(0, 1)) for m in (small, large)]
        # RGBE keeps 8 bits of the largest channel
        np.testing.assert_allclose(energy[0], energy[1], rtol=4e-3)
