"""Laws of the figures that compare filters: they show the means over the runs in the stated units."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from drawing import FILTERS, axes, draw
from matplotlib.figure import Figure
from scipy.stats import chi2

from slamkit import plots
from slamkit.errors import InputError

pytestmark = pytest.mark.filterwarnings("error")


def test_a_shared_legend_lists_each_label_once() -> None:
    t = np.arange(5.0)
    panels = axes(2)
    for ax in panels:
        plots.plot_gauge(ax, t, dict.fromkeys(FILTERS, t + 1), legend=False)
        assert ax.get_legend() is None
    legend = plots.shared_legend(panels[0].figure, panels)
    draw(panels[0].figure)
    assert [text.get_text() for text in legend.get_texts()] == [plots.style(name).label for name in FILTERS]


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
