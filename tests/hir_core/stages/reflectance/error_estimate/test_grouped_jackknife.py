"""Standard errors against the spread of estimates from many data sets, and what they are where nothing is known."""

from __future__ import annotations

import numpy as np
import pytest

from hir_core.stages.reflectance.error_estimate.grouped_jackknife import NormalEquations, standard_errors

GROUPS, BLOCKS, PIXELS = 12, 40, 20
NOISE, SHARED_NOISE = 0.02, 0.03
WIDTH = np.array([0.3, 0.3])


def equations(rng: np.random.Generator, rows: np.ndarray, residual: np.ndarray) -> NormalEquations:
    hessian = np.einsum("gbpi,gbpj->gbij", rows, rows)
    return NormalEquations(hessian, np.einsum("gbpi,gbp->gbi", rows, residual))


def data(rng: np.random.Generator, rows: np.ndarray) -> np.ndarray:
    """Residuals of the true values: noise of pixels, and an error that the pixels of a group and block share."""
    independent = NOISE * rng.standard_normal(rows.shape[:3])
    return np.asarray(independent + SHARED_NOISE * rng.standard_normal((GROUPS, BLOCKS, 1)))


@pytest.mark.parametrize("shared", [(), (1,)])
def test_errors_are_the_spread_over_data_sets(shared: tuple[int, ...]) -> None:
    """A formula for independent pixels would give a third of it, because the errors of a group's pixels are equal."""
    rng = np.random.default_rng(0)
    rows = rng.uniform(0.5, 1.5, (GROUPS, BLOCKS, PIXELS, 2))
    estimates, claimed = [], []
    for _ in range(60):
        residual = data(rng, rows)
        found = standard_errors(equations(rng, rows, residual), shared, WIDTH, NOISE)
        claimed.append(np.concatenate([found.local.reshape(-1), found.shared]))
        hessian, gradient = (
            each.sum(axis=0)
            for each in (equations(rng, rows, residual).hessian, equations(rng, rows, residual).gradient)
        )
        if shared:
            big = np.zeros((BLOCKS + 1, BLOCKS + 1))
            big[range(BLOCKS), range(BLOCKS)] = hessian[:, 0, 0]
            big[:-1, -1] = big[-1, :-1] = hessian[:, 0, 1]
            big[-1, -1] = hessian[:, 1, 1].sum()
            estimates.append(-np.linalg.solve(big, np.append(gradient[:, 0], gradient[:, 1].sum())))
        else:
            estimates.append(-np.linalg.solve(hessian, gradient[..., None])[..., 0].reshape(-1))
    deviation, claimed_error = np.std(estimates, axis=0), np.sqrt(np.mean(np.square(claimed), axis=0))
    # 60 data sets know a standard deviation to 9 %; the mean over 40 blocks knows it better
    local = slice(None, BLOCKS) if shared else slice(None)
    assert np.mean(claimed_error[local] / deviation[local]) == pytest.approx(1, abs=0.1)
    if shared:
        assert claimed_error[-1] / deviation[-1] == pytest.approx(1, abs=0.3)


def test_a_parameter_that_no_pixel_depends_on_has_the_width_of_the_prior() -> None:
    rng = np.random.default_rng(1)
    rows = rng.uniform(0.5, 1.5, (GROUPS, BLOCKS, PIXELS, 2))
    rows[:, :5, :, 1] = 0
    rows[:, 5:10] = 0
    found = standard_errors(equations(rng, rows, data(rng, rows)), (), WIDTH, NOISE)
    np.testing.assert_array_equal(found.local[:10, 1], WIDTH[1])
    np.testing.assert_array_equal(found.local[5:10, 0], WIDTH[0])
    assert (found.local[:5, 0] < 0.05).all() and (found.local[10:] < 0.2).all()


def test_a_block_that_one_group_sees_is_not_certain() -> None:
    """Its spread over groups is 0, because no other group contradicts."""
    rng = np.random.default_rng(2)
    rows = rng.uniform(0.5, 1.5, (GROUPS, BLOCKS, PIXELS, 2))
    rows[1:, 0] = 0
    found = standard_errors(equations(rng, rows, data(rng, rows)), (), WIDTH, NOISE)
    np.testing.assert_array_equal(found.local[0], WIDTH)


def test_errors_of_two_confused_parameters_are_large_for_both() -> None:
    """Albedo and lobe of a block whose photographs all show the same highlight: their sum is known, neither is."""
    rng = np.random.default_rng(3)
    one = rng.uniform(0.5, 1.5, (GROUPS, BLOCKS, PIXELS, 1))
    rows = np.concatenate([one, one * (1 + 1e-3 * rng.standard_normal(one.shape))], axis=3)
    found = standard_errors(equations(rng, rows, data(rng, rows)), (), WIDTH, NOISE)
    assert np.isfinite(found.local).all() and (found.local > 0.1).all()
