"""Laws of the figures of a covariance: ellipses are exact, correlations are bounded, and bad matrices are refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from drawing import SEEDS, axes, covariances, draw, run
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.path import Path as Outline
from scipy.stats import chi2

from slamkit import plots, se2
from slamkit.errors import InputError

pytestmark = pytest.mark.filterwarnings("error")


@given(SEEDS, st.floats(0.01, 0.999))
def test_outline_lies_where_the_mahalanobis_distance_is_the_quantile(seed: int, probability: float) -> None:
    rng = np.random.default_rng(seed)
    P, mu = covariances(rng, 5, 2, (1.0, 0.2)), rng.normal(size=(5, 2))
    d = plots.ellipses(mu, P, probability) - mu[:, None]
    squared = np.einsum("npi,nij,npj->np", d, np.linalg.inv(P), d)
    np.testing.assert_allclose(squared, chi2.ppf(probability, 2), rtol=1e-8)


@pytest.mark.parametrize("probability", [0.5, 0.95])
def test_ellipse_holds_the_stated_share_of_its_gaussian(probability: float) -> None:
    rng = np.random.default_rng(4)
    mu, P, n = np.array([3.0, -2.0]), np.array([[2.0, 1.5], [1.5, 1.7]]), 40_000
    outline = Outline(plots.ellipses([mu], [P], probability, points=400)[0])
    inside = np.mean(outline.contains_points(rng.multivariate_normal(mu, P, n)))
    assert abs(inside - probability) < 4 * np.sqrt(probability * (1 - probability) / n)


@given(SEEDS)
@settings(max_examples=30)
def test_ellipses_move_with_their_gaussian(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, mu, T = covariances(rng, 3, 2, (1.0, 0.3)), rng.normal(size=(3, 2)), rng.uniform(-3, 3, 3)
    C = se2.rotation(T[2])
    moved = plots.ellipses(se2.transform(T, mu), C @ P @ C.T)
    original = se2.transform(T, plots.ellipses(mu, P).reshape(-1, 2)).reshape(moved.shape)
    # An outline may begin at any point: compare the extents of the regions along fixed directions.
    directions = np.stack([np.cos(np.arange(12)), np.sin(np.arange(12))])
    np.testing.assert_allclose((moved @ directions).max(1), (original @ directions).max(1), atol=2e-2)


def test_degenerate_covariances_give_a_segment_or_a_point() -> None:
    P = np.array([np.zeros((2, 2)), [[1.0, 1.0], [1.0, 1.0]], [[1.0, 2.0], [2.0, 1.0]], np.full((2, 2), np.nan)])
    point, segment, indefinite, unknown = plots.ellipses(np.ones((4, 2)), P)
    assert np.all(point == 1.0)
    np.testing.assert_allclose(segment[:, 0], segment[:, 1], atol=1e-7)
    np.testing.assert_allclose(np.ptp(segment[:, 0]), 2 * np.sqrt(chi2.ppf(0.95, 2)), rtol=1e-2)
    assert np.isnan(indefinite).all()
    assert np.isnan(unknown).all()


def test_an_indefinite_landmark_is_counted_in_the_legend() -> None:
    history, _ = run()
    C = history.landmark_covariances.copy()
    C[2] = [[1.0, 2.0], [2.0, 1.0]]
    drawn = plots.plot_map(axes(), replace(history, landmark_covariances=C))["landmark_ellipses"][0]
    assert len(drawn.get_paths()) == len(C) - 1
    assert "1 indefinite" in drawn.get_label()


@pytest.mark.parametrize("probability", [0.0, 1.0, -0.2, np.nan])
def test_ellipses_refuse_an_invalid_probability(probability: float) -> None:
    with pytest.raises(InputError, match="between 0 and 1"):
        plots.ellipses([[0, 0]], [np.eye(2)], probability)


def test_ellipses_refuse_different_numbers_of_centres_andcovariances() -> None:
    with pytest.raises(InputError, match="2 centres and 1 cov"):
        plots.ellipses(np.zeros((2, 2)), np.eye(2)[None])


@given(SEEDS)
@settings(max_examples=30)
def test_correlation_is_bounded_and_free_of_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, units = covariances(rng, 1, 7, (1,) * 7)[0], np.exp(rng.normal(size=7))
    rho = plots.correlation(P)
    assert np.abs(rho).max() <= 1 + 1e-12
    np.testing.assert_allclose(np.diag(rho), 1.0)
    np.testing.assert_allclose(plots.correlation(units[:, None] * P * units), rho, atol=1e-12)


def test_an_exactly_known_state_has_no_correlation() -> None:
    P = np.diag([0.0, 0.0, 0.0, 1.0, 2.0])
    P[3, 4] = P[4, 3] = 1.0
    rho = plots.correlation(P)
    assert np.isnan(rho[:3]).all()
    assert np.isnan(rho[:, :3]).all()
    assert rho[3, 4] == pytest.approx(np.sqrt(0.5))
    assert plots.correlation_density(P) == 0.0
    ax = axes()
    shown = plots.plot_correlation(ax, P, time=3)["image"][0]
    draw(ax.figure)
    np.testing.assert_array_equal(np.isnan(rho), shown.get_array().mask)


@given(SEEDS, st.floats(0, 0.99), st.floats(0, 0.99))
def test_density_decreases_with_the_threshold_and_ignores_each_block(seed: int, a: float, b: float) -> None:
    rng = np.random.default_rng(seed)
    P = covariances(rng, 1, 9, (1,) * 9)[0]
    assert plots.correlation_density(P, min(a, b)) >= plots.correlation_density(P, max(a, b))
    blocks = np.zeros_like(P)
    for block in (slice(0, 3), slice(3, 5), slice(5, 7), slice(7, 9)):
        blocks[block, block] = P[block, block]
    assert plots.correlation_density(blocks, 0.0) == 0.0
    shared = blocks + 1e9 * np.ones_like(P)
    assert plots.correlation_density(shared, 0.99) == 1.0


def test_density_over_time_and_over_landmarks() -> None:
    rng = np.random.default_rng(3)
    matrices = [covariances(rng, 1, D, (1,) * D)[0] for D in (3, 5, 7, 11)]
    lines = plots.plot_density(axes(), matrices, thresholds=(0.1, 0.6))["density"]
    for line, limit in zip(lines, (0.1, 0.6), strict=True):
        np.testing.assert_array_equal(line.get_xdata(), [0, 1, 2, 4])
        np.testing.assert_allclose(line.get_ydata(), [100 * plots.correlation_density(P, limit) for P in matrices])
    times = [0.5, 1.0, 2.0, 2.5]
    np.testing.assert_array_equal(plots.plot_density(axes(), matrices, times)["density"][0].get_xdata(), times)
    with pytest.raises(InputError, match=r"4 covariances need \(4,\)"):
        plots.plot_density(axes(), matrices, times[:3])


def test_correlation_image_has_fixed_limits_and_lines_between_blocks() -> None:
    P = covariances(np.random.default_rng(0), 1, 9, (1,) * 9)[0]
    ax = axes()
    drawn = plots.plot_correlation(ax, P, ids=["a", "b", 7])
    image = drawn["image"][0]
    np.testing.assert_allclose(image.get_array(), plots.correlation(P))
    assert image.get_clim() == (-1, 1)
    assert {float(line.get_ydata()[0]) for line in drawn["lines"][::2]} == {3.0, 5.0, 7.0}
    assert [label.get_text() for label in ax.get_xticklabels()] == ["pose", "a", "b", "7"]
    assert "colorbar" not in plots.plot_correlation(axes(), P, colorbar=False)


@pytest.mark.parametrize(
    ("P", "message"),
    [
        (np.zeros((2, 3)), r"\(2, 3\), expected \(D, D\)"),
        (np.diag([1.0, 1.0, 1.0, -1e-3, 1.0]), "variance 3 of P is -0.001"),
        (np.diag([1.0, np.nan, 1.0]), "variance 1 of P is nan"),
        (np.eye(4), r"expected \(3 \+ 2N, 3 \+ 2N\)"),
    ],
)
def test_a_matrix_that_is_not_a_slam_covariance_is_refused(P: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        plots.correlation_density(P)


def test_ids_must_fit_the_covariance() -> None:
    with pytest.raises(InputError, match="1 ids for a covariance of shape"):
        plots.plot_correlation(axes(), np.eye(7), ids=["a"])
