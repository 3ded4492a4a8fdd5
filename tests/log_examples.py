"""Logs and histories that the tests of several rooms are tried on."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import fields, replace
from typing import Any

import numpy as np
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from slamkit.errors import LogFileError
from slamkit.logs import History, Log, Truth

# Each example writes over the files of the last one, which is a law of its own.
over_one_folder = settings(max_examples=50, suppress_health_check=[HealthCheck.function_scoped_fixture])

# Quarters of a second tie often, and their sums and differences are exact.
quarters = st.integers(-2, 6).map(lambda n: n / 4)
few_ids: st.SearchStrategy[Hashable] = st.integers(0, 3)
numbers = st.floats(-1e9, 1e9, allow_subnormal=False).map(lambda x: x + 0.0)
any_times = st.floats(-1e12, 1e12).map(lambda t: t + 0.0)
plain_ids: st.SearchStrategy[Hashable] = st.one_of(
    st.integers(), st.text(), st.floats(allow_nan=False), st.booleans(), st.none()
)
ids = st.recursive(plain_ids, lambda parts: st.lists(parts, max_size=3).map(tuple), max_leaves=5)
csv_ids = st.one_of(st.integers(-5, 5), st.text("abc,\"' _-é", min_size=1, max_size=4).filter(lambda t: t.strip() == t))


@st.composite
def logs(
    draw: st.DrawFn,
    times: st.SearchStrategy[float] = quarters,
    names: st.SearchStrategy[Hashable] = few_ids,
    late_observations: bool = True,
) -> Log:
    """Unsorted times, ties, repeated sightings, sightings before the controls and after their end."""
    increments = draw(st.booleans())
    ct = draw(st.lists(times, max_size=6, unique=increments))
    m = draw(st.integers(1, 3))
    u = np.reshape(draw(st.lists(numbers, min_size=m * len(ct), max_size=m * len(ct))), (len(ct), m))
    ot = draw(st.lists(times, min_size=0 if ct else 1, max_size=10))
    landmarks = draw(st.lists(names, min_size=1, max_size=4, unique=True))
    k = draw(st.integers(1, 3))
    z = np.reshape(draw(st.lists(numbers, min_size=k * len(ot), max_size=k * len(ot))), (len(ot), k))
    rows = draw(st.lists(st.integers(0, len(landmarks) - 1), min_size=len(ot), max_size=len(ot)))
    last = max([*ct, *ot])
    end = draw(st.sampled_from([None, last, last + 1.5, *([max(ct)] if ct and late_observations else [])]))
    if increments and ct and (last if end is None else end) <= max(ct):
        u[np.argmax(ct)] = 0.0
    truth = None
    if draw(st.booleans()):
        n = draw(st.integers(0, 3))
        poses = draw(st.lists(st.tuples(numbers, numbers, numbers), min_size=n, max_size=n))
        seen = draw(st.dictionaries(names, st.tuples(numbers, numbers), max_size=3))
        truth = Truth(np.array(draw(st.lists(times, min_size=n, max_size=n))), np.reshape(poses, (n, 3)), seen)
    index = np.array(rows, dtype=np.int64)
    return Log(ct, u, ot, index, z, tuple(landmarks), end, increments, truth)


def small_log() -> Log:
    truth = Truth(np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [1, 0, 0.1]]), {1: (2.0, 3.0), "oak": (4.0, 5.0)})
    return Log(
        [0.0, 1.0], [(1.0, 0.1), (0.5, 0.0)], [0.5, 1.0, 1.0], [0, 0, 1], [(2.0, 0.1), (3.0, 0.2), (4.0, 0.3)],
        (1, "oak"), 2.5, truth=truth,
    )  # fmt: skip


def small_history(landmark_ids: tuple[Hashable, ...] = (1, "oak"), rng: Any = None) -> History:
    rng = np.random.default_rng(3) if rng is None else rng
    L, K, M = len(landmark_ids), 4, 5
    a, b = rng.normal(size=(K, 3, 3)), rng.normal(size=(L, 2, 2))
    innovations, nis = rng.normal(size=(M, 2)), rng.chisquare(2, M)
    innovations[0], nis[0] = np.nan, np.nan
    return History(
        filter="ekf",
        times=np.array([0.0, 0.5, 0.5, 1.0]),
        poses=rng.uniform(-3, 3, (K, 3)),
        pose_covariances=a @ a.transpose(0, 2, 1),
        observation_times=np.sort(rng.uniform(0, 1, M)),
        observation_ids=rng.integers(-1, L, M),
        innovations=innovations,
        nis=nis,
        accepted=rng.random(M) < 0.7,
        landmark_ids=landmark_ids,
        landmarks=rng.normal(size=(L, 2)),
        landmark_covariances=b @ b.transpose(0, 2, 1),
    )


def same(a: Any, b: Any) -> bool:
    """Equal to the bit and in type, through dataclasses, dicts and tuples."""
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return same(tuple(a.items()), tuple(b.items()))
    if hasattr(a, "__dataclass_fields__"):
        return type(a) is type(b) and all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return type(a) is type(b) and repr(a) == repr(b)


def outcome(read: Callable[[], Any]) -> tuple[Any, LogFileError | None]:
    try:
        return read(), None
    except LogFileError as error:
        return None, error


def permuted(log: Log, rng: np.random.Generator) -> Log:
    c, o = rng.permutation(len(log.controls)), rng.permutation(len(log.observations))
    truth = log.truth
    if truth is not None:
        t = rng.permutation(len(truth.times))
        truth = replace(truth, times=truth.times[t], poses=truth.poses[t])
    return replace(
        log,
        control_times=log.control_times[c],
        controls=log.controls[c],
        observation_times=log.observation_times[o],
        observation_ids=log.observation_ids[o],
        observations=log.observations[o],
        truth=truth,
    )


GOOD: dict[str, Any] = {
    "control_times": [0.0, 1.0],
    "controls": [(1.0, 0.0), (1.0, 0.1)],
    "observation_times": [0.5],
    "observation_ids": [0],
    "observations": [(2.0, 0.1)],
    "landmark_ids": ("a",),
}
