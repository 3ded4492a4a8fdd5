"""Where other people's filters differ from slamkit in benchmarks/scaling.py, and what becomes of one that hangs."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
NOISE = ("SIGMA_V", "SIGMA_OMEGA", "SIGMA_RANGE", "SIGMA_BEARING", "START")

Module = Callable[[str], Any]


@pytest.fixture
def module(monkeypatch: pytest.MonkeyPatch) -> Module:
    """Modules of the benchmarks, by name."""
    # The script sets these for its own process; here they are taken back after the test.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"):
        monkeypatch.setenv(name, "1")
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return import_module


def present(module: Module, name: str, work: Any) -> Any:
    """A contender of `CONTENDERS`; the test is skipped where what it needs is not there."""
    found = module("contenders")
    try:
        return found.contender(name)(work)
    except found.MissingError as missing:
        pytest.skip(str(missing))


def belief(contender: Any, steps: int) -> tuple[Any, Any]:
    """State and covariance after some steps of the drive."""
    contender.start()
    contender.ready(contender.work.survey, contender.work.survey + steps)()
    x, P = contender.joint(np.arange(contender.work.dim))
    return np.array(x), np.array(P)


def apart(module: Module, one: tuple[Any, Any], other: tuple[Any, Any]) -> float:
    """The benchmark's measure of disagreement [standard deviations]."""
    found: float = module("scaling").disagreement(one, other, np.arange(len(one[0])))
    return found


def shrink(module: Module, monkeypatch: pytest.MonkeyPatch, scale: float, least: float) -> None:
    """Less noise in the work and in the filters that know it, and less of iSAM2's own."""
    smaller = {name: getattr(module("_workload"), name) * scale for name in NOISE}
    for there in ("_workload", "contenders.dense", "contenders.isam2"):
        for name in set(NOISE) & set(vars(module(there))):
            monkeypatch.setattr(module(there), name, smaller[name])
    monkeypatch.setattr(module("contenders.isam2"), "LEAST", module("contenders.isam2").LEAST * least)


def davison(module: Module, work: Any, steps: int) -> tuple[Any, Any]:
    """The EKF that MRPT is: stale Jacobians, scalars with residuals taken together, sightings in single precision."""
    dense = module("contenders.dense")
    mapped = work.surveyed()
    x, P = mapped.x.copy(), mapped.P.copy()
    for u, dt, sightings in dense._steps(work, work.survey, work.survey + steps):
        F, Q = np.eye(len(x)), np.zeros_like(P)
        x[:3], F[:3, :3], Q[:3, :3] = dense.move(x[:3], u, dt)
        P = F @ P @ F.T + Q
        jacobians = [dense.jacobian(x, slot) for slot, _ in sightings]
        for (slot, z), H in zip(sightings, jacobians, strict=True):
            y = dense.residual(z.astype(np.float32).astype(np.float64), dense.predicted(x, slot))
            for h, r, R in zip(H, y, np.diag(dense.R), strict=True):
                S = h @ P @ h + R
                K = P @ h / S
                x = x + K * r
                P = P - S * np.outer(K, K)
    return x, P


@pytest.mark.slow  # MRPT's headers take long to compile
@pytest.mark.parametrize("landmarks", [3, 50])
def test_mrpt_is_an_ekf_with_the_form_that_is_said_of_it(module: Module, landmarks: int) -> None:
    work = module("_workload").make_work(landmarks, np.random.default_rng(landmarks), drive=60)
    contender = present(module, "MRPT", work)
    found = belief(contender, 60)
    assert apart(module, davison(module, work, 60), found) < module("contenders").ROUNDING
    ours = belief(present(module, "slamkit, run", work), 60)
    assert 1e-5 < apart(module, ours, found) < contender.tolerance


@pytest.mark.parametrize("name", ["iSAM2", "iSAM2 + covariance"])
def test_smoother_goes_to_the_filter_as_the_noise_goes_to_zero(
    module: Module, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    tolerance, found = module("contenders").contender(name).tolerance, {}
    for scale in (1.0, 0.1, 0.001):
        with monkeypatch.context() as patch:
            shrink(module, patch, scale, least=scale if scale == 1.0 else 0.05 * scale)
            work = module("_workload").make_work(10, np.random.default_rng(10), drive=60)
            contender = present(module, name, work)
            found[scale] = apart(module, belief(present(module, "slamkit, run", work), 60), belief(contender, 60))
    assert found[1.0] < tolerance
    assert found[0.001] < found[0.1] / 50 and found[0.1] < 0.1


def test_worker_that_hangs_or_dies_is_given_up(module: Module, monkeypatch: pytest.MonkeyPatch) -> None:
    workers = module("_worker")
    monkeypatch.setattr(workers, "LIMIT", 20.0)
    dying = workers.Worker()
    with pytest.raises(RuntimeError, match="exit code 3"):
        dying(os._exit, 3)
    dying.close()
    hanging = workers.Worker()
    assert hanging(abs, -2) == 2
    monkeypatch.setattr(workers, "LIMIT", 0.2)
    with pytest.raises(TimeoutError, match=r"0\.2 s"):
        hanging(time.sleep, 60)
    hanging.close()
