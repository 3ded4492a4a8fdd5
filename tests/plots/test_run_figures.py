"""Laws of the figures of one run: they show the data in the stated units and never overlap."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from drawing import SEEDS, axes, draw, run
from hypothesis import given, settings
from scipy.stats import chi2

from slamkit import plots, se2
from slamkit.errors import InputError
from slamkit.logs import History, Log, Truth

pytestmark = pytest.mark.filterwarnings("error")


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


@pytest.mark.parametrize("first", [0.0, 1.2e9])
def test_the_time_axes_of_a_run_begin_where_its_first_step_begins(first: float) -> None:
    """A run of 120 steps of 0.5 s lasts 60 s, and its first estimate is 0.5 s after the start."""
    history, truth = run(start=first)
    controls = first + 0.5 * np.arange(len(history.times))
    none = np.zeros(0)
    log = Log(controls, np.zeros((len(controls), 2)), none, none.astype(int), np.zeros((0, 2)), (), first + 60.0)
    np.testing.assert_array_equal(log.schedule.times, history.times)
    figure = plots.overview(history, log, truth=truth)
    panels = {ax.get_ylabel(): ax for ax in figure.axes}
    for label in ("x error [m]", "y error [m]", "heading\nerror [deg]", "NIS"):
        assert panels[label].get_xlim() == (0.0, 60.0)
    (error,) = (line for line in panels["x error [m]"].lines if line.get_label().startswith("error"))
    np.testing.assert_allclose(error.get_xdata(), 0.5 * np.arange(1, 121))
    drawn = plots.plot_nis(axes(), history, start=first)
    known = np.isfinite(history.nis) & history.accepted
    np.testing.assert_allclose(drawn["nis"][0].get_xdata(), (history.observation_times - first)[known])


def test_error_panels_share_only_their_time_axis() -> None:
    history, truth = run()
    panels = {ax.get_ylabel(): ax for ax in plots.overview(history, truth=truth).axes}
    x, y, heading = (panels[label] for label in ("x error [m]", "y error [m]", "heading\nerror [deg]"))
    heading.set_xlim(3, 7)
    assert x.get_xlim() == y.get_xlim() == (3, 7)
    assert len({x.get_ylim(), y.get_ylim(), heading.get_ylim()}) == 3


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
