"""No filter goes on with numbers that mean nothing: it is right, or it says what the matter is."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from family import FILTERS
from filter_examples import every_filter, every_form, every_order, every_storage, made_of

from slamkit import DivergenceError, InputError
from slamkit.models import RangeBearing, Unicycle

LANDMARKS = np.array([[5.0, 3.0], [-4.0, 6.0], [8.0, -2.0]])
UNSCENTED = [name for name in FILTERS if "ukf" in name]


def is_sound(f: Any) -> bool:
    """Finite, and positive semidefinite but for rounding."""
    P = np.array(f.P)
    return bool(
        np.isfinite(f.x).all() and np.isfinite(P).all() and np.linalg.eigvalsh(P)[0] >= -1e-12 * np.abs(P).max()
    )


def refusal(act: Callable[[], Any], kind: type[Exception]) -> str:
    """What the act was refused with; empty if it was not."""
    try:
        act()
    except kind as error:
        return str(error)
    return ""


def drive(f: Any, sd: tuple[float, float], steps: int) -> None:
    pose, rng = np.zeros(3), np.random.default_rng(3)
    for _ in range(steps):
        pose = f.motion.move(pose, np.array([0.3, 0.1]), 0.1)
        f.step(
            (0.3, 0.1), 0.1, {i: f.sensor.predict(pose, at) + sd * rng.normal(size=2) for i, at in enumerate(LANDMARKS)}
        )


@every_filter
@every_order
@every_storage
@pytest.mark.parametrize("prior", [0.0, 1.0, 1e2, 1e4, 1e6, 1e9])
def test_a_start_unknown_by_a_kilometre_is_mapped_right_or_refused(
    name: str, order: str, storage: Any, prior: float
) -> None:
    """Where the start is, is a gauge: distances between landmarks do not depend on how well it is known."""
    sd = (1e-4, 1e-5)
    f = FILTERS[name](
        Unicycle(1e-3, 1e-3),
        RangeBearing(*sd),
        (0, 0, 0),
        np.diag([prior, prior, min(prior, 1.0)]),
        order,
        storage=storage,
    )
    said = refusal(lambda: drive(f, sd, 60), DivergenceError)
    if said:
        assert prior >= 1e4, "well within a double's digits"
        assert f"prior variance of {prior:.3g} beside a measurement noise of 1e-10" in said
        assert np.hypot(*f.pose[:2]) < 0.05, "at the first update, before anything is wrong"
    else:
        assert prior <= 1e4 or name == "robocentric"
        at = np.array(list(f.landmarks.values()))
        if prior == 0.0 or name == "robocentric":
            assert abs(np.hypot(*(at[0] - at[1])) - np.sqrt(90)) < 1e-3
    assert is_sound(f)


@every_filter
@pytest.mark.parametrize("alpha", [None, 1e-3, 1.0])
@pytest.mark.parametrize("distance", [1e-9, 1e-6, 1e-3, 1e-2, 0.05, 0.1, 0.3])
def test_a_landmark_near_the_robot_leaves_no_nan(name: str, alpha: float | None, distance: float) -> None:
    options = {} if alpha is None else {"alpha": alpha}
    if options and name not in UNSCENTED:
        pytest.skip("has no sigma points")
    f = FILTERS[name](Unicycle(0.1, 0.05), RangeBearing(0.1, 0.02), (0, 0, 0), np.eye(3) * 0.01, **options)
    for _ in range(6):
        said = refusal(lambda: f.observe("a", (distance, 0.0)), InputError)
        assert not said or "too close" in said
        assert is_sound(f)
    if "a" in f.landmarks:
        assert np.hypot(*(f.landmarks["a"] - f.pose[:2])) < 1.0


@every_filter
@every_order
@every_form
@pytest.mark.parametrize("distance", [0.0005, 0.001, 0.002, 0.003, 0.005, 0.007, 0.01, 0.02, 0.05, 0.1])
def test_a_landmark_under_the_robot_moves_the_pose_by_less_than_its_uncertainty(
    name: str, order: str, form: str, distance: float
) -> None:
    """Right are .45 standard deviations, by importance sampling of the prior with the likelihood of z."""
    models = made_of(form, Unicycle(0.1, 0.05), RangeBearing(0.1, 0.05))
    f = FILTERS[name](*models, order=order)
    f.step((1.0, 0.0), 1.0, {"a": (1.0 + distance, 0.0), "b": (4.0, 1.0)})
    f.predict((1.0, 0.0), 1.0)
    x, P = f.pose, f.pose_covariance
    f.observe("a", (0.05, 0.3))
    d = f.pose - x
    assert np.sqrt(d @ np.linalg.solve(P, d)) < 0.5
    assert is_sound(f)
    assert np.all(np.diag(f.pose_covariance) <= 1.01 * np.diag(P))


@pytest.mark.parametrize("name", UNSCENTED)
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.0, 2.5])
def test_sigma_points_are_used_where_the_sensor_is_smooth(name: str, angle: float) -> None:
    """A heading known to 10 degrees bends a range by more than its noise, and is no reason to use Jacobians."""
    f, g = (
        FILTERS[n](Unicycle(0.1, 0.05), RangeBearing(0.1, 0.05), pose_covariance=np.diag([0, 0, 0.03]))
        for n in (name, "ekf")
    )
    for h in (f, g):
        h.observe("a", (10.0, angle))
        h.predict((1.0, 0.0), 1.0)
        h.observe("a", (9.2, angle))
    assert f.y[0] != pytest.approx(g.y[0], abs=1e-4), "the mean over sigma points is not the measurement of the mean"


@every_filter
@every_order
@every_storage
def test_a_sensor_that_is_too_precise_is_refused_or_right(name: str, order: str, storage: Any) -> None:
    f = FILTERS[name](
        Unicycle(0.1, 0.05), RangeBearing(1e-9, 1e-9), (0, 0, 0), np.eye(3) * 0.01, order, storage=storage
    )
    said = refusal(lambda: drive(f, (0.0, 0.0), 40), DivergenceError)
    assert not said or "beside a measurement noise of 1e-18" in said
    assert is_sound(f)
