"""Laws of the figures: they show the data in the stated units, and styles are stable, distinct and never overlap."""

from __future__ import annotations

import pickle
import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.path import Path as Outline
from scipy.stats import chi2

from slamkit import plots, se2
from slamkit.errors import InputError
from slamkit.logs import History, Log, Truth

pytestmark = pytest.mark.filterwarnings("error")

FILTERS = ("ekf", "fej", "oc", "invariant", "iterated", "ideal", "robocentric", "ukf", "ukf-full", "oc-ukf")
SEEDS = st.integers(0, 2**32 - 1)


def run(seed: int = 0, K: int = 120, L: int = 6, M: int = 400, start: float = 0.0) -> tuple[History, Truth]:
    """A history whose errors are drawn from its covariances, and its truth."""
    rng = np.random.default_rng(seed)
    t = start + 0.5 * np.arange(1, K + 1)
    phi = 0.05 * np.arange(K)
    truth = np.stack([8 * np.cos(phi), 6 * np.sin(phi), se2.wrap(phi + np.pi / 2)], -1).reshape(K, 3)
    P = _covariances(rng, K, 3, (0.1, 0.2, 0.05))
    places, C = rng.uniform(-10, 10, (L, 2)), _covariances(rng, L, 2, (0.3, 0.1))
    error = np.einsum("kij,kj->ki", np.linalg.cholesky(P), rng.normal(size=(K, 3)))
    innovations = rng.normal(size=(M, 2))
    nis = np.sum(innovations**2, -1)
    nis[:L] = np.nan
    history = History(
        filter="ekf",
        times=t,
        poses=np.concatenate([(truth + error)[:, :2], se2.wrap((truth + error)[:, 2])[:, None]], -1),
        pose_covariances=P,
        observation_times=np.sort(rng.choice(t, M)) if K else np.zeros(M),
        observation_ids=rng.integers(0, max(L, 1), M),
        innovations=innovations,
        nis=nis,
        accepted=~(nis > 9.21),
        landmark_ids=tuple(f"L{i}" for i in range(L)),
        landmarks=places + np.einsum("lij,lj->li", np.linalg.cholesky(C), rng.normal(size=(L, 2))),
        landmark_covariances=C,
    )
    return history, Truth(t, truth, {f"L{i}": p for i, p in enumerate(places)})


def _covariances(rng: np.random.Generator, n: int, d: int, scale: tuple[float, ...]) -> Any:
    A = rng.normal(size=(n, d, d)) * np.array(scale)[:, None]
    return A @ A.swapaxes(1, 2) + 1e-4 * np.eye(d)


def axes(n: int = 1, size: tuple[float, float] = (6.0, 4.0)) -> Any:
    panels = Figure(figsize=size, layout="constrained").subplots(n, 1)
    return panels


def draw(figure: Figure) -> Any:
    """Lay the figure out, draw it, and return the renderer."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas.get_renderer()


# -- ellipses ----------------------------------------------------------------------------------------------------------


@given(SEEDS, st.floats(0.01, 0.999))
def test_outline_lies_where_the_mahalanobis_distance_is_the_quantile(seed: int, probability: float) -> None:
    rng = np.random.default_rng(seed)
    P, mu = _covariances(rng, 5, 2, (1.0, 0.2)), rng.normal(size=(5, 2))
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
    P, mu, T = _covariances(rng, 3, 2, (1.0, 0.3)), rng.normal(size=(3, 2)), rng.uniform(-3, 3, 3)
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


def test_ellipses_refuse_different_numbers_of_centres_and_covariances() -> None:
    with pytest.raises(InputError, match="2 centres and 1 cov"):
        plots.ellipses(np.zeros((2, 2)), np.eye(2)[None])


# -- one run -----------------------------------------------------------------------------------------------------------


@given(SEEDS)
@settings(max_examples=4)
def test_map_draws_the_estimate_moved_by_the_alignment(seed: int) -> None:
    history, truth = run(seed)
    T = np.random.default_rng(seed).uniform(-3, 3, 3)
    reckoned = (history.times, history.poses + 1.0)
    drawn = plots.plot_map(axes(), history, truth, reckoned, T, pose_ellipses=4)
    np.testing.assert_allclose(drawn["estimate"][0].get_xydata(), se2.transform(T, history.poses[:, :2]))
    np.testing.assert_allclose(drawn["dead_reckoning"][0].get_xydata(), se2.transform(T, reckoned[1][:, :2]))
    np.testing.assert_allclose(drawn["landmarks"][0].get_xydata(), se2.transform(T, history.landmarks))
    np.testing.assert_array_equal(drawn["truth"][0].get_xydata(), truth.poses[:, :2])
    np.testing.assert_array_equal(drawn["true_landmarks"][0].get_xydata(), list(truth.landmarks.values()))
    C = se2.rotation(T[2])
    for path, at, P in zip(
        drawn["landmark_ellipses"][0].get_paths(),
        se2.transform(T, history.landmarks),
        C @ history.landmark_covariances @ C.T,
        strict=True,
    ):
        d = path.vertices - at
        np.testing.assert_allclose(np.einsum("pi,ij,pj->p", d, np.linalg.inv(P), d), chi2.ppf(0.95, 2), rtol=1e-6)
    last = drawn["pose_ellipses"][0].get_paths()[-1].vertices - drawn["estimate"][0].get_xydata()[-1]
    P = C @ history.pose_covariances[-1, :2, :2] @ C.T
    np.testing.assert_allclose(np.einsum("pi,ij,pj->p", last, np.linalg.inv(P), last), chi2.ppf(0.95, 2), rtol=1e-6)
    assert len(drawn["pose_ellipses"][0].get_paths()) == 4
    assert [text.get_text() for text in drawn["ids"]] == list(history.landmark_ids)


def test_map_shows_all_that_it_draws_with_equal_axes() -> None:
    history, truth = run()
    huge = replace(history, landmark_covariances=history.landmark_covariances * 1e4)
    ax = axes()
    drawn = plots.plot_map(ax, huge, truth)
    draw(ax.figure)
    (x0, x1), (y0, y1) = ax.get_xlim(), ax.get_ylim()
    vertices = np.concatenate([path.vertices for path in drawn["landmark_ellipses"][0].get_paths()])
    assert np.all((vertices > [x0, y0]) & (vertices < [x1, y1]))
    box = ax.get_window_extent()
    assert box.width / (x1 - x0) == pytest.approx(box.height / (y1 - y0), rel=1e-6)


def test_many_landmarks_are_not_labelled() -> None:
    history, _ = run(L=31)
    assert "ids" not in plots.plot_map(axes(), history)


def test_errors_are_estimate_minus_truth_in_metres_and_degrees() -> None:
    history, truth = run(start=1.2e9)
    drawn = plots.plot_errors(axes(3), history, truth)
    expected = history.poses - truth.poses
    expected[:, 2] = np.degrees(se2.wrap(expected[:, 2]))
    assert np.abs(expected[:, 2]).max() < 90  # the run crosses ±π, where an unwrapped error would be near 360
    for line, e in zip(drawn["error"], expected.T, strict=True):
        np.testing.assert_allclose(line.get_xdata(), history.times - history.times[0])
        np.testing.assert_allclose(line.get_ydata(), e, atol=1e-9)


@given(SEEDS)
@settings(max_examples=4)
def test_errors_and_claims_do_not_depend_on_the_frame_of_the_estimate(seed: int) -> None:
    history, truth = run(seed)
    T = np.random.default_rng(seed).uniform(-3, 3, 3)
    back = np.eye(3)
    back[:2, :2] = se2.rotation(-T[2])
    elsewhere = replace(
        history,
        poses=se2.compose(se2.inverse(T), history.poses),
        pose_covariances=back @ history.pose_covariances @ back.T,
    )
    here, there = plots.plot_errors(axes(3), history, truth), plots.plot_errors(axes(3), elsewhere, truth, T)
    for a, b in zip(here["error"], there["error"], strict=True):
        np.testing.assert_allclose(a.get_ydata(), b.get_ydata(), atol=1e-9)
    for a, b in zip(here["band"], there["band"], strict=True):
        np.testing.assert_allclose(a.get_paths()[0].vertices, b.get_paths()[0].vertices, atol=1e-9)


@pytest.mark.parametrize("sigmas", [1.0, 3.0])
def test_claimed_band_is_the_stated_multiple_of_the_deviation(sigmas: float) -> None:
    history, _ = run()
    drawn = plots.plot_errors(axes(3), history, sigmas=sigmas)
    assert "error" not in drawn
    for k, band in enumerate(drawn["band"]):
        deviation = np.sqrt(history.pose_covariances[:, k, k]) * (np.degrees(1) if k == 2 else 1)
        assert np.abs(band.get_paths()[0].vertices[:, 1]).max() == pytest.approx(sigmas * deviation.max())


def test_truth_is_matched_by_nearest_time_and_never_bridged() -> None:
    history, truth = run()
    rows = np.r_[0:40, 100:120]
    parts = Truth(truth.times[rows] + 0.03, truth.poses[rows])
    drawn = plots.plot_errors(axes(3), history, parts)
    y = drawn["error"][0].get_ydata()
    np.testing.assert_allclose(y[np.isfinite(y)], (history.poses - truth.poses)[rows, 0])
    assert np.flatnonzero(np.isnan(y)).tolist() == [40]
    assert "error" not in plots.plot_errors(axes(3), history, parts, tolerance=0.02)


def test_few_truths_are_dots() -> None:
    history, truth = run()
    few = Truth(truth.times[::40], truth.poses[::40])
    for line in (*plots.plot_errors(axes(3), history, few)["error"], *plots.plot_map(axes(), history, few)["truth"]):
        assert line.get_linestyle() == "None"
        assert line.get_marker() == "."


def test_errors_need_three_axes() -> None:
    history, truth = run()
    with pytest.raises(InputError, match="2 axes, expected 3"):
        plots.plot_errors(axes(2), history, truth)


@pytest.mark.parametrize("alignment", [(1.0, 2.0), (0.0, np.nan, 0.0), np.eye(3)])
def test_an_alignment_is_a_finite_pose(alignment: Any) -> None:
    history, truth = run()
    with pytest.raises(InputError, match="alignment"):
        plots.plot_map(axes(), history, truth, alignment=alignment)


def test_nis_draws_every_innovation_once() -> None:
    history, _ = run(start=1.2e9)
    drawn = plots.plot_nis(axes(), history, window=25)
    known = np.isfinite(history.nis)
    accepted, refused = known & history.accepted, known & ~history.accepted
    assert refused.any()
    elapsed = history.observation_times - history.times[0]
    np.testing.assert_array_equal(drawn["nis"][0].get_xydata(), np.c_[elapsed, history.nis][accepted])
    np.testing.assert_array_equal(drawn["rejected"][0].get_xydata(), np.c_[elapsed, history.nis][refused])
    mean, nis = drawn["mean"][0].get_ydata(), history.nis[accepted]
    np.testing.assert_allclose(mean, [nis[k : k + 25].mean() for k in range(len(nis) - 24)])


def test_nis_bands_hold_the_stated_share_of_white_innovations() -> None:
    history, _ = run(M=40_000)
    history = replace(history, accepted=np.ones(40_000, dtype=bool))
    drawn = plots.plot_nis(axes(), history, window=20, probability=0.9)
    for band, values in (
        (drawn["band"][0], drawn["nis"][0].get_ydata()),
        (drawn["mean_band"][0], drawn["mean"][0].get_ydata()[::20]),
    ):
        low, high = band.get_y(), band.get_y() + band.get_height()
        share = np.mean((values > low) & (values < high))
        assert abs(share - 0.9) < 4 * np.sqrt(0.09 / len(values))


def test_nis_axis_is_logarithmic_only_where_needed() -> None:
    history, _ = run()
    outlier = history.nis.copy()
    outlier[-1] = 1e4
    for nis, log, scale in (
        (history.nis, None, "linear"),
        (outlier, None, "log"),
        (outlier, False, "linear"),
        (history.nis, True, "log"),
    ):
        ax = axes()
        plots.plot_nis(ax, replace(history, nis=nis), log=log)
        assert ax.get_yscale() == scale
        assert ax.get_ylim()[1] > np.nanmax(nis)


def test_nis_refuses_an_empty_window() -> None:
    with pytest.raises(InputError, match="window is 0"):
        plots.plot_nis(axes(), run()[0], window=0)


# -- correlations ------------------------------------------------------------------------------------------------------


@given(SEEDS)
@settings(max_examples=30)
def test_correlation_is_bounded_and_free_of_units(seed: int) -> None:
    rng = np.random.default_rng(seed)
    P, units = _covariances(rng, 1, 7, (1,) * 7)[0], np.exp(rng.normal(size=7))
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
    P = _covariances(rng, 1, 9, (1,) * 9)[0]
    assert plots.correlation_density(P, min(a, b)) >= plots.correlation_density(P, max(a, b))
    blocks = np.zeros_like(P)
    for block in (slice(0, 3), slice(3, 5), slice(5, 7), slice(7, 9)):
        blocks[block, block] = P[block, block]
    assert plots.correlation_density(blocks, 0.0) == 0.0
    shared = blocks + 1e9 * np.ones_like(P)
    assert plots.correlation_density(shared, 0.99) == 1.0


def test_density_over_time_and_over_landmarks() -> None:
    rng = np.random.default_rng(3)
    matrices = [_covariances(rng, 1, D, (1,) * D)[0] for D in (3, 5, 7, 11)]
    lines = plots.plot_density(axes(), matrices, thresholds=(0.1, 0.6))["density"]
    for line, limit in zip(lines, (0.1, 0.6), strict=True):
        np.testing.assert_array_equal(line.get_xdata(), [0, 1, 2, 4])
        np.testing.assert_allclose(line.get_ydata(), [100 * plots.correlation_density(P, limit) for P in matrices])
    times = [0.5, 1.0, 2.0, 2.5]
    np.testing.assert_array_equal(plots.plot_density(axes(), matrices, times)["density"][0].get_xdata(), times)
    with pytest.raises(InputError, match=r"4 covariances need \(4,\)"):
        plots.plot_density(axes(), matrices, times[:3])


def test_correlation_image_has_fixed_limits_and_lines_between_blocks() -> None:
    P = _covariances(np.random.default_rng(0), 1, 9, (1,) * 9)[0]
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


# -- looks -------------------------------------------------------------------------------------------------------------

# Machado, Oliveira & Fernandes (2009), severity 1.
SIGHT = {
    "normal": np.eye(3),
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
}


def _lab(color: str, sight: Any) -> Any:
    """CIELAB (D65) of a colour for one kind of sight."""
    srgb = np.array([int(color[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.clip(np.asarray(sight) @ np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4), 0, 1)
    to_xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    xyz = to_xyz @ linear / [0.9505, 1.0, 1.089]
    f = np.where(xyz > 0.008856, np.cbrt(xyz), 7.787 * xyz + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("sight", SIGHT)
def test_colours_differ_for_every_kind_of_sight(sight: str) -> None:
    seen = {name: _lab(s.color, SIGHT[sight]) for name, s in plots.STYLES.items()}
    closest = min((float(np.linalg.norm(seen[a] - seen[b])), a, b) for a, b in combinations(seen, 2))
    assert closest[0] > 14, closest


def test_filters_differ_in_grey_by_dashes_and_markers() -> None:
    looks = [plots.style(name) for name in FILTERS]
    assert set(FILTERS) <= set(plots.STYLES)
    assert len({s.dashes for s in looks}) == len(FILTERS)
    assert len({s.marker for s in looks}) == len(FILTERS)
    # All colours are dark enough to be visible in print.
    assert all(_lab(s.color, SIGHT["normal"])[0] < 75 for s in looks)


def test_a_filter_keeps_its_colour_in_every_figure() -> None:
    history, truth = run()
    t = np.arange(4.0)
    for name in ("ekf", "invariant", "oc-ukf", "mine"):
        color = plots.style(name).color
        named = replace(history, filter=name)
        colours = [
            plots.plot_map(axes(), named, truth)["estimate"][0].get_color(),
            to_hex(plots.plot_errors(axes(3), named)["band"][0].get_facecolor()[0]),
            plots.plot_nis(axes(), named)["nis"][0].get_color(),
            plots.plot_nees(axes(), t, {name: t + 1}, 3)[name][0].get_color(),
            to_hex(plots.plot_claim(axes(), name, t, t, t + 1)["band"][0].get_facecolor()[0]),
            plots.plot_gauge(axes(), t, {name: t + 1})[name][0].get_color(),
            plots.plot_coverage(axes(), t / 3, {name: t / 3})[name][0].get_color(),
            to_hex(plots.plot_bars(axes(), {name: 2.0}, label="NEES")[name][0].get_facecolor()),
            plots.plot_cost(axes(), {name: 1e-5}, {name: 0.1})[name][0].get_color(),
        ]
        assert {c.lower() for c in colours} == {color.lower()}


OWN = ("mine", "my EKF", "ekf, gate 0.99", "ekf, gate 0.9", "module:MyEKF", "a", "b", "c", "$x$ filter", "δ")


def _looks(names: tuple[str, ...]) -> dict[str, list[tuple[Any, ...]]]:
    """What tells the names apart in each figure that compares filters: a look for each name."""
    t = np.arange(4.0)
    values = dict.fromkeys(names, t + 1)
    cost = plots.plot_cost(axes(), dict.fromkeys(names, 1e-5), dict.fromkeys(names, 0.1))
    bars = plots.plot_bars(axes(), dict.fromkeys(names, 2.0), label="NEES")
    claims = [plots.plot_claim(axes(), name, t, t, t + 1)["band"][0] for name in names]
    lines = {
        "nees": plots.plot_nees(axes(), t, values, 3),
        "gauge": plots.plot_gauge(axes(), t, values),
        "coverage": plots.plot_coverage(axes(), t / 3, dict.fromkeys(names, t / 3)),
    }
    return {
        **{
            kind: [
                (line.get_color(), line.get_marker(), str(line._unscaled_dash_pattern))
                for line in (drawn[name][0] for name in names)
            ]
            for kind, drawn in lines.items()
        },
        "cost": [(cost[name][0].get_color(), cost[name][0].get_marker()) for name in names],
        "bars": [(to_hex(bars[name][0].get_facecolor()), row) for row, name in enumerate(names)],
        "claims": [(to_hex(band.get_facecolor()[0]), name) for band, name in zip(claims, names, strict=True)],
    }


def test_own_names_differ_in_every_comparative_figure() -> None:
    for kind, looks in _looks((*FILTERS, *OWN)).items():
        assert len(set(looks)) == len(FILTERS) + len(OWN), kind
    # In grey the dashes and the markers tell all of them apart.
    styles = [plots.style(name) for name in (*FILTERS, *OWN)]
    assert len({(s.dashes, s.marker) for s in styles}) == len(styles)


@pytest.mark.parametrize("sight", SIGHT)
def test_seven_own_names_have_colours_that_differ_for_every_kind_of_sight(sight: str, monkeypatch: Any) -> None:
    monkeypatch.setattr("slamkit.plots.styles._looks", {})
    colours = [s.color for s in plots.STYLES.values()] + [plots.style(name).color for name in OWN[:7]]
    seen = [_lab(color, SIGHT[sight]) for color in colours]
    assert min(float(np.linalg.norm(a - b)) for a, b in combinations(seen, 2)) > 14
    assert all(_lab(color, SIGHT["normal"])[0] < 75 for color in colours)


@given(st.lists(st.text(min_size=1), unique=True, max_size=60))
@settings(max_examples=30)
def test_no_two_names_share_a_style(names: list[str]) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("slamkit.plots.styles._looks", {})
        looks = [plots.style(name) for name in names]
        assert looks == [plots.style(name) for name in reversed(names)][::-1]
    own = [s for name, s in zip(names, looks, strict=True) if name not in plots.STYLES]
    every = [*plots.STYLES.values(), *own]
    assert len({(s.color, s.dashes, s.marker) for s in every}) == len(every)


def test_a_name_of_ones_own_has_the_same_style_in_every_process() -> None:
    code = "from slamkit import plots; print(*(plots.style(n) for n in {}), sep='\\n')"
    first, second = (
        subprocess.run([sys.executable, "-c", code.format(names)], capture_output=True, text=True, check=True).stdout
        for names in (("mine", "yours", "third"), ("mine", "yours", "third", "fourth"))
    )
    assert second.startswith(first) and len(set(first.splitlines())) == 3
    alone = subprocess.run([sys.executable, "-c", code.format(("third",))], capture_output=True, text=True, check=True)
    assert alone.stdout == first.splitlines()[2] + "\n"


def test_a_registered_style_is_used_in_every_figure(monkeypatch: Any) -> None:
    monkeypatch.setattr("slamkit.plots.styles.STYLES", dict(plots.STYLES))
    chosen = plots.Style("My EKF", "#123456", (3.0, 1.0), "H")
    plots.register_style("registered", chosen)
    assert plots.style("registered") == chosen
    looks = _looks(("registered", "ekf"))
    assert {look[0][0].lower() for look in looks.values()} == {"#123456"}
    plots.register_style("registered", replace(chosen, color="#654321"))
    assert plots.style("registered").color == "#654321"


@pytest.mark.parametrize(
    ("name", "style"),
    [
        ("", plots.Style("", "#123456", (), "o")),
        (3, plots.Style("", "#123456", (), "o")),
        ("mine", "#123456"),
        ("mine", plots.Style),
        ("mine", plots.Style("", "no colour", (), "o")),
        ("mine", plots.Style("", "#123456", (1.0, 0.0), "o")),
        ("mine", plots.Style("", "#123456", "--", "o")),  # type: ignore[arg-type]
        ("mine", plots.Style("", "#123456", (), "no marker")),
    ],
)
def test_an_invalid_style_is_refused_and_not_registered(name: Any, style: Any) -> None:
    before = dict(plots.STYLES)
    with pytest.raises(InputError, match="expected"):
        plots.register_style(name, style)
    assert before == plots.STYLES


def test_names_and_ids_are_written_as_they_are() -> None:
    history, truth = run(L=2)
    odd = replace(history, filter="gate $0.9$", landmark_ids=("$\\foo$", "$x$"))
    draw(plots.overview(odd, truth=truth))  # as mathematics, \\foo is an error
    t = np.arange(4.0)
    ax = axes()
    plots.plot_gauge(ax, t, {"gate $0.9$": t})
    draw(ax.figure)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [r"gate \$0.9\$"]


def test_truth_and_dead_reckoning_look_the_same_beside_any_filter() -> None:
    history, truth = run()
    looks = set()
    for name in FILTERS[::4]:
        drawn = plots.plot_map(axes(), replace(history, filter=name), truth, (history.times, history.poses))
        looks.add((drawn["truth"][0].get_color(), drawn["dead_reckoning"][0].get_color()))
    assert looks == {(plots.STYLES["truth"].color, plots.STYLES["dead_reckoning"].color)}


SIZES = [(10.0, 7.5), (6.5, 5.5), (12.0, 7.0)]


@pytest.mark.parametrize("size", SIZES)
def test_nothing_overlaps_in_the_overview(size: tuple[float, float]) -> None:
    history, truth = run()
    figure = plots.overview(history, None, (history.times, history.poses + 0.5), truth=truth, size=size)
    renderer = draw(figure)
    panels = figure.axes
    for a, b in combinations(panels, 2):
        one, other = a.get_tightbbox(renderer), b.get_tightbbox(renderer)
        width = min(one.x1, other.x1) - max(one.x0, other.x0)
        height = min(one.y1, other.y1) - max(one.y0, other.y0)
        assert width <= 1 or height <= 1, (a.get_ylabel(), b.get_ylabel())
    for ax in panels:
        legend = ax.get_legend()
        assert legend is None or not legend.get_window_extent().overlaps(ax.get_window_extent())
        box, page = ax.get_tightbbox(renderer), figure.bbox
        assert min(box.x0, box.y0, page.width - box.x1, page.height - box.y1) >= -1


def test_overview_takes_the_truth_of_the_log() -> None:
    history, truth = run()
    log = Log(
        history.times,
        np.zeros((len(history.times), 2)),
        np.zeros(0),
        np.zeros(0, dtype=int),
        np.zeros((0, 2)),
        (),
        truth=truth,
    )
    labels = [text.get_text() for text in plots.overview(history, log).axes[0].get_legend().get_texts()]
    assert labels[:2] == ["truth", plots.style("ekf").label]
    assert "truth" not in [t.get_text() for t in plots.overview(history).axes[0].get_legend().get_texts()]


def test_error_panels_share_only_their_time_axis() -> None:
    history, truth = run()
    panels = {ax.get_ylabel(): ax for ax in plots.overview(history, truth=truth).axes}
    x, y, heading = (panels[label] for label in ("x error [m]", "y error [m]", "heading\nerror [deg]"))
    heading.set_xlim(3, 7)
    assert x.get_xlim() == y.get_xlim() == (3, 7)
    assert len({x.get_ylim(), y.get_ylim(), heading.get_ylim()}) == 3


def test_a_shared_legend_lists_each_label_once() -> None:
    t = np.arange(5.0)
    panels = axes(2)
    for ax in panels:
        plots.plot_gauge(ax, t, dict.fromkeys(FILTERS, t + 1), legend=False)
        assert ax.get_legend() is None
    legend = plots.shared_legend(panels[0].figure, panels)
    draw(panels[0].figure)
    assert [text.get_text() for text in legend.get_texts()] == [plots.style(name).label for name in FILTERS]


# -- Jupyter -----------------------------------------------------------------------------------------------------------


def test_jupyter_displays_a_figure_exactly_once() -> None:
    """IPython displays the value of a cell by its `_repr_png_`, and at the end of a cell every figure of pyplot."""
    code = """
import sys
import numpy as np
from slamkit import plots
from slamkit.logs import History
with plots.new_figure(3, 2) as figure:
    plots.plot_gauge(figure.subplots(), np.arange(3.0), {"ekf": np.ones(3)})
png = figure._repr_png_()
import matplotlib.pyplot
assert matplotlib.pyplot.get_fignums() == []
assert figure._repr_html_() is None
sys.stdout.buffer.write(png)
"""
    png = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout
    assert png.startswith(b"\x89PNG\r\n")
    width, height = (int.from_bytes(png[k : k + 4], "big") for k in (16, 20))
    assert 200 < width < 400 and 100 < height < 300


def test_the_overview_displays_itself() -> None:
    history, truth = run()
    figure: Any = plots.overview(history, truth=truth)
    assert figure._repr_png_().startswith(b"\x89PNG")


def test_a_figure_can_be_pickled() -> None:
    history, truth = run()
    again = pickle.loads(pickle.dumps(plots.overview(history, truth=truth, size=(6.0, 5.0))))
    assert again._repr_png_().startswith(b"\x89PNG")


# -- files and imports -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_the_same_figure_gives_the_same_bytes(suffix: str, tmp_path: Any) -> None:
    history, truth = run(M=60)
    files = []
    for k in "ab":
        ax = axes()
        plots.plot_map(ax, history, truth)
        files.append(plots.save(ax.figure, tmp_path / f"{k}{suffix}", dpi=50))
    first, second = (file.read_bytes() for file in files)
    assert first == second
    assert len(first) > 5000


def test_dots_an_inch_set_the_size_of_a_png(tmp_path: Any) -> None:
    from matplotlib.image import imread

    figure = plots.overview(*run(M=60)[:1])
    low, high = (imread(plots.save(figure, tmp_path / f"{d}.png", dpi=d)).shape for d in (50, 100))
    np.testing.assert_allclose(np.array(high[:2]) / low[:2], 2, rtol=0.02)


def test_a_file_with_another_ending_or_a_missing_folder_is_refused(tmp_path: Any) -> None:
    with pytest.raises(InputError, match=r"'\.docx', expected one of \.png"):
        plots.save(Figure(), tmp_path / "a.docx")
    with pytest.raises(InputError, match="no folder"):
        plots.save(Figure(), tmp_path / "none" / "a.png")


def test_importing_plots_does_not_import_heavy_packages() -> None:
    code = "import sys, slamkit.plots; print(*sorted({'matplotlib', 'pandas', 'numba'} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == ""


# -- degenerate input --------------------------------------------------------------------------------------------------


def _degenerate() -> dict[str, tuple[History, Truth | None]]:
    history, truth = run()
    empty = np.zeros(0)
    return {
        "no truth": (history, None),
        "empty truth": (history, Truth(empty, empty)),
        "no landmarks": run(L=0),
        "no observations": run(M=0, L=0),
        "one step": run(K=1, M=3),
        "no steps": run(K=0, M=0, L=0),
        "exactly known": (
            replace(
                history,
                pose_covariances=np.zeros((120, 3, 3)),
                landmark_covariances=np.zeros((6, 2, 2)),
                poses=truth.poses,
            ),
            truth,
        ),
        "initialisations only": (replace(history, nis=np.full(400, np.nan)), truth),
        "all rejected": (replace(history, accepted=np.zeros(400, dtype=bool)), truth),
        "zero innovations": (replace(history, nis=np.zeros(400)), truth),
        "truth elsewhere": (history, Truth(truth.times + 1e6, truth.poses)),
        "standing": (replace(history, poses=np.zeros((120, 3)), landmarks=np.zeros((6, 2))), None),
        "negative variance": (replace(history, pose_covariances=-history.pose_covariances), truth),
    }


@pytest.mark.parametrize("case", _degenerate())
def test_degenerate_runs_draw_without_a_warning(case: str) -> None:
    history, truth = _degenerate()[case]
    reckoned = None if truth is None else (history.times, history.poses)
    figure = plots.overview(history, None, reckoned, truth=truth)
    figure.set_layout_engine("none")
    plots.plot_nis(figure.add_axes((0.6, 0.05, 0.35, 0.1)), history, log=True, legend=False)
    draw(figure)


# -- comparisons -------------------------------------------------------------------------------------------------------


def test_nees_is_the_mean_over_the_runs_that_have_a_value() -> None:
    rng = np.random.default_rng(2)
    t, values = np.arange(30.0), rng.chisquare(3, (20, 30))
    values[4, 10:] = np.nan
    values[:, -1] = np.nan
    drawn = plots.plot_nees(axes(), t, {"ekf": values, "fej": np.full(30, 3.0)}, 3)
    np.testing.assert_allclose(drawn["ekf"][0].get_ydata()[:-1], np.nanmean(values[:, :-1], 0))
    assert np.isnan(drawn["ekf"][0].get_ydata()[-1])
    band = drawn["band"][0]
    np.testing.assert_allclose(
        [band.get_y(), band.get_y() + band.get_height()], chi2.ppf([0.025, 0.975], 60) / 20, rtol=1e-9
    )


def test_nees_axis_is_logarithmic_if_a_filter_is_far_above_the_band() -> None:
    t = np.arange(5.0)
    for level, scale in ((3.0, "linear"), (300.0, "log")):
        ax = axes()
        plots.plot_nees(ax, t, {"ekf": np.full((10, 5), level)}, 3)
        assert ax.get_yscale() == scale
        assert ax.get_ylim()[0] < level < ax.get_ylim()[1]


def test_claim_draws_every_run_the_claim_and_the_spread() -> None:
    rng = np.random.default_rng(1)
    t, errors, deviations = np.arange(40.0), rng.normal(size=(7, 40)), rng.uniform(0.5, 2, (7, 40))
    drawn = plots.plot_claim(axes(), "ekf", t, errors, deviations, sigmas=2.0)
    np.testing.assert_array_equal([line.get_ydata() for line in drawn["errors"]], errors)
    upper, lower = (line.get_ydata() for line in drawn["spread"])
    np.testing.assert_allclose(upper, 2 * np.sqrt(np.mean(errors**2, 0)))
    np.testing.assert_array_equal(lower, -upper)
    vertices = drawn["band"][0].get_paths()[0].vertices
    assert vertices[:, 1].max() == pytest.approx(2 * np.sqrt(np.mean(deviations**2, 0)).max())


def test_claim_draws_some_of_many_runs_but_uses_all() -> None:
    rng = np.random.default_rng(3)
    t, errors, deviations = np.arange(1000.0), rng.normal(size=(50, 1000)), rng.uniform(0.5, 2, (50, 1000))
    drawn = plots.plot_claim(axes(), "ekf", t, errors, deviations, sigmas=1.0, lines=5, points=100)
    assert drawn["errors"][0].get_label() == "error of 5 of 50 runs"
    np.testing.assert_array_equal([line.get_ydata() for line in drawn["errors"]], errors[:5, ::10])
    spread = drawn["spread"][0]
    blocks = (50, 100, 10)
    np.testing.assert_allclose(spread.get_ydata(), np.sqrt(np.mean(errors.reshape(blocks) ** 2, (0, 2))))
    np.testing.assert_allclose(spread.get_xdata(), t.reshape(100, 10).mean(1))
    claimed = np.sqrt(np.mean(deviations.reshape(blocks) ** 2, (0, 2)))
    assert drawn["band"][0].get_paths()[0].vertices[:, 1].max() == pytest.approx(claimed.max())


def test_one_run_has_no_spread() -> None:
    t = np.arange(5.0)
    drawn = plots.plot_claim(axes(), "ekf", t, t, t + 1)
    assert len(drawn["errors"]) == 1 and drawn["spread"] == []


def test_long_runs_are_drawn_by_means_over_steps() -> None:
    rng = np.random.default_rng(5)
    t, values = np.arange(95.0), rng.chisquare(3, (20, 95))
    values[:, 40:50] = np.nan
    ax = axes()
    drawn = plots.plot_nees(ax, t, {"ekf": values}, 3, points=10)
    expected = [np.nan if k == 4 else values[:, 10 * k : 10 * k + 10].mean() for k in range(10)]
    np.testing.assert_allclose(drawn["ekf"][0].get_ydata(), expected)
    np.testing.assert_allclose(drawn["ekf"][0].get_xdata(), [*np.arange(4.5, 90, 10), 92.0])
    assert ax.get_xlabel() == "time [s], means of 10 steps"


def test_gauge_axis_starts_at_zero_so_that_a_decrease_is_in_proportion() -> None:
    t, ax = np.arange(9.0), axes()
    drawn = plots.plot_gauge(ax, t, {"ekf": 2.3 - 0.1 * t, "oc": np.full((4, 9), 2.3)})
    assert ax.get_ylim()[0] == 0
    np.testing.assert_allclose(drawn["ekf"][0].get_ydata(), 2.3 - 0.1 * t)
    np.testing.assert_allclose(drawn["oc"][0].get_ydata(), 2.3)


def test_coverage_is_drawn_in_percent() -> None:
    levels = np.linspace(0, 1, 11)
    drawn = plots.plot_coverage(axes(), levels, {"ekf": levels**2})
    np.testing.assert_allclose(drawn["ekf"][0].get_xydata(), 100 * np.c_[levels, levels**2])


def test_bars_are_in_the_given_order_with_their_values() -> None:
    values = {"oc": 3.4, "ekf": 11.85, "fej": float("nan")}
    ax = axes()
    drawn = plots.plot_bars(ax, values, {"ekf": 2.46}, label="pose NEES", band=(2.36, 3.72))
    draw(ax.figure)
    for row, (name, value) in enumerate(values.items()):
        bar = drawn[name][0]
        assert bar.get_y() + bar.get_height() / 2 == pytest.approx(row)
        assert bar.get_width() == pytest.approx(value, nan_ok=True)
    assert [text.get_text() for text in ax.get_yticklabels()] == [plots.style(name).label for name in values]
    assert ax.get_xlim()[1] > 11.85 + 2.46
    assert len(drawn["fej"]) == 1


def test_bars_of_a_ratio_reach_from_the_expected_to_the_actual_value() -> None:
    values = {"ekf": 8.0, "fej": 0.5, "oc": 1.0, "ukf": float("nan"), "ideal": 0.0}
    ax = axes()
    drawn = plots.plot_bars(ax, values, {"ekf": 7.9}, label="NEES a dof", band=(0.8, 1.2), reference=1.0)
    draw(ax.figure)
    assert ax.get_xscale() == "log"
    for name in ("ekf", "fej", "oc"):
        edges = np.sort([drawn[name][0].get_x(), drawn[name][0].get_x() + drawn[name][0].get_width()])
        np.testing.assert_allclose(edges, np.sort([1.0, values[name]]))
    assert drawn["ekf"][1].get_text() == "8.00" and drawn["ekf"][1].get_fontweight() == "bold"
    assert drawn["fej"][1].get_fontweight() == drawn["oc"][1].get_fontweight() == "normal"
    assert ax.get_xlim()[0] < 0.5 and ax.get_xlim()[1] > 15.9


def test_cost_is_in_microseconds_and_complete() -> None:
    drawn = plots.plot_cost(axes(), {"ekf": 2e-6, "fej": 3e-4}, {"ekf": 0.9, "fej": 0.7}, {"ekf": 0.1})
    np.testing.assert_allclose(drawn["fej"][0].get_xydata(), [[300.0, 0.7]])
    with pytest.raises(InputError, match="no accuracy for fej; given: ekf"):
        plots.plot_cost(axes(), {"ekf": 2e-6, "fej": 3e-4}, {"ekf": 0.9})


@pytest.mark.parametrize("values", [np.zeros(4), np.zeros((2, 4)), np.zeros((1, 2, 5)), 1.0])
def test_values_that_do_not_fit_the_times_are_refused(values: Any) -> None:
    with pytest.raises(InputError, match=r"values of ekf have shape .*, expected \(5,\) or \(runs, 5\)"):
        plots.plot_nees(axes(), np.arange(5.0), {"ekf": values}, 3)


@pytest.mark.parametrize("names", [(), ("ekf",), FILTERS])
def test_comparisons_draw_without_a_warning_for_any_number_of_filters(names: tuple[str, ...]) -> None:
    t = np.arange(6.0)
    missing = np.full((2, 6), np.nan)
    figure = Figure(figsize=(9, 9), layout="constrained")
    panels = figure.subplots(3, 2).ravel()
    plots.plot_nees(panels[0], t, dict.fromkeys(names, missing), 3)
    plots.plot_claim(panels[1], "ekf", t, missing, missing)
    plots.plot_gauge(panels[2], t, dict.fromkeys(names, missing))
    plots.plot_coverage(panels[3], t / 5, dict.fromkeys(names, missing[0]))
    plots.plot_bars(panels[4], dict.fromkeys(names, float("nan")), label="x [m]")
    plots.plot_cost(panels[5], dict.fromkeys(names, 1e-5), dict.fromkeys(names, 1.0))
    draw(figure)
