"""Laws of the noncredibility index and the inclination indicator."""

from __future__ import annotations

import numpy as np
import pytest
from draws import covariances, sampled, seeds
from hypothesis import given
from hypothesis import strategies as st

from slamkit.errors import InputError
from slamkit.evaluate import (
    inclination,
    nci,
)


@given(seeds, st.integers(1, 4), st.floats(0.05, 20))
def test_credibility_is_measured_against_the_sample_mean_square_error(seed: int, d: int, c: float) -> None:
    rng = np.random.default_rng(seed)
    e = sampled(rng, covariances(rng, 30, 5, d))
    attained = np.einsum("mti,mtj->tij", e, e) / 30
    np.testing.assert_allclose(nci(e, attained), 0, atol=1e-6)
    np.testing.assert_allclose(inclination(e, c * attained), -10 * np.log10(c), atol=1e-6)
    np.testing.assert_allclose(nci(e, c * attained), abs(10 * np.log10(c)), atol=1e-6)
    P = covariances(rng, 30, 5, d)
    assert nci(e, P).shape == (5,)
    assert np.all(np.abs(inclination(e, P)) <= nci(e, P) + 1e-12)


def test_credible_estimator_tends_to_zero_and_inclination_has_the_right_sign() -> None:
    # 4000 runs, 20 steps, seed 5; a credible estimator's index falls as the root of the number of runs.
    rng = np.random.default_rng(5)
    P = np.broadcast_to(covariances(rng, 20, 3), (4000, 20, 3, 3))
    e = sampled(rng, P)
    assert np.all(nci(e, P) < 0.2)
    assert np.mean(nci(e[:160], P[:160])) == pytest.approx(5 * np.mean(nci(e, P)), rel=0.3)
    assert np.all(np.abs(inclination(e, P)) < 0.2)
    np.testing.assert_allclose(inclination(e, P / 4), 10 * np.log10(4), atol=0.2)
    assert np.all(inclination(e, P / 4) > 0) and np.all(inclination(e, 4 * P) < 0)
    T = rng.normal(size=(3, 3)) + 3 * np.eye(3)
    np.testing.assert_allclose(nci(e @ T.T, T @ P @ T.T), nci(e, P), rtol=1e-7)


def test_credibility_is_undefined_where_nothing_is_uncertain() -> None:
    rng = np.random.default_rng(1)
    P = np.broadcast_to(np.eye(3), (10, 3, 3, 3)).copy()
    e = sampled(rng, P)
    e[:, 0], P[:, 0] = 0, 0  # nothing uncertain
    e[:, 1, 2] = 0  # claimed rank 3, attained 2
    assert np.isnan(nci(e, P)).tolist() == [True, True, False]
    P[:, 1, 2, 2] = 0  # both of rank 2
    assert np.isnan(inclination(e, P)).tolist() == [True, False, False]
    with pytest.raises(InputError, match="3 runs"):
        nci(e[:3], P[:3])
