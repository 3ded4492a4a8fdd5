"""How functions become machine code: where it is made, how often, and that a study asks for all that it will need."""

import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from numba.core.codegen import JITCodeLibrary

from slamkit import InputError
from slamkit.compiled import Compiled, compiled, needed
from slamkit.filters import FILTERS
from slamkit.models import RangeBearing, Unicycle
from slamkit.simulate import WORLDS
from slamkit.study import prepare


@compiled("real(vector)")
def total(v: Any) -> float:
    s = 0.0
    for x in v:
        s += x
    return s


@compiled("real(vector, real)")
def scaled_total(v: Any, factor: float) -> float:
    return factor * total(v)


@compiled("real(vector)", generic=True)
def twice(v: Any) -> float:
    return scaled_total(v, 2.0)


@compiled("real(vector)")
def last_of_a_copy(v: Any) -> Any:
    copy = np.empty(v.shape[0])
    for i in range(v.shape[0]):
        copy[i] = v[i]
    return copy[-1]


@compiled("real(vector)")
def more_than_last(v: Any) -> Any:
    return np.ones(1)[0] + last_of_a_copy(v)


def test_functions_of_a_user_may_make_arrays() -> None:
    assert last_of_a_copy(np.arange(4.0)) == 3.0
    assert more_than_last(np.arange(4.0)) == 4.0


def test_a_fragment_becomes_machine_code_only_where_it_is_called() -> None:
    """This rests on parts of Numba that it does not document: where they change, it fails here."""
    assert scaled_total(np.arange(4.0), 2.0) == 12.0
    assert "dispatcher" not in vars(total)
    if not total.jitted.overloads:  # where `scaled_total` was read from disk
        total._compile(total.jitted)
    [result] = total.jitted.overloads.values()
    assert isinstance(result.library, JITCodeLibrary)
    assert result.library.get_pointer_to_function(result.fndesc.llvm_func_name) == 0
    assert total(np.arange(4.0)) == 6.0  # for Python it is a function of its own
    [result] = total.dispatcher.overloads.values()
    assert result.library.get_pointer_to_function(result.fndesc.llvm_func_name) != 0


def test_what_a_python_form_calls_is_needed() -> None:
    assert needed([twice]) == [twice, scaled_total]
    assert needed([scaled_total]) == [scaled_total]


USED = """
import sys
import numpy as np
import slamkit.filters.ideal, slamkit.filters.observability_ukf, slamkit.filters.robocentric
from slamkit.evaluate import gauge
from slamkit.compiled import Compiled
from slamkit.filters import FILTERS
from slamkit.simulate import WORLDS, simulate

name, world = sys.argv[1], WORLDS["standing"]()
log = simulate(world, np.random.default_rng(0)).head(5)
options = {"truth": log.truth} if name == "ideal" else {}
make = lambda: FILTERS[name](world.motion, world.sensor, world.pose, world.pose_covariance, **options)
f = make()
f.run(log)
gauge.nullity(make(), log)
known = set(f._compiles())
modules = [m for n, m in sys.modules.items() if n.startswith("slamkit")]
functions = {v for m in modules for v in vars(m).values() if isinstance(v, Compiled)}
code = {(v, name) for v in functions for name in ("entry", "dispatcher") if name in vars(v)}
print(*sorted(f"{v.__name__}.{name}" for v, name in code - known))
"""


@pytest.mark.parametrize("name", ["iterated", "oc", "invariant", "robocentric", "oc-ukf"])
def test_a_filter_knows_what_it_compiles(name: str) -> None:
    """Run compiled and, for its nullity, as Python, it calls nothing that is not on its list."""
    done = subprocess.run([sys.executable, "-c", USED, name], capture_output=True, text=True, check=True)
    assert done.stdout.split() == []


def test_models_in_python_leave_nothing_to_compile_ahead() -> None:
    class Mine:
        """The same model without its compiled functions."""

        def __init__(self) -> None:
            of = RangeBearing(0.1, 0.02)
            self.R, self.predict, self.jacobians, self.residual = of.R, of.predict, of.jacobians, of.residual
            self.invert, self.inverse_jacobians = of.invert, of.inverse_jacobians

    assert FILTERS["ekf"](Unicycle(0.1, 0.1), Mine())._compiles() == []
    known = FILTERS["ekf"](Unicycle(0.1, 0.1), RangeBearing(0.1, 0.02))._compiles()
    assert all(isinstance(f, Compiled) and name in ("entry", "dispatcher") for f, name in known)


def test_prepare_knows_its_filters() -> None:
    with pytest.raises(InputError, match="no filter 'kalman'"):
        prepare(["ekf", "kalman"], [WORLDS["standing"]()], jobs=1)
    prepare(["ekf"], [WORLDS["standing"]()], jobs=1)
