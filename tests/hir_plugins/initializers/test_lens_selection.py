"""A distortion is kept where the photographs show it; one that is not there takes the focal length with it."""

from __future__ import annotations

import pytest

from hir_plugins.initializers.options import ColmapOptions

pycolmap = pytest.importorskip("pycolmap")

FOCAL = 1500.0


def _photographed(distortion: float, seed: int = 0) -> pycolmap.Reconstruction:
    """24 photographs of 400 points, with half a pixel of noise; the cameras are the true ones."""
    pycolmap.set_random_seed(seed)
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, 24
    options.num_points3D, options.camera_width, options.camera_height = 400, 800, 600
    options.camera_model_id = pycolmap.CameraModelId.SIMPLE_RADIAL
    options.camera_params = [FOCAL, 400, 300, distortion]
    model = pycolmap.synthesize_dataset(options)
    noise = pycolmap.SyntheticNoiseOptions()
    noise.point2D_stddev = 0.5
    pycolmap.synthesize_noise(noise, model)
    return model


@pytest.mark.parametrize("distortion", [0.0, 0.05, -0.05])
def test_the_simplest_lens_that_explains_the_tracks(distortion: float) -> None:
    from hir_plugins.initializers.sfm.lens_selection import simplest_lens

    model, comparison = simplest_lens(_photographed(distortion), ColmapOptions(threads=1))
    assert comparison is not None and comparison.distorted == (distortion != 0), comparison
    (camera,) = model.cameras.values()
    assert camera.model.name == ("SIMPLE_RADIAL" if distortion else "SIMPLE_PINHOLE")
    assert abs(camera.params[0] / FOCAL - 1) < 0.003


def test_a_lens_that_is_given_stays() -> None:
    from hir_plugins.initializers.sfm.lens_selection import simplest_lens

    model = _photographed(0.0)
    same, comparison = simplest_lens(model, ColmapOptions(refine_intrinsics=False))
    assert same is model and comparison is None
