"""Figures. A plot function draws into a Matplotlib Axes and returns what it drew: meaning → list of artists."""

from slamkit.plots.axes import Artists, shared_legend
from slamkit.plots.comparison import plot_bars, plot_claim, plot_cost, plot_coverage, plot_gauge, plot_nees
from slamkit.plots.covariance import correlation, correlation_density, ellipses, plot_correlation, plot_density
from slamkit.plots.figure import new_figure, save
from slamkit.plots.run import overview, plot_errors, plot_map, plot_nis
from slamkit.plots.styles import STYLES, Style, register_style, style

__all__ = [
    "STYLES",
    "Artists",
    "Style",
    "correlation",
    "correlation_density",
    "ellipses",
    "new_figure",
    "overview",
    "plot_bars",
    "plot_claim",
    "plot_correlation",
    "plot_cost",
    "plot_coverage",
    "plot_density",
    "plot_errors",
    "plot_gauge",
    "plot_map",
    "plot_nees",
    "plot_nis",
    "register_style",
    "save",
    "shared_legend",
    "style",
]
