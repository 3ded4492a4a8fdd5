"""Logs and histories: the laws of the schedule, and files that come back as they were."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Callable, Hashable
from dataclasses import fields, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from slamkit.errors import InputError, LogFileError
from slamkit.exchange import write_tum
from slamkit.logs import History, Log, Scan, Truth, csv_columns, decode_id, encode_id

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


# The schedule


@given(logs())
def test_steps_are_in_order_and_predict_only_where_a_control_acts(log: Log) -> None:
    s = log.schedule
    assert len(s.times) == len(s.dt) == len(s.control) == len(s.first) - 1 == len(log)
    assert np.all(np.diff(s.times) >= 0)
    assert np.all(s.dt >= 0)
    assert np.array_equal(s.dt > 0, s.control >= 0)
    assert np.all(s.control < len(log.controls))
    assert np.all((s.dt > 0) | (np.diff(s.first) > 0)), "a step in which nothing happens"


@given(logs())
def test_the_controls_act_from_the_first_to_the_end(log: Log) -> None:
    acting = log.end_time - log.control_times[0] if len(log.controls) else 0.0
    assert log.schedule.dt.sum() == acting
    for row, begin in enumerate(log.control_times):
        end = log.control_times[row + 1] if row + 1 < len(log.controls) else log.end_time
        steps = log.schedule.control == row
        assert log.schedule.dt[steps].sum() == end - begin
        assert np.all((log.schedule.times[steps] > begin) & (log.schedule.times[steps] <= end))
        if log.increments:
            assert steps.sum() == (end > begin), "an increment was split"


@given(logs())
def test_every_observation_occurs_once_and_at_its_time(log: Log) -> None:
    s = log.schedule
    assert s.first[0] == 0
    assert s.first[-1] == len(log.observations)
    assert np.all(np.diff(s.first) >= 0)
    assert np.all(np.diff(log.observation_times) >= 0)
    taken = np.repeat(s.times, np.diff(s.first))
    if not log.increments:
        assert np.array_equal(taken, log.observation_times)
        return
    for t, when in zip(log.observation_times, taken, strict=True):
        ends = [*log.control_times, log.end_time] if len(log.controls) else []
        inside = len(ends) and ends[0] < t <= ends[-1]
        assert when == (min(e for e in ends if e >= t) if inside else t)


WITHIN_ONE_INCREMENT = Log(
    [0.0], [(1.0,)], [0.1, 0.1, 0.2, 0.3, 0.4], [0, 1, 1, 0, 0], np.zeros((5, 1)), ("a", "b"), 1.0, True
)


@given(logs())
@example(WITHIN_ONE_INCREMENT)
def test_no_step_repeats_a_landmark_or_is_split_without_need(log: Log) -> None:
    s = log.schedule
    steps = [log.observation_ids[a:b].tolist() for a, b in zip(s.first[:-1], s.first[1:], strict=True)]
    assert all(len(set(step)) == len(step) for step in steps)
    # Where an instant takes a further step, its first sightings meet a landmark of the step before.
    for k in np.flatnonzero((s.times[1:] == s.times[:-1]) & (s.dt[1:] == 0)) + 1:
        begin, end = s.first[k], s.first[k + 1]
        together = log.observation_times[begin:end] == log.observation_times[begin]
        assert set(log.observation_ids[begin:end][together]) & set(steps[k - 1])


@given(logs())
def test_the_motion_before_a_sighting_is_that_of_the_controls_until_then(log: Log) -> None:
    u = np.arange(1, len(log.controls) + 1) / 4  # the rates or the increments, exact in sums and products
    s = log.schedule
    motion = np.cumsum(np.where(s.control >= 0, u[s.control] if len(u) else 0.0, 0.0) * (1 if log.increments else s.dt))
    taken = np.repeat(np.arange(len(log)), np.diff(s.first))
    ends = np.append(log.control_times[1:], log.end_time)
    for step, t in zip(taken, log.observation_times, strict=True):
        if not len(u):
            expected = 0.0
        elif log.increments:
            # All that began earlier is complete; there is none without a duration.
            expected = u[(log.control_times < t) & (ends > log.control_times)].sum()
        else:
            expected = (u * np.clip(np.minimum(ends, t) - log.control_times, 0, None)).sum()
        assert motion[step] == expected


@given(logs(), st.integers(0, 2**32 - 1))
def test_permuting_the_rows_changes_nothing(log: Log, seed: int) -> None:
    other = permuted(log, np.random.default_rng(seed))
    assert same(other, log)
    assert same(other.schedule, log.schedule)


@given(logs(), st.integers(0, 2**32 - 1))
def test_the_order_of_landmark_ids_changes_no_step(log: Log, seed: int) -> None:
    order = np.random.default_rng(seed).permutation(len(log.landmark_ids))
    names = tuple(log.landmark_ids[i] for i in order)
    other = replace(log, landmark_ids=names, observation_ids=np.argsort(order)[log.observation_ids])
    assert same(other.schedule, log.schedule)
    for a, b in zip(log, other, strict=True):
        assert (a.time, a.dt) == (b.time, b.dt)
        assert set(zip(a.scan.ids, map(tuple, a.scan.z), strict=True)) == set(
            zip(b.scan.ids, map(tuple, b.scan.z), strict=True)
        )


@given(logs(), quarters)
def test_the_clock_has_no_zero(log: Log, shift: float) -> None:
    other = replace(
        log,
        control_times=log.control_times + shift,
        observation_times=log.observation_times + shift,
        end_time=log.end_time + shift,
    )
    assert same(other.schedule, log.schedule._replace(times=log.schedule.times + shift))


@given(logs())
def test_iterating_gives_the_schedule(log: Log) -> None:
    steps = list(log)
    s = log.schedule
    assert [step.time for step in steps] == s.times.tolist()
    assert [step.dt for step in steps] == s.dt.tolist()
    assert [len(step.scan) for step in steps] == np.diff(s.first).tolist()
    assert all((step.u is None) == (step.dt == 0) for step in steps)
    assert [i for step in steps for i in step.scan.ids] == [log.landmark_ids[i] for i in log.observation_ids]
    assert same(np.array([z for step in steps for z in step.scan.z]).reshape(log.observations.shape), log.observations)


@pytest.mark.parametrize("increments", [False, True])
def test_a_long_log_is_scheduled_at_once(increments: bool) -> None:
    rng = np.random.default_rng(0)
    T, M = 100_000, 10_000
    log = Log(
        np.arange(T) * 0.015, rng.normal(size=(T, 2)), rng.integers(0, T // 50, M) * 0.75, rng.integers(0, 20, M),
        rng.normal(size=(M, 2)), tuple(range(20)), T * 0.015, increments,
    )  # fmt: skip
    schedule = log.schedule  # some 20 ms on one core; a loop over a million pairs would be noticed
    assert np.isclose(schedule.dt.sum(), T * 0.015)
    assert schedule.first[-1] == M


# What a log refuses

GOOD: dict[str, Any] = {
    "control_times": [0.0, 1.0],
    "controls": [(1.0, 0.0), (1.0, 0.1)],
    "observation_times": [0.5],
    "observation_ids": [0],
    "observations": [(2.0, 0.1)],
    "landmark_ids": ("a",),
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"control_times": [0.0, np.nan]}, "control_times is not finite at row 1"),
        ({"control_times": [0.0]}, "controls have 2 rows, control_times 1"),
        ({"control_times": "soon"}, "control_times must be numbers"),
        ({"control_times": [[0.0, 1.0]]}, r"control_times has shape \(1, 2\), expected \(n,\)$"),
        ({"controls": [1.0, 2.0]}, r"controls has shape \(2,\), expected \(n, m\)$"),
        ({"controls": [(1.0, 0.0), (np.inf, 0.1)]}, "controls is not finite at row 1"),
        ({"controls": [(1.0, 0.0), (1.0,)]}, "controls must be numbers"),
        ({"observations": [(2.0, np.nan)]}, "observations is not finite at row 0"),
        ({"observations": []}, "observations has shape"),
        ({"observation_ids": [0, 0]}, r"observation_ids shape \(2,\)"),
        ({"observation_ids": [0.0]}, "expected integers"),
        ({"observation_ids": [1]}, "run from 1 to 1, there are 1"),
        ({"observation_ids": [-1]}, "run from -1"),
        ({"landmark_ids": ("a", "a")}, "an id twice"),
        ({"landmark_ids": (1, 1.0)}, "an id twice"),
        ({"landmark_ids": (["a"],)}, "hashable"),
        ({"end_time": 0.9}, "end_time is 0.9, expected a time not before the last control's 1.0"),
        ({"end_time": np.nan}, "end_time is nan, expected a finite number"),
        ({"end_time": np.inf}, "end_time is inf"),
        ({"end_time": "late"}, "end_time is 'late', expected a finite number of seconds"),
        ({"increments": True}, "the last increment .* begins at 1.0 s, when the log ends"),
        ({"increments": True, "control_times": [1.0, 1.0], "end_time": 2.0}, "two increments begin at 1.0 s"),
    ],
)
def test_a_log_says_what_is_wrong(change: dict[str, Any], message: str) -> None:
    Log(**GOOD)
    with pytest.raises(InputError, match=message):
        Log(**GOOD | change)


@pytest.mark.parametrize("end_time", [None, 1.0, np.nan])
def test_an_empty_log_is_refused(end_time: float | None) -> None:
    with pytest.raises(InputError, match="empty"):
        Log([], np.empty((0, 2)), [], [], np.empty((0, 2)), (), end_time)


def test_without_controls_a_broken_end_is_still_an_input_error() -> None:
    with pytest.raises(InputError, match="end_time"):
        Log([], np.empty((0, 2)), [1.0], [0], [(1.0, 2.0)], ("a",), np.nan)


@pytest.mark.parametrize(
    ("times", "poses", "landmarks", "message"),
    [
        ([0.0], [(1.0, 2.0)], {}, "shape"),
        ([0.0, 1.0], [(1.0, 2.0, 3.0)], {}, "2 times need"),
        ([np.nan], [(1.0, 2.0, 3.0)], {}, "truth times is not finite"),
        ([0.0], [(1.0, np.inf, 3.0)], {}, "truth poses is not finite"),
        ([0.0], [(1.0, 0.0, 3.0)], {7: (1.0, 2.0, 3.0)}, r"landmark 7 has shape \(3,\)"),
        ([0.0], [(1.0, 0.0, 3.0)], {7: (1.0, np.nan)}, "landmark 7 is not finite"),
    ],
)
def test_a_truth_says_what_is_wrong(times: Any, poses: Any, landmarks: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        Truth(times, poses, landmarks)


def test_a_scan_takes_what_it_is_given() -> None:
    z = [(1.0, 2.0), (3.0, 4.0)]
    scan = Scan(("a", 1), z)
    assert len(scan) == 2
    assert scan.z is z


# npz


@given(ids)
def test_ids_come_back_from_json_in_type_and_value(landmark_id: Hashable) -> None:
    assert same(decode_id(encode_id(landmark_id)), landmark_id)


@over_one_folder
@given(logs(any_times, ids))
def test_a_saved_log_comes_back_exactly(tmp_path: Path, log: Log) -> None:
    log.save(tmp_path / "log.npz")
    back = Log.load(tmp_path / "log.npz")
    assert same(back, log)
    assert same(back.schedule, log.schedule)
    assert os.listdir(tmp_path) == ["log.npz"]


@over_one_folder
@given(st.lists(ids, max_size=4, unique=True), st.integers(0, 2**32 - 1), st.floats())
def test_a_saved_history_comes_back_exactly(tmp_path: Path, names: list[Hashable], seed: int, seconds: float) -> None:
    history = replace(small_history(tuple(names), np.random.default_rng(seed)), seconds=seconds)
    history.save(tmp_path / "history")
    assert same(History.load(tmp_path / "history"), history)
    assert os.listdir(tmp_path) == ["history"], "under exactly this name"


def test_a_history_without_steps_comes_back(tmp_path: Path) -> None:
    empty = History(
        "ekf", np.empty(0), np.empty((0, 3)), np.empty((0, 3, 3)), np.empty(0), np.empty(0, dtype=np.int64),
        np.empty((0, 2)), np.empty(0), np.empty(0, dtype=np.bool_), (), np.empty((0, 2)), np.empty((0, 2, 2)), 0.25,
    )  # fmt: skip
    empty.save(tmp_path / "history.npz")
    assert same(History.load(tmp_path / "history.npz"), empty)


def test_look_alike_ids_stay_apart(tmp_path: Path) -> None:
    names = (1, "1", (1,), ("1",), None, "None", (), ((),), (True,), 0.5, "0.5")
    small_history(names).save(tmp_path / "h.npz")
    assert same(History.load(tmp_path / "h.npz").landmark_ids, names)
    for name in (True, 1.0, 1):
        Log(**GOOD | {"landmark_ids": (name,)}).save(tmp_path / "l.npz")
        assert type(Log.load(tmp_path / "l.npz").landmark_ids[0]) is type(name)


def test_numpys_numbers_become_pythons(tmp_path: Path) -> None:
    names = (np.int64(7), np.str_("oak"), (np.float32(0.5), np.bool_(True)))
    Log(**GOOD | {"landmark_ids": names}).save(tmp_path / "log.npz")
    assert same(Log.load(tmp_path / "log.npz").landmark_ids, (7, "oak", (0.5, True)))


class Tree(IntEnum):
    OAK = 1


SAVERS: list[Callable[[tuple[Hashable, ...], Path], None]] = [
    lambda names, path: Log(**GOOD | {"landmark_ids": names}).save(path),
    lambda names, path: replace(small_log(), truth=Truth([], [], dict.fromkeys(names, (0.0, 0.0)))).save(path),
    lambda names, path: small_history((*names, "oak")).save(path),
]


@pytest.mark.parametrize("save", SAVERS)
@pytest.mark.parametrize("name", [frozenset({1}), b"oak", Tree.OAK, 1j, (1, frozenset()), float("nan"), ("a", np.nan)])
def test_an_id_that_no_file_holds_is_refused_and_the_old_file_stays(
    tmp_path: Path, name: Hashable, save: Callable[[tuple[Hashable, ...], Path], None]
) -> None:
    path = tmp_path / "file.npz"
    path.write_bytes(b"precious")
    with pytest.raises(InputError, match="a file holds ids that are int, str"):
        save((name,), path)
    assert path.read_bytes() == b"precious"
    assert os.listdir(tmp_path) == ["file.npz"]


def test_a_history_that_does_not_fit_together_is_not_saved(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"poses has shape \(3, 3\)"):
        replace(small_history(), poses=np.zeros((3, 3))).save(tmp_path / "h.npz")
    with pytest.raises(InputError, match="accepted has shape"):
        replace(small_history(), accepted=np.ones(5)).save(tmp_path / "h.npz")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "write", [lambda p: small_log().save(p), lambda p: small_history().save(p), lambda p: small_history().write_tum(p)]
)
def test_a_failure_while_writing_leaves_the_old_file(
    tmp_path: Path, write: Callable[[Path], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "file"
    path.write_bytes(b"precious")

    def full(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(OSError, match="No space left"):
            write(path)
    assert path.read_bytes() == b"precious"
    assert os.listdir(tmp_path) == ["file"]
    write(path)
    assert path.read_bytes() != b"precious"


def test_saving_follows_a_link_and_keeps_the_usual_permissions(tmp_path: Path) -> None:
    (tmp_path / "usual").write_bytes(b"")
    (tmp_path / "real.npz").write_bytes(b"")
    (tmp_path / "link.npz").symlink_to("real.npz")
    small_log().save(tmp_path / "link.npz")
    assert (tmp_path / "link.npz").is_symlink()
    assert same(Log.load(tmp_path / "real.npz"), small_log())
    assert (tmp_path / "real.npz").stat().st_mode == (tmp_path / "usual").stat().st_mode


def test_the_same_content_gives_the_same_bytes(tmp_path: Path) -> None:
    small_log().save(tmp_path / "a")
    small_log().save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_one_kind_is_not_read_as_the_other(tmp_path: Path) -> None:
    small_log().save(tmp_path / "log")
    small_history().save(tmp_path / "history")
    with pytest.raises(LogFileError, match="history holds a slamkit History, expected a Log"):
        Log.load(tmp_path / "history")
    with pytest.raises(LogFileError, match="log holds a slamkit Log, expected a History"):
        History.load(tmp_path / "log")


@pytest.mark.parametrize("load", [Log.load, History.load])
def test_what_is_no_such_file_is_named(tmp_path: Path, load: Callable[[Path], Any]) -> None:
    np.save(tmp_path / "array", np.ones(3))
    np.savez(tmp_path / "other", times=np.ones(3))
    np.savez(tmp_path / "pickled", slamkit=np.array([{}], dtype=object))
    (tmp_path / "text").write_text("t,v,omega\n0,1,2\n")
    (tmp_path / "nothing").write_bytes(b"")
    (tmp_path / "folder").mkdir()
    for name in ("array.npy", "other.npz", "pickled.npz", "text", "nothing", "folder", "missing"):
        with pytest.raises(LogFileError, match=name):
            load(tmp_path / name)


def test_a_file_of_a_later_version_says_so(tmp_path: Path) -> None:
    small_log().save(tmp_path / "log")
    with np.load(tmp_path / "log") as archive:
        members = {name: archive[name] for name in archive.files}
    members["slamkit"] = np.array(str(members["slamkit"]).replace('"version": 1', '"version": 2'))
    np.savez(tmp_path / "later.npz", **members)
    with pytest.raises(LogFileError, match=r"later\.npz has version 2"):
        Log.load(tmp_path / "later.npz")


@pytest.mark.parametrize("thing", [small_log(), small_history()], ids=["Log", "History"])
def test_a_damaged_file_is_refused_or_read_exactly(tmp_path: Path, thing: Any) -> None:
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    thing.save(whole)
    content, rng = whole.read_bytes(), np.random.default_rng(1)
    for length in rng.permutation(len(content))[:100]:
        broken.write_bytes(content[:length])
        with pytest.raises(LogFileError, match="broken"):
            type(thing).load(broken)
    refused = 0
    for at in rng.permutation(len(content))[:300]:
        broken.write_bytes(content[:at] + bytes([content[at] ^ int(rng.integers(1, 256))]) + content[at + 1 :])
        read, error = outcome(lambda: type(thing).load(broken))
        # Some bytes of a zip archive say nothing: a date, a permission.
        assert same(read, thing) if error is None else "broken" in str(error)
        refused += error is not None
    assert refused > 150


def test_nothing_in_a_file_is_a_pickle(tmp_path: Path) -> None:
    small_log().save(tmp_path / "log")
    small_history().save(tmp_path / "history")
    for name in ("log", "history"):
        with zipfile.ZipFile(tmp_path / name) as archive:
            for member in archive.namelist():
                with archive.open(member) as file:
                    np.lib.format.read_array(file, allow_pickle=False)


# CSV


def comparable(log: Log) -> dict[str, Any]:
    """A log without the order of its landmark ids and without those that were never sighted."""
    sightings = zip(log.observation_times, log.observation_ids, log.observations, strict=True)
    truth, known = log.truth, log.truth.landmarks if log.truth else {}
    return {
        "sightings": sorted((t, repr(log.landmark_ids[i]), z.tolist()) for t, i, z in sightings),
        "schedule": log.schedule,
        "increments": log.increments,
        "truth": truth and (truth.times, truth.poses, {repr(i): known[i] for i in sorted(known, key=repr)}),
    }


@over_one_folder
@given(log=logs(any_times, csv_ids, late_observations=False))
def test_a_csv_folder_gives_the_log_back_to_the_bit(tmp_path: Path, log: Log) -> None:
    named = [*log.landmark_ids, *(log.truth.landmarks if log.truth else ())]
    assume(not any(isinstance(i, str) and i.lstrip("+-").isdigit() for i in named))
    for name in ("truth.csv", "landmarks.csv"):
        (tmp_path / name).unlink(missing_ok=True)
    log.write_csv(tmp_path)
    back = Log.read_csv(tmp_path)
    assert same(comparable(back), comparable(log))
    acting = np.unique(log.schedule.control[log.schedule.dt > 0])
    assert same(back.controls[acting], log.controls[acting])
    assert same(back.control_times[: len(log.controls)], log.control_times)
    assert not np.any(back.controls[len(log.controls) :])


def write(folder: Path, **texts: str | bytes) -> Path:
    sound: dict[str, str | bytes] = {
        "controls": "t,v,omega\n0,1,0.1\n1,2,0.2\n",
        "observations": "t,id,range,bearing\n0.5,7,3,0.1\n1,oak,4,0.2\n",
    }
    for name, text in (sound | texts).items():
        (folder / f"{name}.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    return folder


def test_a_log_written_by_hand(tmp_path: Path) -> None:
    plain = Log.read_csv(write(tmp_path))
    assert plain.landmark_ids == (7, "oak")
    assert plain.schedule.times.tolist() == [0.5, 1.0]
    assert not plain.increments
    assert plain.truth is None
    untidy = write(
        tmp_path,
        controls=b"\xef\xbb\xbf# driven by hand\r\n\r\n t , v, omega \r\n1,\t2 ,2e-1  # slow down\r\n 0, 1 ,.1\r\n\r\n",
        observations='# both sightings\r\r"t","id","range","bearing"\r1.0, oak ,4,0.2\r0.5,"7",3,0.1',
    )
    assert same(Log.read_csv(untidy), plain)


@pytest.mark.parametrize(
    ("header", "row", "increments"),
    [
        ("t,v,omega", "0,1,2", False),
        ("t,u1", "0,1", False),
        ("t,u1,u2,u3,u4", "0,1,2,3,4", False),
        ("t,rot1,trans,rot2", "0,1,2,3", True),
        ("t,d1,d2", "0,1,2", True),
        ("t", "", False),
    ],
)
@pytest.mark.parametrize("seen", ["range,bearing", "x,y", "z1", "z1,z2", "z1,z2,z3"])
def test_headers_say_what_the_columns_are(tmp_path: Path, header: str, row: str, increments: bool, seen: str) -> None:
    names = tuple(seen.split(","))
    rows = f"t,id,{seen}\n2,1{',5' * len(names)}\n"
    log = Log.read_csv(write(tmp_path, controls=f"{header}\n{row}\n", observations=rows))
    assert log.increments is increments
    assert log.controls.shape == (1 if row else 0, header.count(","))
    assert log.observations.shape == (1, len(names))
    assert csv_columns(tmp_path) == (tuple(header.split(",")[1:]), names)
    log.write_csv(tmp_path, controls=header.split(",")[1:], observations=names)
    assert csv_columns(tmp_path) == (tuple(header.split(",")[1:]), names)
    assert same(Log.read_csv(tmp_path), log)


def test_a_truth_may_be_poses_or_landmarks_or_both(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    poses = Log.read_csv(write(tmp_path / "a", truth="t,x,y,theta\n1,2,3,4\n0,1,2,3\n")).truth
    assert poses is not None and poses.times.tolist() == [0, 1] and not poses.landmarks
    landmarks = Log.read_csv(write(tmp_path / "b", landmarks="id,x,y\noak,1,2\n007,3,4\n")).truth
    assert landmarks is not None and landmarks.poses.shape == (0, 3)
    assert {i: p.tolist() for i, p in landmarks.landmarks.items()} == {"oak": [1, 2], 7: [3, 4]}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("controls", "t,v,omega\n0,1\n", r"controls\.csv:2: 2 fields '0,1', expected 3: t,v,omega"),
        ("controls", "t,v,omega\n\n# x\n0,1,2,\n", r"controls\.csv:4: 4 fields '0,1,2,', expected 3"),
        ("controls", "t,v,omega\n0,1,fast\n", r"controls\.csv:2: 'fast' is not a number"),
        ("controls", "t,v,omega\n0,1,\n", r"controls\.csv:2: '' is not a number"),
        ("controls", "t,v,omega\n0,1,1_000\n", r"controls\.csv:2: '1_000' is not a number"),
        ("controls", "t,v,omega\n0,1,2\n1,nan,2\n", r"controls\.csv:3: nan is not finite"),
        ("controls", "t,v,omega\r\n0,1,2\r\n-inf,1,2\r\n", r"controls\.csv:3: -inf is not finite"),
        ("controls", "0,1,2\n1,1,2\n", r"controls\.csv:1: header is '0,1,2', expected t,v,omega or"),
        ("controls", "#\nt,omega,v\n", r"controls\.csv:2: header is 't,omega,v', expected t,v,omega or"),
        ("controls", "t,u1,u3\n", r"controls\.csv:1: header is 't,u1,u3', expected"),
        ("controls", "t;v;omega\n", r"controls\.csv:1: header is 't;v;omega', expected"),
        ("controls", "# nothing\n\n", r"controls\.csv: the file is empty, expected the header t,v,omega"),
        ("controls", "", r"controls\.csv: the file is empty"),
        ("controls", b"t,v,omega\n0,1,2\n0,\xff,2\n", r"controls\.csv:3: byte 0xff, expected UTF-8"),
        ("controls", "t,v,omega\n0,1,2\n".encode("utf-16"), r"controls\.csv:1: byte 0xff, expected UTF-8"),
        ("controls", 't,v,omega\n0,"1,2\n', r"controls\.csv:2: .* expected fields between commas"),
        ("controls", "t,d1,d2\n0,1,2\n1,1,2\n0,1,2\n", r"controls\.csv:4: an increment begins at 0.0 s as on line 2"),
        ("controls", "t,rot1,trans,rot2\n0,0,1,0\n2,0,1,0\n", "last increment .* begins at 2.0 s, when the log ends"),
        ("observations", "t,id,range,bearing\n0,,1,2\n", r"observations\.csv:2: the id is empty"),
        ("observations", "t,id,range,bearing\n0,a,1\n", r"observations\.csv:2: 3 fields '0,a,1', expected 4"),
        ("observations", "t,id,range,bearing\n0,a,b,2\n", r"observations\.csv:2: 'b' is not a number"),
        ("observations", "t,id,range,bearing\n0,a,1,inf\n", r"observations\.csv:2: inf is not finite"),
        ("observations", "t,range,bearing\n0,1,2\n", r"observations\.csv:1: header .* expected t,id,range,bearing or"),
        ("truth", "t,x,y\n0,1,2\n", r"truth\.csv:1: header is 't,x,y', expected t,x,y,theta"),
        ("truth", "t,x,y,theta\n0,1,2,x\n", r"truth\.csv:2: 'x' is not a number"),
        ("landmarks", "id,x,y\na,1,2\nb,1,2\na,1,2\n", r"landmarks\.csv:4: landmark 'a' was given on line 2"),
        ("landmarks", "id,x,y\n7,1,2\n07,1,2\n", r"landmarks\.csv:3: landmark 7 was given on line 2"),
        ("landmarks", "id,x\na,1\n", r"landmarks\.csv:1: header is 'id,x', expected id,x,y"),
    ],
)  # fmt: skip
def test_a_broken_csv_file_is_named_with_its_line(tmp_path: Path, name: str, text: str | bytes, message: str) -> None:
    Log.read_csv(write(tmp_path))
    with pytest.raises(LogFileError, match=message):
        Log.read_csv(write(tmp_path, **{name: text}))


def test_a_missing_or_empty_csv_log_is_named(tmp_path: Path) -> None:
    for name in ("observations", "controls"):
        (write(tmp_path) / f"{name}.csv").unlink()
        with pytest.raises(LogFileError, match=rf"{name}\.csv cannot be read: No such file"):
            Log.read_csv(tmp_path)
    with pytest.raises(LogFileError, match=r"nowhere.controls\.csv cannot be read"):
        Log.read_csv(tmp_path / "nowhere")
    with pytest.raises(LogFileError, match=f"{tmp_path.name}: the log is empty"):
        Log.read_csv(write(tmp_path, controls="t,v,omega\n", observations="t,id,x,y\n"))


@over_one_folder
@given(st.sampled_from(["controls", "observations", "truth", "landmarks"]), st.integers(0, 400), st.binary(max_size=3))
def test_any_garbled_csv_file_is_read_or_refused(tmp_path: Path, name: str, at: int, garbage: bytes) -> None:
    texts: dict[str, bytes] = {
        "controls": b"t,v,omega\n0,1,0.1\n1,2,0.2\n",
        "observations": b"t,id,range,bearing\n0.5,7,3,0.1\n1,oak,4,0.2\n",
        "truth": b"t,x,y,theta\n0,1,2,3\n",
        "landmarks": b"id,x,y\n7,1,2\noak,3,4\n",
    }
    at %= len(texts[name])
    texts[name] = texts[name][:at] + garbage + texts[name][at + 1 :]
    write(tmp_path, **texts)
    log, error = outcome(lambda: Log.read_csv(tmp_path))
    assert isinstance(log, Log) if error is None else str(tmp_path) in str(error)


@pytest.mark.parametrize("name", ["7", "+7", "", " oak", "a#b", "a\nb", "a\rb", True, 1.5, None, (1,), "\ud800"])
def test_an_id_that_csv_would_change_is_refused_before_anything_is_written(tmp_path: Path, name: Hashable) -> None:
    for log in (
        Log(**GOOD | {"landmark_ids": (name,)}),
        replace(small_log(), truth=Truth([], [], {name: (0.0, 0.0)})),
    ):
        with pytest.raises(InputError, match="would not come back from a CSV file"):
            log.write_csv(tmp_path / "new")
    with pytest.raises(InputError, match="would not come back from a CSV file"):
        small_history((name, "oak")).write_csv(tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_landmark_that_was_never_sighted_may_have_any_id(tmp_path: Path) -> None:
    Log(**GOOD | {"landmark_ids": ("a", None, (1,))}).write_csv(tmp_path)
    assert Log.read_csv(tmp_path).landmark_ids == ("a",)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"controls": ("rot1", "trans", "rot2")}, "control columns rot1,trans,rot2 for 2 .* expected v,omega or u1,u2"),
        ({"controls": ("d1", "d2")}, "control columns d1,d2"),
        ({"observations": ("z1",)}, "observation columns z1 for 2 .* expected range,bearing or x,y or z1,z2"),
    ],
)
def test_column_names_have_to_fit(tmp_path: Path, options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        small_log().write_csv(tmp_path / "new", **options)
    assert not (tmp_path / "new").exists()


def test_an_end_before_the_last_observation_has_no_csv_form(tmp_path: Path) -> None:
    log = Log(**GOOD | {"observation_times": [5.0], "end_time": 2.0})
    with pytest.raises(InputError, match=r"end at 2.0 s, before the last observation at 5.0 s"):
        log.write_csv(tmp_path)


def test_no_truth_of_another_log_becomes_a_part_of_this_one(tmp_path: Path) -> None:
    small_log().write_csv(tmp_path)
    with pytest.raises(InputError, match=r"truth\.csv belongs to another log"):
        replace(small_log(), truth=None).write_csv(tmp_path)
    with pytest.raises(InputError, match=r"landmarks\.csv belongs to another log"):
        replace(small_log(), truth=Truth([], [])).write_csv(tmp_path)
    assert same(comparable(Log.read_csv(tmp_path)), comparable(small_log()))


# What a history says, for other programs


def test_a_history_as_csv(tmp_path: Path) -> None:
    history = small_history((3, "a,b"))
    history.write_csv(tmp_path)
    header, *lines = (tmp_path / "trajectory.csv").read_text().splitlines()
    assert header == "t,x,y,theta,sxx,sxy,sxtheta,syy,sytheta,sthetatheta"
    rows = np.array([[float(v) for v in line.split(",")] for line in lines])
    assert same(rows[:, :4], np.column_stack([history.times, history.poses]))
    P = history.pose_covariances
    assert same(rows[:, 4:], np.column_stack([P[:, 0, 0], P[:, 0, 1], P[:, 0, 2], P[:, 1, 1], P[:, 1, 2], P[:, 2, 2]]))
    header, *lines = (tmp_path / "map.csv").read_text().splitlines()
    assert header == "id,x,y,sxx,sxy,syy"
    S = history.landmark_covariances
    expected = np.column_stack([history.landmarks, S[:, 0, 0], S[:, 0, 1], S[:, 1, 1]]).tolist()
    assert lines == [f"{name},{','.join(map(repr, row))}" for name, row in zip(("3", '"a,b"'), expected, strict=True)]


@over_one_folder
@given(st.lists(st.tuples(quarters, numbers, numbers, st.floats(-np.pi, np.pi, exclude_max=True)), max_size=8))
def test_a_tum_file_holds_one_pose_a_time(tmp_path: Path, rows: list[tuple[float, ...]]) -> None:
    rows.sort(key=lambda row: row[0])
    data = np.reshape(rows, (-1, 4))
    write_tum(tmp_path / "path.tum", data[:, 0], data[:, 1:])
    lines = (tmp_path / "path.tum").read_text().splitlines()
    read = np.array([[float(v) for v in line.split(" ")] for line in lines]).reshape(-1, 8)
    expected = np.reshape(list({row[0]: row for row in rows}.values()), (-1, 4))
    assert same(read[:, :3], expected[:, :3])
    assert not np.any(read[:, 3:6])
    np.testing.assert_allclose(np.hypot(read[:, 6], read[:, 7]), 1.0, atol=1e-15)
    np.testing.assert_allclose(2 * np.arctan2(read[:, 6], read[:, 7]), expected[:, 3], atol=1e-15)


def test_a_history_as_tum_is_its_trajectory(tmp_path: Path) -> None:
    history = small_history()
    history.write_tum(tmp_path / "a")
    write_tum(tmp_path / "b", history.times, history.poses)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()
    assert len((tmp_path / "a").read_text().splitlines()) == len(np.unique(history.times))


@pytest.mark.parametrize(
    ("times", "poses", "message"),
    [
        ([0.0, 1.0], [(0.0, 0.0, 0.0)], r"poses have shape \(1, 3\), 2 times need \(2, 3\)"),
        ([1.0, 0.0], np.zeros((2, 3)), "times step back from 1.0 to 0.0 s at row 1"),
        ([np.nan], np.zeros((1, 3)), "times is not finite at row 0"),
        ([0.0], [(0.0, 0.0, np.nan)], "poses is not finite at row 0"),
    ],
)
def test_no_tum_file_of_what_is_no_trajectory(tmp_path: Path, times: Any, poses: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        write_tum(tmp_path / "path", times, poses)
    assert os.listdir(tmp_path) == []
