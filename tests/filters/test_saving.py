"""Filter files that are well formed and wrong are refused before compiled code sees them, and cheaply."""

from __future__ import annotations

import subprocess
import sys
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from family import drive
from filter_examples import POSE, all_filters, every_filter, every_storage, grown, make, same

from slamkit import EKFSLAM, LogFileError, Storage
from slamkit.belief.files import FORMS
from slamkit.logs import read_archive, write_archive
from slamkit.models import RangeBearing, Unicycle

#: The last filter that was saved, and what its file holds.
KEPT: dict[int, Any] = {}
FACTS = ("filter", "order", "gate", "snapshots", "storage", "dim_u", "ids", "motion", "sensor", "own")


def changed(f: Any, path: Path, facts: dict[str, Any] | None = None, arrays: dict[str, Any] | None = None) -> Path:
    """The file of a filter, some facts and arrays of which are replaced; `...` takes one away."""
    if id(f) not in KEPT:
        f.save(path)
        KEPT.clear()
        KEPT[id(f)] = (f, *read_archive(path, "filter"))
    _, old_facts, old_arrays = KEPT[id(f)]
    new_facts, new_arrays = old_facts | (facts or {}), old_arrays | (arrays or {})
    write_archive(
        path,
        "filter",
        {n: v for n, v in new_facts.items() if v is not ...},
        {n: v for n, v in new_arrays.items() if v is not ...},
    )
    return path


def refused(kind: Any, path: Path, what: str = "") -> None:
    said = ""
    try:
        kind.load(path)
    except LogFileError as error:
        said = str(error)
    assert str(path) in said, f"{what}: loaded"


CHANGES: dict[str, Callable[[Any], Any]] = {
    "missing": lambda a: ...,
    "shorter": lambda a: a[:-1],
    "longer": lambda a: np.concatenate([a, a[-1:]]),
    "empty": lambda a: a[:0],
    "an axis more": lambda a: a[None],
    "an axis less": lambda a: a[0],
    "broadcast": lambda a: a.ravel()[:1],
    "wider": lambda a: np.pad(a, [(0, 0)] * (a.ndim - 1) + [(0, 64)]),
    "much longer": lambda a: np.pad(a, [(0, 64 * 200)] + [(0, 0)] * (a.ndim - 1)),
    "NaN": lambda a: a * np.nan,
    "infinite": lambda a: a * np.inf + np.inf,
    "float32": lambda a: a.astype(np.float32),
    "int32": lambda a: a.astype(np.int32),
    "big-endian": lambda a: a.astype(">f8"),
    "complex": lambda a: a.astype(complex),
    "text": lambda a: a.astype(str),
    "negative": lambda a: a - 7,
    "absurd": lambda a: a + 2**40,
}
#: What some arrays may be: their file is one of another filter, and sound.
SOUND = {
    *((name, change) for name in ("belief.mean", "belief.linearised_at", "resting.mean", "resting.linearised_at",
                                  "last.F", "last.Q", "last.z", "last.y", "last.S", "last.L", "last.t", "last.w", "own")
      for change in ("negative", "absurd")),
    *((name, "absurd") for name in ("resting.debt", "resting.spent", "resting.spent_plain", "resting.most_columns",
                                    "resting.stays", "belief.cov",
                                    "resting.store")),
    ("resting.stays", "negative"), ("resting.most_columns", "infinite"), ("resting.most_columns", "negative"),
}  # fmt: skip


def applies(change: str, a: Any) -> bool:
    if change in ("missing", "an axis more"):
        return True
    if change in ("NaN", "infinite", "complex", "text", "float32", "int32", "big-endian", "negative", "absurd"):
        return bool(a.size)
    if change == "broadcast":
        return bool(a.size > 1)
    return bool(a.ndim and a.shape[0] > 1 and a.size)


@all_filters
@every_storage
def test_every_array_has_its_form(name: str, storage: Any, tmp_path: Path) -> None:
    f = grown(name, storage=storage)
    f.observe("L0", f.sensor.predict(f.pose, f.landmarks["L0"]) + 0.01)
    f.save(tmp_path / "f")
    _, arrays = read_archive(tmp_path / "f", "filter")
    assert set(arrays) == set(FORMS)
    # All of them for one filter; for the others, which share its arrays, every fifth.
    rng = np.random.default_rng(sum(map(ord, name)))
    for array, value in arrays.items():
        for change, act in CHANGES.items():
            if not applies(change, value) or (array, change) in SOUND or (name != "ekf" and rng.random() > 0.2):
                continue
            with np.errstate(all="ignore"):
                wrong = act(value)
            if wrong is not ... and wrong.dtype == value.dtype and np.array_equal(wrong, value, equal_nan=True):
                continue
            path = changed(f, tmp_path / "g", arrays={array: wrong})
            refused(type(f), path, f"{array} {change}")
    refused(type(f), changed(f, tmp_path / "g", arrays={"further": np.zeros(3)}))


@every_filter
@pytest.mark.parametrize(
    "case", ["indefinite", "negative variance", "correlated beyond 1", "L is not a factor", "swapped counts"]
)
def test_a_belief_that_cannot_be_is_refused(name: str, case: str, tmp_path: Path) -> None:
    for storage in (Storage(), Storage(compress_above=0)):
        f = grown(name, storage=storage)
        f.save(tmp_path / "f")
        _, arrays = read_archive(tmp_path / "f", "filter")
        cov, store = arrays["belief.cov"].copy(), arrays["resting.store"].copy()
        if case == "indefinite":
            wrong = {"belief.cov": -cov}
        elif case == "negative variance":
            cov[-1, -1] = -1e-6
            wrong = {"belief.cov": cov}
        elif case == "correlated beyond 1":
            cov[-1, 0] = 10 * np.sqrt(cov[-1, -1] * cov.max()) + 1.0
            wrong = {"belief.cov": cov}
            if len(store):
                wrong = {"resting.store": -store}
        elif case == "L is not a factor":
            wrong = {"last.L": -arrays["last.L"]}
        else:
            wrong = {"belief.active": arrays["belief.dim"] + 2}
        refused(type(f), changed(f, tmp_path / "g", arrays=wrong))


@all_filters
def test_every_fact_has_its_kind(name: str, tmp_path: Path) -> None:
    f = grown(name)
    f.save(tmp_path / "f")
    facts, _ = read_archive(tmp_path / "f", "filter")
    assert set(facts) == set(FACTS)
    wrong: list[tuple[str, Any]] = [(fact, ...) for fact in FACTS]
    wrong += [("filter", 3), ("filter", "nobody"), ("order", "random"), ("order", None)]
    wrong += [("gate", g) for g in (True, "a", -1.0, 0, [1.0], float("nan"))]
    wrong += [("snapshots", s) for s in ("no", 1, None)]
    wrong += [("dim_u", n) for n in (0, 1, 3, -1, 10**5, 10**30, True, "2", None, 2.0)]
    wrong += [("ids", []), ("ids", facts["ids"][:-1]), ("ids", facts["ids"] * 2), ("ids", [facts["ids"][0]] * 6)]
    wrong += [("ids", [{}] * 6), ("ids", None), ("motion", {}), ("sensor", {"name": "x"}), ("motion", 3)]
    wrong += [("sensor", facts["motion"]), ("motion", facts["sensor"]), ("own", None), ("own", [])]
    storage = facts["storage"]
    wrong += [("storage", storage | {key: value}) for key in storage for value in ("a", -1, True, [1], {})]
    wrong += [("storage", storage | {"compress_above": "many"}), ("storage", {"further": 1}), ("storage", [])]
    nested: Any = 1
    for _ in range(500):
        nested = [nested]
    wrong += [("own", nested), ("ids", nested), ("storage", {"compress_above": nested}), ("further", 1)]
    for key, value in facts["own"].items():
        wrong += [("own", {k: v for k, v in facts["own"].items() if k != key})]
        if value is not None:
            wrong += [("own", facts["own"] | {key: bad}) for bad in ("x", [1], {}, 10**400, True)]
    for fact, value in wrong:
        path = changed(f, tmp_path / "g", facts={fact: value})
        refused(type(f), path, f"{fact} = {value!r}")


@all_filters
@every_storage
def test_a_filter_that_was_changed_is_saved_as_it_is(name: str, storage: Any, tmp_path: Path) -> None:
    f = grown(name, storage=storage)
    f.gate, f.order, f.sensor, f.motion = 30.0, "batch", RangeBearing(0.5, 0.2), Unicycle(0.4, 0.3)
    f.save(tmp_path / "f")
    g = type(f).load(tmp_path / "f")
    assert (g.gate, g.order, g.sensor, g.motion) == (f.gate, f.order, f.sensor, f.motion)
    later = drive(f.motion, f.sensor, seed=5)
    if name == "ideal":
        f.truth = g.truth = later.truth
    for h in (f, g):
        h.run(later)
    assert same(f, g)


def test_loading_is_cheap(tmp_path: Path) -> None:
    """No file makes a reader ask for more memory than it is long, or think for long."""
    f = EKFSLAM(Unicycle(0.1, 0.05), RangeBearing(0.1, 0.02), POSE, np.eye(3))
    f.observe_scan({i: (3.0 + 0.01 * i, 0.001 * i) for i in range(300)})
    f.save(tmp_path / "f")
    size = (tmp_path / "f").stat().st_size
    tracemalloc.start()
    begun = time.perf_counter()
    EKFSLAM.load(tmp_path / "f")
    assert time.perf_counter() - begun < 5.0
    assert tracemalloc.get_traced_memory()[1] < 12 * size
    tracemalloc.stop()
    for wrong in (
        {"belief.dim": np.array(2**40)},
        {"last.rows": np.array(2**40)},
        {"resting.columns": np.array(2**31)},
    ):
        path = changed(f, tmp_path / "g", arrays=wrong)
        tracemalloc.start()
        refused(EKFSLAM, path)
        assert tracemalloc.get_traced_memory()[1] < 12 * size
        tracemalloc.stop()


CHILD = """
import sys
sys.path[:0] = {path!r}
import numpy as np
from test_saving import use_whatever_loads
from family import FILTERS
for name in FILTERS:
    use_whatever_loads(name, sys.argv[1])
"""


def use_whatever_loads(name: str, folder: str) -> None:
    """Small changes of every number of a file; what is not refused is used, and must not end the process."""
    rng, path = np.random.default_rng(0), Path(folder) / "h"
    loaded = 0
    for storage in (Storage(), Storage(compress_above=0)):
        f = make(name, storage=storage)
        f.run(drive(f.motion, f.sensor, steps=15))
        f.save(Path(folder) / "f")
        _, arrays = read_archive(Path(folder) / "f", "filter")
        for array, value in arrays.items():
            for _ in range(1 + value.size // 4 % 3):
                wrong = np.array(value)
                if wrong.size:
                    flat = wrong.reshape(-1)
                    flat[rng.integers(wrong.size)] += rng.choice([-1, 1]) * 10 ** int(rng.integers(0, 12))
                try:
                    g = type(f).load(changed(f, path, arrays={array: wrong}))
                except LogFileError:
                    continue
                loaded += 1
                for k in range(4):
                    try:
                        g.step((1.0, 0.1), 0.1, {("n", k): (3.0, 0.1), "L0": (2.0, 0.1)})
                    except ValueError:
                        pass
                    except Exception as error:
                        if type(error).__module__ != "slamkit.errors":
                            raise
                g.flush()
                _ = g.P, g.K, g.x
    print("loaded", loaded)


def test_what_is_not_refused_can_be_used(tmp_path: Path) -> None:
    """In a process of its own: a fatal signal is a finding."""
    code = CHILD.format(path=[*sys.path, str(Path(__file__).parent)])
    done = subprocess.run([sys.executable, "-c", code, str(tmp_path)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-3000:]
    assert "loaded" in done.stdout
