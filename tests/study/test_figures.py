"""The figures of a study."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_study import recorded, small, world

from slamkit.study import Study, compare


def test_figures(study: Study) -> None:
    figures = study.figures()
    assert set(figures) == {"overview", "nees", "claims", "coverage", "bars", "cost", "gauge"}
    for name, figure in figures.items():
        figure.canvas.draw()
        assert figure.axes, name
    title = figures["overview"].get_suptitle()
    assert f"{study.summary()['ekf']['relative_nees_per_dof']:.2f} in the relative map" in title


@pytest.mark.parametrize("first", [0.0, 1e9])
def test_the_axis_begins_where_the_first_step_begins(first: float) -> None:
    log = recorded()
    moved = replace(
        log,
        control_times=log.control_times + first,
        observation_times=log.observation_times + first,
        end_time=log.end_time + first,
        truth=replace(log.truth, times=log.truth.times + first),
    )
    models = {"motion": world().motion, "sensor": world().sensor}
    aligned = compare(["ekf"], moved, jobs=1, gauge_steps=8, **models)
    for made, steps in ((small(filters=["ekf"], runs=2, gauge_steps=8, jobs=1), 30), (aligned, 30)):
        figures = made.figures()
        for name, n in (("nees", steps), ("gauge", 8)):
            [line] = [x for x in figures[name].axes[0].get_lines() if len(x.get_xdata()) == n]
            np.testing.assert_allclose(line.get_xdata(), np.arange(1, n + 1), atol=1e-6)


def test_own_names_look_different(study: Study) -> None:
    names = ("mine", "yours", "mymodule:MyEKF")
    trials = {n: tuple(replace(t, filter=n) for t in study.trials["ekf"]) for n in names}
    checks = {n: replace(study.gauge["ekf"], filter=n) for n in names}
    own = replace(study, trials=trials, gauge=checks)
    for name, figure in own.figures().items():
        if name not in ("nees", "gauge"):
            continue
        lines = {x.get_label(): x.get_color() for x in figure.axes[0].get_lines() if x.get_label() in names}
        assert set(lines) == set(names) and len(set(lines.values())) == len(names)
