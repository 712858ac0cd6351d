"""Errors that all photographs have in common are added to the spread between photographs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from hir_core.scene import Material
from hir_core.scene.map_error_store import load_map_errors, save_map_errors
from hir_core.scene.map_errors import OBSERVED, OUTSIDE, MapErrors
from hir_core.stages.reflectance.error_estimate.common_errors import COMMON_ERRORS, CommonError, with_common_errors
from hir_core.stages.reflectance.error_estimate.error_estimate import PRIOR_WIDTHS

BLOCKS = 4


def variation_alone() -> MapErrors:
    """Of two columns of the four there is surface."""
    condition = np.full((BLOCKS, BLOCKS), OUTSIDE, np.uint8)
    condition[:, :2] = OBSERVED
    error = np.where(condition == OBSERVED, 0.01, np.nan).astype(np.float32)
    return MapErrors(error[..., None].repeat(3, 2), {"specular": 0.1 * error}, {"roughness": 0.002}, condition)


def material(albedo: float = 0.5, alpha: float = 0.09) -> Material:
    grey = torch.full((16, 16, 3), albedo)
    return Material("dielectric", grey, torch.full((16, 16, 3), 0.04), torch.tensor([alpha]))


def test_the_formula() -> None:
    found = CommonError(2.0, 0.1, 0.03).error(np.array([0.02, 0.02]), np.array([0.0, 0.5]), 1.0)
    np.testing.assert_allclose(found, [0.05, np.sqrt(0.04**2 + 0.05**2 + 0.03**2)])


def test_no_error_exceeds_that_of_a_map_of_which_nothing_is_known() -> None:
    assert CommonError(5.0, 1.0, 1.0).error(np.array([0.2]), np.array([1.0]), 0.29) == pytest.approx(0.29)


def test_every_map_gets_its_own_value_and_keeps_the_spread() -> None:
    before, fit = variation_alone(), material()
    whole = with_common_errors(before, fit, PRIOR_WIDTHS)
    inside = before.condition != OUTSIDE
    expected = {
        "base_color": COMMON_ERRORS["base_color"].error(np.array(0.01), np.array(0.5), 1),
        "specular": COMMON_ERRORS["specular"].error(np.array(0.001), np.array(0.04), PRIOR_WIDTHS["specular"]),
        "roughness": COMMON_ERRORS["roughness"].error(np.array(0.002), np.array(0.3), 1),
    }
    np.testing.assert_allclose(whole.base_color[inside], expected["base_color"], rtol=1e-5)
    np.testing.assert_allclose(whole.maps["specular"][inside], expected["specular"], rtol=1e-5)
    assert whole.constants["roughness"] == pytest.approx(float(expected["roughness"]), rel=1e-5)
    assert np.isnan(whole.base_color[~inside]).all() and np.isnan(whole.maps["specular"][~inside]).all()
    np.testing.assert_array_equal(whole.variation["base_color"], before.base_color)
    assert whole.variation["roughness"] == pytest.approx(0.002)


def test_blocks_that_no_photograph_determines_stay_as_uncertain_as_before() -> None:
    before = variation_alone()
    before.base_color[0, 0], before.maps["specular"][0, 0] = PRIOR_WIDTHS["base_color"], PRIOR_WIDTHS["specular"]
    whole = with_common_errors(before, material(), PRIOR_WIDTHS)
    np.testing.assert_allclose(whole.base_color[0, 0], PRIOR_WIDTHS["base_color"], rtol=1e-6)
    assert whole.maps["specular"][0, 0] == pytest.approx(PRIOR_WIDTHS["specular"])


def test_brighter_blocks_are_less_certain() -> None:
    """A wrong light makes an error that is a share of the base colour."""
    fit = material()
    fit.diffuse_albedo[:8] = 0.1
    whole = with_common_errors(variation_alone(), fit, PRIOR_WIDTHS)
    dark, bright = whole.base_color[0, 0, 0], whole.base_color[3, 0, 0]
    assert dark < bright


def test_both_parts_are_stored_bit_for_bit(tmp_path: Path) -> None:
    whole = with_common_errors(variation_alone(), material(), PRIOR_WIDTHS)
    save_map_errors(whole, tmp_path)
    read = load_map_errors(tmp_path)
    assert read is not None
    assert read.variation.keys() == whole.variation.keys()
    for name, each in whole.variation.items():
        np.testing.assert_array_equal(read.variation[name], each)
    np.testing.assert_array_equal(read.base_color, whole.base_color)
    assert read.constants == whole.constants
