"""Whole steps only: what refuses or interrupts a step leaves the filter as it was, and the history goes as far."""

from __future__ import annotations

import copy
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from family import drive
from filter_examples import (
    all_filters,
    every_filter,
    every_form,
    every_order,
    every_storage,
    grown,
    made_of,
    make,
    same,
    untouched,
)

import slamkit
from slamkit import DivergenceError, InputError, Log
from slamkit.models import RangeBearing

SLAMKIT = str(Path(slamkit.__file__).parent)
PRECISE = RangeBearing(1e-9, 1e-9)


def ticks(go: Any, stop_at: int) -> int:
    """Run `go` and let Ctrl-C come at the given line of slamkit that is executed; how many lines there were."""
    seen = 0

    def trace(frame: Any, event: str, argument: Any) -> Any:
        nonlocal seen
        if not frame.f_code.co_filename.startswith(SLAMKIT):
            return None
        if event == "line":
            seen += 1
            if seen == stop_at:
                signal.getsignal(signal.SIGINT)(signal.SIGINT, frame)  # type: ignore[operator,misc,arg-type]
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        go()
    finally:
        sys.settrace(before)
    return seen


@contextmanager
def python_handles_interrupts() -> Iterator[None]:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@all_filters
@every_storage
@every_form
def test_an_interrupted_run_ends_between_two_steps(name: str, storage: Any, form: str) -> None:
    """Ctrl-C anywhere in a run: the history and the belief are at the same step, and the filter goes on from there."""
    motion, sensor = made_of(form, *(getattr(make(name), n) for n in ("motion", "sensor")))
    log = drive(make(name).motion, make(name).sensor, steps=5)
    steps = [step for step in log if step.dt]
    assert len(steps) == len(log)

    def new() -> Any:
        return make(name, motion, sensor, storage=storage, **({"truth": log.truth} if name == "ideal" else {}))

    whole, counted = new(), new()
    expected = whole.run(log)
    with python_handles_interrupts():
        lines = ticks(lambda: counted.run(log), -1)
        assert lines > 100
        for at in np.unique(np.linspace(1, lines, 12 if form == "compiled" else 4, dtype=int)):
            f = new()
            try:
                ticks(lambda f=f: f.run(log), int(at))
                continue  # how many lines a run takes depends on how fast it is
            except KeyboardInterrupt as error:
                history = getattr(error, "history", None)
            if history is None:  # before the first step, or after the last
                assert np.array_equal(f.pose, new().pose) or np.array_equal(f.pose, whole.pose), at
                continue
            done = len(history.times)
            assert np.array_equal(history.poses, expected.poses[:done]), at
            assert np.array_equal(f.pose, expected.poses[done - 1] if done else new().pose), at
            assert history.landmark_ids == f.landmark_ids
            for step in steps[done:]:
                f.step(step.u, step.dt, step.scan)
            np.testing.assert_allclose(f.x, whole.x, atol=1e-9)
            assert f.landmark_ids == whole.landmark_ids


@every_filter
@every_order
@every_storage
@every_form
def test_a_step_that_diverges_changes_nothing(name: str, order: str, storage: Any, form: str) -> None:
    f = grown(name, order=order, storage=storage)
    f.motion, f.sensor = made_of(form, f.motion, PRECISE)
    for act in (
        lambda: f.step((1.0, 0.1), 0.3, {"new": (2.0, 0.3), "L0": (3.0, 0.4), "L1": (2.0, -0.8)}),
        lambda: f.observe("L0", (3.0, 0.4)),
        lambda: f.observe_scan({"new": (2.0, 0.3), "L0": (3.0, 0.4)}),
    ):
        untouched(f, act, DivergenceError)
    assert "new" not in f.landmarks
    f.sensor = RangeBearing(0.1, 0.03)
    f.step((1.0, 0.1), 0.3, {"new": (2.0, 0.3), "L0": (3.0, 0.4)})
    assert np.linalg.eigvalsh(f.P)[0] > 0


@every_filter
@every_order
@every_storage
@every_form
def test_a_run_that_diverges_ends_with_its_last_good_step(name: str, order: str, storage: Any, form: str) -> None:
    models = made_of(form, make(name).motion, PRECISE)
    f, g = (make(name, *models, order=order, storage=storage) for _ in range(2))
    z = [(3.0, 0.1 * k) for k in range(6)] + [(2.0, 0.0), (2.9, 0.2)]
    log = Log(
        np.arange(7.0), [(0.1, 0.05)] * 7, [1.0, 2, 3, 4, 5, 6, 7, 7], [0, 1, 2, 3, 4, 5, 6, 0], z, tuple("abcdefg")
    )
    with pytest.raises(
        DivergenceError, match=r"prior variance of .* noise of 1e-18 .* at time 7\.0 s of the log"
    ) as caught:
        f.run(log)
    history = caught.value.history  # type: ignore[attr-defined]
    assert len(history.times) == 6 and history.landmark_ids == f.landmark_ids == tuple("abcdef")
    assert np.array_equal(history.poses[-1], f.pose)
    assert np.array_equal(history.pose_covariances[-1], f.pose_covariance)
    g.run(log.head(6))
    assert same(f, g)


@every_filter
@every_storage
def test_a_refused_update_changes_nothing(name: str, storage: Any) -> None:
    f = grown(name, storage=storage)
    f.observe("L0", f.sensor.predict(f.pose, f.landmarks["L0"]) + 0.01)

    def position(x: Any) -> Any:
        return x[:2]

    def jacobian(x: Any) -> Any:
        return np.eye(2, len(x))

    def raises(x: Any) -> Any:
        raise RuntimeError("the model had enough")

    z = f.pose[:2] + 0.01
    untouched(f, lambda: f.update(z, raises, raises, 0.1), RuntimeError)
    untouched(f, lambda: f.update(z, jacobian, raises, 0.1), RuntimeError)
    untouched(f, lambda: f.update(z, jacobian, lambda x: x[:3], 0.1), InputError, ValueError)
    untouched(f, lambda: f.update(z, jacobian, lambda x: x[:2] * np.nan, 0.1))
    untouched(f, lambda: f.update(z, jacobian, position, 0.1, residual=lambda a, b: (a - b)[:1]))
    untouched(f, lambda: f.update(z, lambda x: 0 * jacobian(x), lambda x: 0 * x[:2], 0.0), DivergenceError)
    for R in (-0.1, np.nan, "a", np.eye(3), [[1.0, 2.0], [2.0, 1.0]], 1j):
        untouched(f, lambda R=R: f.update(z, jacobian, position, R))
    for bad in (np.nan, [np.nan, 1.0], [1.0, 2.0, 3.0], "ab", [1j, 1.0], [None, 1.0]):
        untouched(f, lambda bad=bad: f.update(bad, jacobian, position, 0.1))
    f.update(z, jacobian, position, 0.1)
    assert np.array_equal(f.z, z)


@every_filter
def test_a_copy_made_before_a_refusal_goes_on_the_same(name: str) -> None:
    f = grown(name)
    twin = copy.deepcopy(f)
    with pytest.raises(InputError):
        f.step((1.0, 0.1), 0.3, {"L0": (2.0, 0.1), "L1": (np.nan, 0.0)})
    z = f.sensor.predict(f.pose, f.landmarks["L0"])
    for g in (f, twin):
        g.step((1.0, 0.1), 0.3, {"L0": z})
    assert same(f, twin)
