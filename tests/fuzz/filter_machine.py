"""Random operations on every filter, order, storage and kind of model: what must hold after each of them.

A reference filter beside the standard EKF says what the numbers are (`dense_filter`). Every filter has a mirror: the
same filter with another storage, which takes the same operations and must come to the same belief.
"""

from __future__ import annotations

import copy
import gc
import os
import pickle
import signal
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import numpy as np
from child import Trace, arguments
from dense_filter import DenseFilter
from family import PlainMotion, PlainSensor
from hypothesis import HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule, run_state_machine_as_test

from slamkit import Log, Scan, Storage, Truth
from slamkit.errors import SlamkitError
from slamkit.filters import FILTERS
from slamkit.logs import read_archive, write_archive
from slamkit.models import EulerUnicycle, Odometry, RangeBearing, RelativePosition, Unicycle

STORAGES: dict[str, dict[str, Any]] = {
    "default": {},
    "all active": {"compress_above": 10**6},
    "compressed": {"compress_above": 2},
    "spread": {"compress_above": 2, "flush_work": 500.0},
}
MOTIONS: dict[str, Any] = {
    "unicycle": Unicycle(0.1, 0.05),
    "euler": EulerUnicycle(0.2, 0.02, pose_noise=np.diag([1e-3, 2e-3, 1e-4])),
    "odometry": Odometry(0.02, 0.01, 0.02, 0.01),
}
SENSORS: dict[str, Any] = {"range-bearing": RangeBearing(0.1, 0.03), "relative": RelativePosition(0.15)}
GATES = (None, 9.21, 1.0, np.inf)
PRIORS: dict[str, Any] = {
    "known": np.zeros((3, 3)),
    "usual": np.array([[0.02, 0.005, 0.0], [0.005, 0.03, 0.002], [0.0, 0.002, 0.01]]),
    "wide": np.diag([1.0, 4.0, 0.1]),
}
IDS: list[Any] = [0, 7, "a", "Bäume", (1, "b"), None, 2.5, -3, *(("far", n) for n in range(72))]
DT = 0.1
#: The ideal filter knows this truth; it need not be where the robot goes.
TRUTH = Truth(
    np.arange(5000) * DT,
    np.c_[5 * np.cos(np.arange(5000) / 50), 5 * np.sin(np.arange(5000) / 50), np.arange(5000) / 50 % 6 - 3],
    {i: (12 * np.cos(n), 12 * np.sin(n)) for n, i in enumerate(IDS)},
)
POSITIONS = {i: np.array([(6 + n % 5) * np.cos(2.4 * n), (6 + n % 5) * np.sin(2.4 * n)]) for n, i in enumerate(IDS)}
#: Smallest eigenvalue that is rounding, over the largest variance that the filter has had.
ROUNDING = 1e-11
seeds = st.integers(0, 10**6)


def fingerprint(f: Any) -> dict[str, Any]:
    """Everything that a filter tells, and its settings."""
    numbers = {n: np.array(getattr(f, n)) for n in ("x", "y", "z", "S", "K", "F", "Q", "P", "pose_covariance")}
    numbers["log_likelihood"] = np.array(f.log_likelihood)
    return numbers | {
        "ids": f.landmark_ids,
        "dim_u": f.dim_u,
        "order": f.order,
        "gate": f.gate,
        "motion": id_of(f.motion),
    }


def inside(f: Any) -> dict[str, Any]:
    """`fingerprint`, but for P what it is made of: a flush is a product of matrices, which rounds as BLAS likes."""
    b = f._belief.state
    D, C = b.belief.active, b.resting.columns
    told = {n: np.array(getattr(f, n)) for n in ("x", "y", "z", "S", "K", "F", "Q", "pose_covariance")}
    told |= {n: np.array(getattr(b.resting, n)) for n in ("mean", "linearised_at", "store", "V")}
    told |= {"cov": np.tril(b.belief.cov[:D, :D]), "linearised": np.array(b.belief.linearised_at[:D])}
    told |= {"Phi": b.resting.Phi[:D, :C].copy(), "minus_Psi": np.tril(b.resting.minus_Psi[:C, :C])}
    told |= {
        "theta": b.resting.theta[:C].copy(),
        "own": np.array(b.own[: 0 if f.name == "ideal" else f._belief.own_fields.fixed]),
    }
    settings = {n: getattr(f, n) for n in ("dim_u", "order", "gate", "landmark_ids", "log_likelihood")}
    return told | settings | {"motion": id_of(f.motion), "sensor": id_of(f.sensor)}


def refusal(act: Callable[[], Any]) -> SlamkitError | None:
    """The error with which slamkit refuses something, or None where it does not."""
    try:
        act()
    except SlamkitError as error:
        return error
    return None


def id_of(model: Any) -> Any:
    return repr(getattr(model, "model", model))


def differing(a: dict[str, Any], b: dict[str, Any]) -> list[str]:
    """The names whose values are not the same, bit for bit."""
    return [n for n in a if not (np.array_equal(a[n], b[n]) if isinstance(a[n], np.ndarray) else a[n] == b[n])]


def alike(f: Any, g: Any, tolerance: float) -> None:
    """Two filters believe the same, but for rounding."""
    assert f.landmark_ids == g.landmark_ids, (f.landmark_ids, g.landmark_ids)
    P, scale = np.array(f.P), np.sqrt(np.diag(f.P)) + 1e-3
    difference = (np.array(f.x) - g.x + np.pi * (np.arange(len(f.x)) == 2)) % (2 * np.pi)
    apart = np.abs(np.array(f.x) - g.x)
    apart[2] = abs(difference[2] - np.pi)
    assert (apart / scale).max() < tolerance, ("x", (apart / scale).max())
    assert (np.abs(P - g.P) / np.outer(scale, scale)).max() < tolerance, (
        np.abs(P - g.P) / np.outer(scale, scale)
    ).max()


class FilterMachine(RuleBasedStateMachine):
    """Operations on one filter, checked after each."""

    trace: ClassVar[Trace]
    refused: ClassVar[int] = 0
    folder: ClassVar[Any]

    # -- making one ---------------------------------------------------------------------------------------------------

    @initialize(
        name=st.sampled_from(list(FILTERS)),
        order=st.sampled_from(("sequential", "batch")),
        storage=st.sampled_from(list(STORAGES)),
        plain=st.sampled_from((False, False, True)),
        motion=st.sampled_from(list(MOTIONS)),
        sensor=st.sampled_from(list(SENSORS)),
        gate=st.sampled_from(GATES),
        prior=st.sampled_from(list(PRIORS)),
        snapshots=st.booleans(),
    )
    def make(
        self,
        name: str,
        order: str,
        storage: str,
        plain: bool,
        motion: str,
        sensor: str,
        gate: float | None,
        prior: str,
        snapshots: bool,
    ) -> None:
        self.trace.begin(f"{name} {order} {storage} plain={plain} {motion} {sensor} {gate=} {prior} {snapshots=}")
        self.name, self.plain = name, plain
        m, s = self.models(motion, sensor)
        start, P = np.array([0.2, -0.1, 3.1]), PRIORS[prior]
        self.extra = {"truth": TRUTH} if name == "ideal" else {}
        options = {"order": order, "gate": gate, **self.extra}
        kind = FILTERS[name]
        self.f = kind(m, s, start, P, storage=Storage(**STORAGES[storage]), snapshots=snapshots, **options)
        other = "all active" if storage in ("compressed", "spread") else "compressed"
        self.mirror = kind(m, s, start, P, storage=Storage(**STORAGES[other]), snapshots=not snapshots, **options)
        self.dense = DenseFilter(MOTIONS[motion], SENSORS[sensor], start, P, order, gate) if name == "ekf" else None
        self.pose, self.ids, self.motion, self.sensor = start.copy(), list[Any](), motion, sensor
        self.largest, self.since = 1.0, 0

    def models(self, motion: str, sensor: str) -> tuple[Any, Any]:
        m, s = MOTIONS[motion], SENSORS[sensor]
        return (PlainMotion(m), PlainSensor(s)) if self.plain else (m, s)

    # -- what the world gives -----------------------------------------------------------------------------------------

    def control(self, rng: Any) -> Any:
        if self.motion == "odometry":
            return rng.uniform(-1, 1, 3) * (0.1, 0.2, 0.1)
        return rng.uniform(-1, 1, 2) * (2.0, 1.0) * rng.choice([0.0, 1.0], p=(0.1, 0.9))

    def drive(self, u: Any) -> None:
        self.pose = MOTIONS[self.motion].move(self.pose, u, DT)
        if np.hypot(*self.pose[:2]) > 4:  # stay amid the landmarks
            self.pose[:2] *= 0.5

    def sightings(self, rng: Any, most: int) -> tuple[list[Any], Any]:
        near = [i for i in IDS[: 8 if rng.random() < 0.8 else 80] if np.hypot(*(POSITIONS[i] - self.pose[:2])) > 1]
        chosen = [near[j] for j in rng.permutation(len(near))[: rng.integers(0, min(most, len(near)) + 1)]]
        s = SENSORS[self.sensor]
        noise = np.sqrt(np.diag(s.R)) * rng.normal(size=(len(chosen), 2)) * rng.choice([1.0, 30.0], p=(0.9, 0.1))
        z = np.array([s.predict(self.pose, POSITIONS[i]) for i in chosen]).reshape(-1, 2) + noise
        if self.sensor == "range-bearing":
            z[:, 0] = np.abs(z[:, 0]) + 1e-3
        return chosen, z

    # -- doing and checking -------------------------------------------------------------------------------------------

    def do(self, what: str, act: Callable[[Any], Any], dense: Callable[[Any], Any] | None = None) -> bool:
        """Do something to the filter, its mirror and the reference; False where the filter refuses it."""
        self.trace.operation(what)
        before = copy.deepcopy(self.f)
        error = refusal(lambda: act(self.f))
        if error is not None:
            type(self).refused += 1
            self.trace.write(f"   refused: {type(error).__name__}: {error}")
            assert str(error)
            assert not (bad := differing(inside(before), inside(self.f))), f"{bad} changed by {error}"
            assert self.name != "ekf", error
            return False
        act(self.mirror)
        if self.dense is not None and dense is not None:
            dense(self.dense)
        return True

    def refuse(self, what: str, act: Callable[[Any], Any]) -> None:
        """Do what must be refused, and must change nothing."""
        self.trace.operation(f"bad input: {what}")
        before = copy.deepcopy(self.f)
        error = refusal(lambda: act(self.f))
        assert error is not None, f"{what} was taken"
        assert str(error)
        assert not (bad := differing(inside(before), inside(self.f))), f"{bad} changed by {what}"

    def seen(self, ids: Sequence[Any]) -> None:
        """New landmarks; an unscented filter may find a sighting too close to start one."""
        held = self.f.landmark_ids if "ukf" in self.name else IDS
        self.ids += [i for i in dict.fromkeys(ids) if i not in self.ids and i in held]

    def check(self) -> None:
        """What holds of every filter at any time."""
        f = copy.deepcopy(self.f)
        untouched = copy.deepcopy(f)
        K = f.K
        x, P = np.array(f.x), np.array(f.P)
        assert list(f.landmark_ids) == self.ids, (f.landmark_ids, self.ids)
        assert f.dim_x == len(x) == 3 + 2 * len(self.ids)
        assert np.isfinite(x).all() and np.isfinite(P).all() and np.array_equal(P, P.T)
        self.largest = max(self.largest, float(np.diag(P).max()))
        smallest = np.linalg.eigvalsh(P)[0]
        assert smallest >= -ROUNDING * self.largest, f"smallest eigenvalue {smallest}, largest variance {self.largest}"
        assert np.allclose(f.K, K, rtol=1e-9, atol=1e-9 * (1 + np.abs(K).max(initial=0))), "K depends on reading P"
        rows = len(f.y)
        assert f.z.shape == (rows,) and f.S.shape == (rows, rows) and K.shape == (len(x), rows)
        if rows:
            assert np.isfinite(f.y).all() and np.linalg.eigvalsh(f.S)[0] > 0
        if self.ids:
            chosen = self.ids[:: max(1, len(self.ids) // 3)]
            mean, cov = untouched.marginal(chosen, pose=True)
            at = np.r_[0:3, [3 + 2 * self.ids.index(i) + c for i in chosen for c in range(2)]]
            assert np.allclose(mean, x[at]) and np.allclose(cov, P[np.ix_(at, at)], atol=1e-9 * self.largest)
            assert np.array_equal(np.reshape(list(f.landmarks.values()), -1), f.x[3:])
        alike(f, copy.deepcopy(self.mirror), 1e-5 if "ukf" in self.name else 1e-6)
        if self.dense is not None:
            d = self.dense
            assert d.ids == self.ids
            alike(f, _Told(d.x, d.P, tuple(d.ids)), 1e-7)
            assert np.allclose(f.F[:3, :3], d.F) and np.allclose(f.Q[:3, :3], d.Q)
            assert np.allclose(f.S, d.S, rtol=1e-6, atol=1e-9) and np.allclose(f.y, d.y, rtol=1e-6, atol=1e-6)
            assert np.allclose(f.K, d.K, rtol=1e-5, atol=1e-6), np.abs(f.K - d.K).max()

    def now_and_then(self) -> None:
        self.since += 1
        if self.since % 3 == 0:
            self.check()

    # -- operations ---------------------------------------------------------------------------------------------------

    @rule(seed=seeds)
    def predict(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        u = self.control(rng)
        self.do(f"predict {u}", lambda f: f.predict(u, DT), lambda d: d.predict(u, DT))
        self.drive(u)
        self.now_and_then()

    @rule(seed=seeds)
    def observe(self, seed: int) -> None:
        ids, z = self.sightings(np.random.default_rng(seed), 1)
        if ids:
            z.flags.writeable = bool(seed % 2)
            done = self.do(f"observe {ids[0]!r} {z[0]}", lambda f: f.observe(ids[0], z[0]), lambda d: d.scan(ids, z))
            self.seen(ids if done else [])
        self.now_and_then()

    @rule(seed=seeds, most=st.sampled_from((4, 12, 75)))
    def observe_scan(self, seed: int, most: int) -> None:
        ids, z = self.sightings(np.random.default_rng(seed), most)
        z.flags.writeable = bool(seed % 2)
        scan: Any = Scan(tuple(ids), z) if seed % 3 else dict(zip(ids, z.tolist(), strict=True))
        done = self.do(f"observe_scan {scan}", lambda f: f.observe_scan(scan), lambda d: d.scan(ids, z))
        self.seen(ids if done else [])
        self.now_and_then()

    @rule(seed=seeds)
    def step(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        u = self.control(rng)
        self.drive(u)
        ids, z = self.sightings(rng, 6)
        u.flags.writeable = bool(seed % 2)

        def reference(d: Any) -> None:
            d.predict(u, DT)
            d.scan(ids, z)

        done = self.do(f"step {u} {ids!r} {z}", lambda f: f.step(u, DT, Scan(tuple(ids), z)), reference)
        self.seen(ids if done else [])
        self.now_and_then()

    def log(self, rng: Any, steps: int) -> Log:
        """What the robot does and sees next; the robot's true pose moves."""
        u, times, rows, z = [], [], [], []
        base = self.f.time if self.name == "ideal" else 0.0
        for k in range(steps):
            u.append(self.control(rng))
            self.drive(u[-1])
            ids, seen = self.sightings(rng, 3)
            times += [base + (k + 1) * DT] * len(ids)
            rows += [IDS.index(i) for i in ids]
            z += list(seen)
        control_times = base + np.arange(steps) * DT
        observations = np.array(z).reshape(-1, 2)
        return Log(control_times, u, times, np.array(rows, dtype=int), observations, IDS, end_time=base + steps * DT)

    def follow(self, log: Log, steps: int) -> None:
        """Let mirror and reference do the first steps of a log, of which the filter has done no more."""
        if steps:
            self.mirror.run(log.head(steps))
        for k, (_, u, dt, scan) in enumerate(log):
            if k < steps:
                self.seen(scan.ids)
                if self.dense is not None:
                    if u is not None:
                        self.dense.predict(u, dt)
                    self.dense.scan(scan.ids, scan.z)

    @rule(seed=seeds, steps=st.integers(1, 25))
    def run(self, seed: int, steps: int) -> None:
        log = self.log(np.random.default_rng(seed), steps)
        self.trace.operation(f"run seed {seed}, {steps} steps")
        before = copy.deepcopy(self.f)
        try:
            history = self.f.run(log)
        except SlamkitError as error:
            self.trace.write(f"   {type(error).__name__}: {error}")
            history = error.history  # type: ignore[attr-defined]
        self.whole_steps(before, history, log)
        assert len(history.times) == len(log) or self.name != "ekf"
        self.follow(log, len(history.times))
        self.check()

    def whole_steps(self, before: Any, history: Any, log: Log) -> None:
        """The belief and a history stand at the same step of a log."""
        done = len(history.times)
        self.trace.write(f"   {done} of {len(log)} steps")
        if done == 0:
            assert not (bad := differing(inside(before), inside(self.f))), f"{bad} changed by no step"
            return
        assert np.array_equal(history.poses[-1], self.f.pose), (history.poses[-1], self.f.pose)
        assert history.landmark_ids == self.f.landmark_ids, (history.landmark_ids, self.f.landmark_ids)
        assert np.allclose(history.pose_covariances[-1], self.f.pose_covariance, rtol=1e-9, atol=1e-12)
        again = before.run(log.head(done))
        assert np.array_equal(again.poses, history.poses) or np.allclose(again.poses, history.poses, atol=1e-7)

    @rule(seed=seeds, after=st.integers(0, 4))
    def interrupt(self, seed: int, after: int) -> None:
        """A progress callback raises KeyboardInterrupt."""
        log = self.log(np.random.default_rng(seed), 30)
        calls = 0

        def progress(done: int, total: int) -> None:
            nonlocal calls
            calls += 1
            if calls > after:
                raise KeyboardInterrupt

        self.trace.operation(f"run seed {seed}, progress raises at call {after}")
        before = copy.deepcopy(self.f)
        try:
            history = self.f.run(log, progress)
        except (KeyboardInterrupt, SlamkitError) as error:
            self.trace.write(f"   {type(error).__name__}: {error}")
            history = error.history  # type: ignore[union-attr]
        self.whole_steps(before, history, log)
        self.follow(log, len(history.times))
        self.check()

    @rule(seed=seeds, microseconds=st.integers(50, 3000))
    def ctrl_c(self, seed: int, microseconds: int) -> None:
        """The user presses Ctrl-C: a timer sends the signal, once, while a log runs."""
        log = self.log(np.random.default_rng(seed), 30)
        self.trace.operation(f"run seed {seed}, Ctrl-C after {microseconds} µs")
        before, history = copy.deepcopy(self.f), None
        armed = False
        handlers = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGALRM)

        def interrupt(*_: Any) -> None:
            if armed:
                raise KeyboardInterrupt

        signal.signal(signal.SIGINT, interrupt)
        signal.signal(signal.SIGALRM, lambda *_: os.kill(os.getpid(), signal.SIGINT))
        self.f.run  # noqa: B018  (looked up before the timer runs)
        gc.disable()  # a callback of the collector that is interrupted swallows the interrupt
        try:
            armed = True
            signal.setitimer(signal.ITIMER_REAL, microseconds * 1e-6 * (20 if self.plain else 1))
            history = self.f.run(log)
            armed = False
        except (KeyboardInterrupt, SlamkitError) as error:
            armed = False
            self.trace.write(f"   {type(error).__name__}: {error}")
            history = getattr(error, "history", None)
        finally:
            armed = False
            signal.setitimer(signal.ITIMER_REAL, 0)
            gc.enable()
            signal.signal(signal.SIGINT, handlers[0])
            signal.signal(signal.SIGALRM, handlers[1])
        if history is None:  # before the run began, or after it ended
            done = self.steps_done(before, log)
        else:
            self.whole_steps(before, history, log)
            done = len(history.times)
        self.follow(log, done)
        self.check()

    def steps_done(self, before: Any, log: Log) -> int:
        """How many steps of a log a filter has done that is `before` before them: none or all."""
        if not differing(fingerprint(before), fingerprint(copy.deepcopy(self.f))):
            return 0
        after = copy.deepcopy(before)
        after.run(log)
        alike(copy.deepcopy(self.f), after, 1e-9)
        return len(log)

    @precondition(lambda self: self.ids)
    @rule(which=st.integers(0, 100))
    def remove(self, which: int) -> None:
        landmark = self.ids[which % len(self.ids)]
        self.do(f"remove {landmark!r}", lambda f: f.remove(landmark), lambda d: d.remove(landmark))
        self.ids.remove(landmark)
        self.now_and_then()

    @rule(times=st.integers(1, 3))
    def read(self, times: int) -> None:
        """What was read does not change later; here only that reading works in any state."""
        self.trace.operation(f"read x, P, K {times} times")
        P = [self.f.P for _ in range(times)]
        assert not P[0].flags.writeable and not self.f.x.flags.writeable
        kept = np.array(P[-1])
        if times > 1:
            self.step(times)
        assert np.array_equal(kept, P[-1])
        assert self.f.K.shape == (self.f.dim_x, len(self.f.y))

    @rule()
    def flush(self) -> None:
        self.trace.operation("flush")
        self.f.flush()
        self.now_and_then()

    @rule(seed=seeds)
    def assign_x(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        x = np.array(copy.deepcopy(self.f).x) + 0.05 * rng.normal(size=self.f.dim_x)
        x[2] += rng.choice([0.0, 2 * np.pi])
        x.flags.writeable = bool(seed % 2)

        def reference(d: Any) -> None:
            d.x = x.copy()
            d.x[2] = (x[2] + np.pi) % (2 * np.pi) - np.pi

        self.do(f"x = {x}", lambda f: setattr(f, "x", x), reference)
        self.now_and_then()

    @rule(factor=st.sampled_from((0.5, 1.5, 4.0)), seed=seeds)
    def assign_P(self, factor: float, seed: int) -> None:  # noqa: N802
        A = 0.05 * np.random.default_rng(seed).normal(size=(self.f.dim_x, 2))
        P = np.array(copy.deepcopy(self.f).P)
        factor = 0.5 if np.diag(P).max() > 100 else factor
        P = factor * P + A @ A.T

        def reference(d: Any) -> None:
            d.P = P.copy()

        self.do(f"P = {factor} P + …, seed {seed}", lambda f: setattr(f, "P", P), reference)
        self.now_and_then()

    @rule(order=st.sampled_from(("sequential", "batch")), gate=st.sampled_from(GATES))
    def assign_settings(self, order: str, gate: float | None) -> None:
        """The mirror takes the same settings from a file, so that an assignment without effect is seen."""
        self.trace.operation(f"{order=} {gate=}")
        self.f.order = order
        self.f.gate = gate
        self.mirror = self.reloaded(self.mirror, order=order, gate=gate)
        if self.dense is not None:
            self.dense.order, self.dense.gate = order, gate
        assert self.f.order == order and self.f.gate == gate

    @rule(motion=st.sampled_from(list(MOTIONS)), sensor=st.sampled_from(list(SENSORS)))
    def assign_models(self, motion: str, sensor: str) -> None:
        self.trace.operation(f"{motion=} {sensor=}")
        m, s = self.models(motion, sensor)
        self.f.motion, self.f.sensor = m, s
        self.motion, self.sensor = motion, sensor
        self.mirror = self.reloaded(self.mirror, m, s, dim_u=0 if self.plain else m.control_dim)
        if self.dense is not None:
            self.dense.motion, self.dense.sensor = MOTIONS[motion], SENSORS[sensor]

    def reloaded(self, f: Any, motion: Any = None, sensor: Any = None, **facts: Any) -> Any:
        """A filter as its file gives it back, after changes of the file's facts and models."""
        path = self.folder / "filter.npz"
        f.save(path)
        if facts:
            written, arrays = read_archive(path, "filter")
            write_archive(path, "filter", written | facts, arrays)
        return FILTERS[self.name].load(path, motion or f.motion, sensor or f.sensor)

    @rule(how=st.sampled_from(("file", "deepcopy", "pickle")), seed=seeds)
    def continues(self, how: str, seed: int) -> None:
        """A copy goes on bit for bit, and takes the filter's place."""
        self.trace.operation(how)
        if how == "file":
            other = self.reloaded(self.f)
        else:
            other = copy.deepcopy(self.f) if how == "deepcopy" else pickle.loads(pickle.dumps(self.f))
        old = copy.deepcopy(self.f) if how != "deepcopy" else self.f
        rng = np.random.default_rng(seed)
        one, two = copy.deepcopy(old), copy.deepcopy(other)
        for _ in range(2):
            u = self.control(rng)
            ids, z = self.sightings(rng, 4)
            for g in (one, two):
                error = refusal(partial(g.step, u, DT, Scan(tuple(ids), z)))
                assert error is None or self.name != "ekf"
        assert not (bad := differing(fingerprint(one), fingerprint(two))), f"{bad} differ after {how}"
        self.f = other
        self.now_and_then()

    @rule(which=st.integers(0, 10**6))
    def bad_input(self, which: int) -> None:
        calls = bad_calls(self)
        name = list(calls)[which % len(calls)]
        self.refuse(name, calls[name])

    @rule(seed=seeds, what=st.sampled_from(("huge dt", "huge z", "huge P", "on the robot", "tiny range", "far x")))
    def extreme(self, seed: int, what: str) -> None:
        """A copy is brought to the end of its numbers: it may refuse, and keeps what it is, or goes on soundly."""
        self.trace.operation(f"extreme: {what}, seed {seed}")
        rng, f = np.random.default_rng(seed), copy.deepcopy(self.f)
        u = self.control(rng)
        ids, z = self.sightings(rng, 5)
        x, P = np.array(f.x), np.array(f.P)
        size = 10.0 ** rng.integers(3, 100 if what in ("huge dt", "huge P") else 12)
        acts: list[Callable[[], Any]] = []
        if what == "huge dt":
            acts.append(lambda: f.predict(u, size))
        elif what == "huge z":
            acts.append(lambda: f.observe_scan(Scan(tuple(ids), z * size)))
        elif what == "huge P":
            acts.append(lambda: setattr(f, "P", P * size + np.diag(np.arange(len(P)) * size * 1e-3)))
        elif what == "on the robot" and self.ids:
            x[3:5] = x[:2] + 1e-8 * rng.integers(0, 2)
            acts += [lambda: setattr(f, "x", x), lambda: f.observe(self.ids[0], z[0] if len(z) else (1.0, 0.1))]
        elif what == "tiny range":
            acts.append(lambda: f.observe("new", (10.0 ** -rng.integers(0, 20), 0.1)))
            acts.append(lambda: f.observe("new", (10.0 ** -rng.integers(0, 20), 0.1)))
        elif what == "far x":
            acts.append(lambda: setattr(f, "x", x + size))
        acts += [lambda: f.step(u, DT, Scan(tuple(ids), z)), lambda: f.observe_scan(Scan(tuple(ids), z))]
        largest = self.largest
        for act in acts:
            before = copy.deepcopy(f)
            error = refusal(act)
            if error is not None:
                bad = differing(inside(before), inside(f))
                assert not bad, f"{bad} changed by {error}"
            g = copy.deepcopy(f)
            P = np.array(g.P)
            assert np.isfinite(g.x).all() and np.isfinite(P).all()
            largest = max(largest, float(np.diag(P).max()))
            smallest = np.linalg.eigvalsh(P / largest)[0]
            assert smallest >= -1e-9, f"smallest eigenvalue {smallest} of the largest variance so far, {largest}"


class _Told:
    """A belief as `alike` compares it."""

    def __init__(self, x: Any, P: Any, ids: Any) -> None:
        self.x, self.P, self.landmark_ids = x, P, ids


def bad_calls(m: FilterMachine) -> dict[str, Callable[[Any], Any]]:
    """Calls that must be refused, each under a name."""
    u = np.ones(3 if m.motion == "odometry" else 2) * 0.1
    known = m.ids[0] if m.ids else "new"
    calls: dict[str, Callable[[Any], Any]] = {}
    for dt in (0.0, -1.0, np.nan, np.inf, "a", None, 10**400, True, 1j, [0.1], np.array([0.1, 0.1])):
        calls[f"dt {dt!r:.20}"] = lambda f, dt=dt: f.predict(u, dt)
        calls[f"step dt {dt!r:.20}"] = lambda f, dt=dt: f.step(u, dt, {known: (3.0, 0.1)})
    for v in (u * np.nan, u[:0], u[None], np.ones(5), u.astype(complex), "u", None, [None] * len(u), u[0], [u, 1], {}):
        if m.plain and isinstance(v, np.ndarray) and v.shape == (5,):
            continue  # a plain model does not say how long its controls are
        calls[f"u {v!r:.40}"] = lambda f, v=v: f.predict(v, DT)
        calls[f"step u {v!r:.40}"] = lambda f, v=v: f.step(v, DT, {known: (3.0, 0.1), "other": (4.0, 0.2)})
    for z in (np.nan, [np.nan, 0.1], [3.0, np.inf], [3.0], [3.0, 0.1, 0.2], [[3.0, 0.1]], [3.0, 1j], "z", None, [], {}):
        calls[f"z {z!r:.30}"] = lambda f, z=z: f.observe(known, z)
        calls[f"new z {z!r:.30}"] = lambda f, z=z: f.observe("new", z)
        calls[f"step z {z!r:.30}"] = lambda f, z=z: f.step(u, DT, {"other": (3.0, 0.1), known: z})
        calls[f"last z {z!r:.30}"] = lambda f, z=z: f.step(u, DT, {known: (3.0, 0.1), "other": (4.0, 1.0), "last": z})
    if m.sensor == "range-bearing":
        for r in (-1.0, -1e-300):
            calls[f"range {r}"] = lambda f, r=r: f.observe(known, (r, 0.1))
            calls[f"step range {r}"] = lambda f, r=r: f.step(u, DT, {"a new": (3.0, 0.1), known: (r, 0.1)})
        calls["a new landmark on the robot"] = lambda f: f.step(u, DT, {known: (3.0, 0.1), "a new": (0.0, 0.1)})
    z2 = np.array([[3.0, 0.1], [4.0, 0.2]])
    for ids in (("a", "a"), (known, known), None, (), ("a",), ("a", []), ("a", "b", "c")):
        calls[f"ids {ids!r}"] = lambda f, ids=ids: f.observe_scan(Scan(ids, z2))
        calls[f"step ids {ids!r}"] = lambda f, ids=ids: f.step(u, DT, Scan(ids, z2))
    for scan in (None, 3, "scan", [("a", (3.0, 0.1))], Scan(("a", "b"), z2[:, :1]), np.nan):
        calls[f"scan {scan!r:.40}"] = lambda f, scan=scan: f.step(u, DT, scan)
    calls["unhashable id"] = lambda f: f.observe([1], (3.0, 0.1))
    for i in ("nobody", [1], {}, np.nan):
        calls[f"remove {i!r}"] = lambda f, i=i: f.remove(i)
        calls[f"marginal {i!r}"] = lambda f, i=i: f.marginal([i])
    for log in (None, [], "log"):
        calls[f"run {log!r}"] = lambda f, log=log: f.run(log)
    calls["run a log of three columns"] = lambda f: f.run(Log([0.0], [u], [1.0], [0], [(1.0, 0.0, 0.0)], (1,)))
    calls["run a log of other controls"] = lambda f: f.run(Log([0.0], [[]], [1.0], [0], [(1.0, 0.0)], (1,)))
    D = 3 + 2 * len(m.ids)
    for n, x in enumerate((np.zeros(D + 1), np.full(D, np.nan), None, "x", 1.0, np.zeros((D, 1)), np.zeros(D) * 1j)):
        calls[f"x {n}"] = lambda f, x=x: setattr(f, "x", x)
    skew = np.eye(D)
    skew[0, 1] = 0.5
    indefinite = np.eye(D)
    indefinite[0, 1] = indefinite[1, 0] = 2.0
    for n, P in enumerate((-np.eye(D), np.eye(D + 1), np.eye(D) * np.nan, skew, indefinite, None, 1.0, np.eye(D) * 1j)):
        calls[f"P {n}"] = lambda f, P=P: setattr(f, "P", P)
    for name, values in {
        "order": ("x", None, 1, True),
        "gate": (-1.0, 0.0, np.nan, "a", True, [1.0], 1j, -np.inf),
        "motion": (None, Unicycle, 3, RangeBearing(0.1, 0.1)),
        "sensor": (None, RangeBearing, Unicycle(0.1, 0.1), "s"),
        "gates": (3,),
        "snapshots": (True,),
        "storage": (None,),
        "K": (np.eye(2),),
        "dim_z": (3,),
        "landmark_ids": ((),),
    }.items():
        for n, value in enumerate(values):
            calls[f"{name} {n}"] = lambda f, name=name, value=value: setattr(f, name, value)
    return calls


def main() -> None:
    """Do the operations that the command line asks for."""
    given = arguments()
    FilterMachine.folder = given.folder
    with open(given.folder / "trace", "w") as file, np.errstate(all="ignore"):
        FilterMachine.trace = Trace(file)
        options = settings(
            max_examples=max(1, min(given.count // 50, 50)), stateful_step_count=60, deadline=None, database=None,
            suppress_health_check=list(HealthCheck), print_blob=False,
            phases=(Phase.generate, *([Phase.shrink] if given.shrink else [])),
        )  # fmt: skip
        number = given.seed
        while FilterMachine.trace.count < given.count:
            run_state_machine_as_test(seed(number)(FilterMachine), settings=options)
            number += 1
    print(f"{FilterMachine.trace.count} operations, {FilterMachine.refused} of them refused")


if __name__ == "__main__":
    main()
