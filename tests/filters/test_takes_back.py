"""A filter takes whole steps: what is refused or interrupted leaves no trace."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from family import ALL, FILTERS, ORDERS, PlainMotion, PlainSensor, drive

from slamkit import Log, Storage, Truth
from slamkit.belief import Belief
from slamkit.errors import DivergenceError, InputError, MemoryCapError, ModelError, SlamkitError
from slamkit.logs import read_archive, write_archive
from slamkit.models import Odometry, RangeBearing, RelativePosition, Unicycle

MODELS = Unicycle(0.1, 0.05), RangeBearing(0.1, 0.03)
PLAIN = PlainMotion(MODELS[0]), PlainSensor(MODELS[1])
#: A default belief of so many landmarks has no room for another.
FULL = 8


def filled(name: str, landmarks: int, **options: Any) -> Any:
    f = ALL[name](*MODELS, [0.1, 0.2, 0.3], np.eye(3) * 0.01, **options)
    f.observe_scan({i: (3 + 0.1 * i, 0.1 * i) for i in range(landmarks)})
    return f


@pytest.mark.parametrize("name", ALL)
def test_a_step_that_makes_room_is_like_one_that_has_room(name: str) -> None:
    truth = Truth([0.0, 0.1, 0.2], np.ones((3, 3)), {i: (3.0 + i, 2.0 - i) for i in range(40)})
    extra = {"truth": truth} if name == "ideal" else {}
    narrow, roomy = filled(name, FULL - 1, **extra), filled(name, FULL - 1, **extra)
    roomy._belief.reserve(30)
    for f in (narrow, roomy):
        f.step((1.0, 0.2), 0.1, {i: (4.0, 0.1 * i) for i in range(12)})
        f.observe("new" if name != "ideal" else 20, (5.0, 0.3))
    assert np.array_equal(narrow.x, roomy.x)
    assert np.array_equal(narrow.P, roomy.P)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize(
    ("refused", "error"),
    [
        (lambda f: f.predict(np.ones(5), 0.0), InputError),
        (lambda f: f.predict(np.ones(5), 0.1), Exception),  # the model's own
        (lambda f: f.predict(np.full(5, np.nan), 0.1), SlamkitError),
        (lambda f: f.step(np.ones(5), 0.1, {"a": (np.nan, 0.1)}), InputError),
        (lambda f: f.run(Log([0.0], [np.ones(5)], [], [], np.empty((0, 2)), (), end_time=1.0)), Exception),
        (lambda f: f.predict(np.ones(10**6), 0.1), MemoryCapError),
    ],
)
def test_a_control_that_is_refused_does_not_say_how_long_controls_are(
    name: str, refused: Callable[[Any], Any], error: type[Exception]
) -> None:
    f = FILTERS[name](*PLAIN)
    with pytest.raises(error):
        refused(f)
    assert f.dim_u == 0
    f.predict((1.0, 0.1), 0.1)
    assert f.dim_u == 2
    f.motion = PlainMotion(Odometry(0.1, 0.1, 0.1, 0.1))
    f.predict((0.1, 1.0, 0.1), 0.1)
    assert f.dim_u == 3


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("landmarks", [3, 30])
@pytest.mark.parametrize("variance", [1e100, 1e300])
def test_a_prediction_beyond_a_doubles_digits_is_taken_back_wholly(name: str, landmarks: int, variance: float) -> None:
    f = filled(name, landmarks)
    f.motion = Unicycle(0.1, 0.05, pose_noise=np.diag([variance, variance, 0.1]))
    x, P, F, Q = f.x, f.P, f.F, f.Q
    y, S = f.y, f.S
    try:
        f.step((1.0, 0.2), 0.1, {0: (3.0, 0.1), 1: (3.1, 0.2)})
    except (DivergenceError, ModelError):
        pass
    else:  # sigma points so far apart make a sighting say nothing
        assert "ukf" in name and np.isfinite(f.x).all()
        assert np.linalg.eigvalsh(f.P / np.max(f.P))[0] > -1e-9
        return
    for before, after in zip((x, P, F, Q, y, S), (f.x, f.P, f.F, f.Q, f.y, f.S), strict=True):
        assert np.array_equal(before, after)


@pytest.mark.parametrize("name", [name for name in FILTERS if "ukf" in name])
@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("landmarks", [2, 30])
@pytest.mark.parametrize("distance", [1e-5, 1e-3, 0.02, 0.1, 0.3])
@pytest.mark.parametrize("alpha", [2.5e-2, 1.0])
def test_a_sighting_too_close_for_sigma_points_starts_no_landmark(
    name: str, order: str, landmarks: int, distance: float, alpha: float
) -> None:
    f = filled(name, landmarks, order=order, alpha=alpha)
    for _ in range(3):
        f.observe_scan({0: (3.0, 0.0), "close": (distance, 0.0), "far": (6.0, 1.0)})
        assert np.isfinite(f.x).all() and np.isfinite(f.P).all()
        assert np.linalg.eigvalsh(f.P)[0] > -1e-12
        assert "far" in f.landmark_ids


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("ids", [[[1]], [{}], None, 3, "0", ["nobody"]])
def test_marginals_are_asked_for_by_ids(name: str, ids: Any) -> None:
    with pytest.raises(InputError):
        filled(name, 3).marginal(ids)


@pytest.mark.parametrize("name", FILTERS)
@pytest.mark.parametrize("landmarks", [2, 30])
def test_a_landmark_beyond_a_doubles_range_is_not_started(name: str, landmarks: int) -> None:
    f = filled(name, landmarks)
    f.sensor = RelativePosition(0.1)
    f.observe_scan({"so far": (1e200, 0.1), "near": (5.0, 0.1)})
    assert f.landmark_ids == (*range(landmarks), "near")
    assert np.isfinite(f.P).all()


def pressing(act: Callable[..., Any]) -> Callable[..., Any]:
    """The function, with a Ctrl-C at its first call from now on."""
    pressed = False

    def with_interrupt(*arguments: Any, **options: Any) -> Any:
        nonlocal pressed
        if not pressed:
            pressed = True
            os.kill(os.getpid(), signal.SIGINT)
        return act(*arguments, **options)

    return with_interrupt


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("where", ["register", "grow_for", "snapshot", "restore", "reserve"])
@pytest.mark.parametrize("plain", [False, True])
def test_an_interrupt_is_heard_between_whole_steps(
    name: str, where: str, plain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = drive(*MODELS, landmarks=12)
    f, g = (ALL[name](*(PLAIN if plain else MODELS), [0.3, -0.2, 3.0], np.eye(3) * 0.01) for _ in range(2))
    whole = g.run(log)
    with monkeypatch.context() as patched:
        patched.setattr(Belief, where, pressing(getattr(Belief, where)))
        try:
            done = len(f.run(log).times)  # where it is not called
        except KeyboardInterrupt as interrupt:
            done = len(interrupt.history.times) if hasattr(interrupt, "history") else 0
    assert f.landmark_ids == g.landmark_ids[: len(f.landmark_ids)]
    assert f.dim_x == 3 + 2 * len(f.landmark_ids)
    if done:
        assert np.array_equal(f.pose, whole.poses[done - 1])
    if done < len(log) and name != "ideal":
        for step in list(log)[done:]:
            f.step(step.u, step.dt, step.scan)
        assert np.array_equal(f.pose, whole.poses[-1])


@pytest.mark.parametrize("name", [name for name in FILTERS if FILTERS[name].compresses and name != "ukf-full"])
def test_what_rests_in_a_file_must_be_a_covariance(name: str, tmp_path: Any) -> None:
    f = filled(name, 9, storage=Storage(compress_above=3))
    f.step((1.0, 0.2), 0.1, {0: (3.0, 0.1)})
    f.save(tmp_path / "sound")
    facts, arrays = read_archive(tmp_path / "sound", "filter")
    assert arrays["resting.columns"] > 0

    def refused(match: str, **changed: Any) -> None:
        write_archive(tmp_path / "changed", "filter", facts, arrays | changed)
        with pytest.raises(InputError, match=match):
            FILTERS[name].load(tmp_path / "changed")

    # Every pair of entries could be those of a covariance, all of them together could not.
    D, store = f.dim_x, arrays["resting.store"].copy()
    rows = store[: 64 * 64].reshape(64, 64)
    rows[5:11, 5:11] = -0.9 * 10 + 1.9 * 10 * np.eye(6)
    rows[5:11, :5] = rows[11:D, 5:11] = 0.0
    refused("resting.store is not positive semidefinite", **{"resting.store": store})
    for field in ("mean", "linearised_at", "cov"):
        changed = arrays[f"belief.{field}"].copy()
        changed.flat[0] += 1e-3
        refused(f"belief.{field} .* what is stored of the base", **{f"belief.{field}": changed})
