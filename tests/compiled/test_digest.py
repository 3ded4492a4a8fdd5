"""A user's compiled function is never stale: what it uses, in any module, is part of what it is kept under."""

from __future__ import annotations

import copy
import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import cloudpickle
import numpy as np
import pytest

from slamkit.compiled import compiled

ROOT = Path(__file__).resolve().parents[2]

#: A package of constants and helpers, all of which are read by the functions below.
VALUES = """
from enum import IntEnum
import numba
import numpy as np

CONSTANT = {value}
TABLE = np.array([0.0, {value}])
TUPLE = (0.0, {value})

class Kind(IntEnum):
    ONE = int({value})

def helper(x, *, factor={value}):
    return factor * x

@numba.njit
def jitted(x):
    return {value} * x

@numba.njit
def inner(x):
    return {value} * x

@numba.njit
def outer(x):
    return inner(x)

def factory(value):
    @numba.njit
    def closed(x):
        return value * x
    return closed

closed = factory({value})

@numba.njit
def default(x, factor={value}):
    return factor * x
"""
FUNCTIONS = """
from slamkit.compiled import compiled
import tools
import tools.values
from tools import values
from tools.values import CONSTANT, TABLE, TUPLE, Kind, closed, default, jitted, outer

@compiled("real(real)")
def by_constant(x):
    return CONSTANT * x

@compiled("real(real)")
def by_module(x):
    return values.CONSTANT * x

@compiled("real(real)")
def by_package(x):
    return tools.values.CONSTANT * x

@compiled("real(real)")
def by_array(x):
    return TABLE[1] * x

@compiled("real(real)")
def by_tuple(x):
    return TUPLE[1] * x

@compiled("real(real)")
def by_enum(x):
    return Kind.ONE.value * x

@compiled("real(real)")
def by_helper(x):
    return jitted(x)

@compiled("real(real)")
def by_helper_of_a_helper(x):
    return outer(x)

@compiled("real(real)")
def by_closure(x):
    return closed(x)

@compiled("real(real)")
def by_default(x):
    return default(x)

@compiled("real(real)")
def by_another(x):
    return by_module(x)

@compiled("real(real)")
def by_helper_in_module(x):
    return tools.values.jitted(x)

FOUND = dict(vars())
"""
RUN = """
import sys
sys.path[:0] = {path!r}
import functions
from slamkit.compiled import Compiled
for name, function in functions.FOUND.items():
    if isinstance(function, Compiled):
        print(name, function(2.0))
"""


def run(folder: Path, value: float) -> dict[str, float]:
    (folder / "tools").mkdir(exist_ok=True)
    (folder / "tools" / "__init__.py").write_text("")
    (folder / "tools" / "values.py").write_text(VALUES.format(value=value))
    (folder / "functions.py").write_text(FUNCTIONS)
    os.utime(folder / "functions.py", (1, 1))
    environment = os.environ | {"NUMBA_CACHE_DIR": str(folder / "cache"), "PYTHONDONTWRITEBYTECODE": "1"}
    code = RUN.format(path=[str(folder), str(ROOT)])
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "CacheWarning" not in done.stderr
    return {name: float(value) for name, value in map(str.split, done.stdout.splitlines())}


def test_a_change_in_whatever_is_used_is_seen(tmp_path: Path) -> None:
    for value in (1.0, 100.0, 1.0):
        results = run(tmp_path, value)
        assert len(results) == 12
        assert results == dict.fromkeys(results, 2 * value)
    kept = {p: p.stat().st_mtime_ns for p in (tmp_path / "cache").rglob("*.nb*")}
    assert any("by_package" in str(path) for path in kept)
    run(tmp_path, 1.0)
    assert kept == {p: p.stat().st_mtime_ns for p in (tmp_path / "cache").rglob("*.nb*")}, "what is the same is read"


def test_functions_without_a_file_run_without_a_cache(tmp_path: Path) -> None:
    source = """
from slamkit.compiled import compiled
FACTOR = {value}
@compiled("real(real)")
def inner(x):
    return FACTOR * x
@compiled("real(real)")
def outer(x):
    return inner(x) + FACTOR
print(outer(2.0))
LINES = ["from slamkit.compiled import compiled", "@compiled('real(real)')", "def f(x):", "    return {value} * x"]
namespace = {{}}
exec(chr(10).join(LINES), namespace)
print(namespace["f"](2.0))
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(ROOT)}
    for value in (1.0, 100.0):
        for call in (["-c", source.format(value=value)], ["-"]):
            done = subprocess.run(
                [sys.executable, *call],
                env=environment,
                capture_output=True,
                text=True,
                input=source.format(value=value),
            )
            assert done.returncode == 0, done.stderr
            assert [float(v) for v in done.stdout.split()] == [3 * value, 2 * value]


@compiled("real(real)")
def doubled(x: Any) -> Any:
    return 2.0 * x


def test_copies_of_a_compiled_function() -> None:
    """A copy is the function itself; pickled by name where it has one, by value where it has none."""
    assert copy.deepcopy(doubled) is doubled
    assert pickle.loads(pickle.dumps(doubled)) is doubled

    @compiled("real(real)")
    def inner(x: Any) -> Any:
        return doubled(x) + 1.0

    assert copy.deepcopy(inner) is inner
    again = cloudpickle.loads(cloudpickle.dumps(inner))
    assert again is not inner and again(3.0) == 7.0 and again.signature == inner.signature


STUDY = """
import sys
sys.path[:0] = {path!r}
import numpy as np
from small_study import world
from slamkit import EKFSLAM
from slamkit.compiled import OwnFields, compiled
from slamkit.cycle import EstimatorFunctions
from slamkit.cycle.standard import motion as standard_motion
from slamkit.study import compare

own = OwnFields(turns=1)
WEIGHT = 0.0

@compiled("void(models, state, vector, real)", generic=True)
def motion(models, state, u, dt):
    standard_motion(models, state, u, dt)
    own(state).turns += 1.0 + WEIGHT

class Mine(EKFSLAM):
    name = "mine"
    own_fields = own
    functions = EstimatorFunctions(motion=motion)

if __name__ == "__main__":
    study = compare({{"ekf": EKFSLAM, "mine": Mine}}, world(4), 2, jobs=2, gauge_steps=0)
    assert not study.failures, study.failures
    assert all((a.nees == b.nees).all() for a, b in zip(study.trials["ekf"], study.trials["mine"]))
    print("done")
"""


def test_a_study_in_a_script_takes_its_compiled_functions_along(tmp_path: Path) -> None:
    path = [str(ROOT), str(ROOT / "tests" / "study"), str(ROOT / "tests")]
    (tmp_path / "script.py").write_text(STUDY.format(path=path))
    done = subprocess.run([sys.executable, str(tmp_path / "script.py")], capture_output=True, text=True)
    assert done.returncode == 0 and "done" in done.stdout, done.stderr[-3000:]


@pytest.mark.parametrize("value", [1.0, -0.0, np.float64(3.0), 7, True, "a", b"a", None, (1, (2.0,)), np.arange(3)])
def test_a_digest_tells_values_apart(value: Any) -> None:
    from slamkit.compiled.digest import _Walk

    others = [1.0, 0.0, -0.0, np.float64(3.0), 7, 1, True, "a", b"a", None, (1, (2.0,)), np.arange(3), np.arange(3.0)]

    def digest(v: Any) -> str:
        walk = _Walk("")
        walk.add(v)
        return walk.hash.hexdigest()

    assert [digest(v) for v in others].count(digest(value)) == 1
