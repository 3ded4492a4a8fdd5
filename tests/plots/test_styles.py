"""Laws of styles: each name has one look, the same in every figure and different from all others."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
import pytest
from drawing import FILTERS, axes, draw, run
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.colors import to_hex

from slamkit import plots
from slamkit.errors import InputError

pytestmark = pytest.mark.filterwarnings("error")

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
    plots.plot_gauge(ax, t, {"gate $0.9$": t, "_mine": t})
    draw(ax.figure)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [r"gate \$0.9\$", " _mine"]


def test_truth_and_dead_reckoning_look_the_same_beside_any_filter() -> None:
    history, truth = run()
    looks = set()
    for name in FILTERS[::4]:
        drawn = plots.plot_map(axes(), replace(history, filter=name), truth, (history.times, history.poses))
        looks.add((drawn["truth"][0].get_color(), drawn["dead_reckoning"][0].get_color()))
    assert looks == {(plots.STYLES["truth"].color, plots.STYLES["dead_reckoning"].color)}
