"""Worker processes: on this machine and with Dask; what cannot be sent to them, and how they survive a death."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from typing import Any

import pytest
from small_study import assert_same, small, unlucky

import slamkit
from slamkit import EKFSLAM, History, InputError, Log
from slamkit.study import Study


def test_dask_with_two_workers_gives_the_same(study: Study) -> None:
    pytest.importorskip("distributed")
    assert_same(study, small(backend="dask", jobs=2))


def test_dask_uses_the_client_in_force_or_the_address(study: Study) -> None:
    distributed = pytest.importorskip("distributed")
    local = {"n_workers": 1, "threads_per_worker": 2, "processes": False, "dashboard_address": None}
    with distributed.LocalCluster(**local) as cluster, distributed.Client(cluster) as client:
        assert_same(study, small(backend="dask"))
        assert client.submit(int, 1).result() == 1, "a client that was there must stay open"
        assert len(client.scheduler_info()["workers"]) == 1
        assert cluster.scheduler_address.startswith("inproc://")
        assert_same(study, small(backend=cluster.scheduler_address))


SCRIPT = """
import sys
sys.path.insert(0, {here!r})
from dataclasses import replace
from slamkit import EKFSLAM
from slamkit.cycle import EstimatorFunctions
from slamkit.models import RelativePosition
from slamkit.study import compare
from small_study import world

class Mine(EKFSLAM):
    name = "mine"

class MySensor(RelativePosition):
    pass

{body}
"""
TRAVELS = """
w = replace(world(4), sensor=MySensor(0.1))
study = compare({"ekf": EKFSLAM, "mine": Mine, "made": lambda *a, **o: Mine(*a, **o)}, w, 2, jobs=2, gauge_steps=0)
assert not study.failures, study.failures
assert all((a.nees == b.nees).all() for a, b in zip(study.trials["ekf"], study.trials["mine"]))
"""
COMPILED = """
from slamkit.compiled import compiled
from slamkit.cycle.standard import sensor as standard_sensor
from slamkit.errors import InputError

@compiled("void(models, state, vector, vector, index, vector, index)", generic=True)
def sensor(models, state, pose, landmark, slot, z, row):
    standard_sensor(models, state, pose, landmark, slot, z, row)

class Compiled(Mine):
    functions = EstimatorFunctions(sensor=sensor)

try:
    study = compare({"mine": Compiled}, world(4), 1, jobs=1, gauge_steps=0)
except InputError as error:
    assert "filter 'mine' cannot be loaded in a worker process" in str(error) and "__main__" in str(error), error
else:
    assert not study.failures, study.failures
"""


@pytest.mark.parametrize("body", [TRAVELS, COMPILED], ids=["python", "compiled"])
def test_classes_of_a_script_or_cell_work_or_are_refused_before_anything_runs(tmp_path: Path, body: str) -> None:
    """A cell of a notebook is in the same place as the script here: its classes are those of __main__."""
    path = tmp_path / "script.py"
    path.write_text(SCRIPT.format(here=str(Path(__file__).parent), body=body))
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, cwd=tmp_path, env=environment())
    assert done.returncode == 0, done.stderr


def environment() -> dict[str, str]:
    """The environment of a process that finds this slamkit."""
    return {**os.environ, "PYTHONPATH": str(Path(slamkit.__file__).parents[1])}


def test_what_cannot_be_sent_to_workers_is_refused_before_anything_runs(tmp_path: Path) -> None:
    lock = threading.Lock()

    def locked(*arguments: Any, **options: Any) -> Any:
        with lock:
            return EKFSLAM(*arguments, **options)

    with pytest.raises(InputError, match=r"filter 'locked' cannot be loaded in a worker process .*lock"):
        small(filters={"ekf": EKFSLAM, "locked": locked}, folder=tmp_path)
    with pytest.raises(InputError, match="options cannot be loaded"):
        small(options={"truth": lock}, folder=tmp_path)
    assert not list(tmp_path.iterdir())


class Deadly(EKFSLAM):
    """Ends its process in the trials whose first measurement is an odd number of micrometres."""

    name = "deadly"

    def run(self, log: Log, progress: Any = False) -> History:
        if unlucky(log) and len(log) > 2:
            os._exit(3)
        return super().run(log, progress)


class Exits(EKFSLAM):
    """Calls sys.exit in every run."""

    name = "exits"

    def run(self, log: Log, progress: Any = False) -> History:
        sys.exit("no more")


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_filter_that_ends_its_process_loses_its_own_trials_only(jobs: int) -> None:
    study = small(filters=["ekf", Deadly, Exits], runs=4, gauge_steps=0, jobs=jobs)
    wrong = {k for k in range(4) if unlucky(study.rerun(k, "ekf")[1])}
    assert 0 < len(wrong) < 4
    assert len(study.finished("ekf")) == 4
    assert {t.number for t in study.trials["deadly"] if t.error} == wrong
    assert all("the worker process failed" in t.error for t in study.trials["deadly"] if t.error)
    assert [t.error for t in study.trials["exits"]] == ["SystemExit: no more"] * 4


def test_a_dask_scheduler_that_does_not_answer_is_named_within_seconds(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    with socket.socket() as free:  # bound, but nobody listens
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        began = time.monotonic()
        with pytest.raises(InputError, match=f"scheduler at {address} does not answer"):
            small(backend=address, folder=tmp_path)
        assert time.monotonic() - began < 15
    with pytest.raises(InputError, match="scheduler at carrier://pigeon does not answer"):
        small(backend="carrier://pigeon", folder=tmp_path)
    assert not list(tmp_path.iterdir())
