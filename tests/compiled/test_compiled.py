"""How functions become machine code: where it is made, how often, and that a study asks for all that it will need."""

import copy
import pickle
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

from slamkit import InputError
from slamkit.belief import Belief
from slamkit.compiled import Compiled, OwnFields, Shared, Table, compiled, needed
from slamkit.cycle.update import update
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


def test_what_is_called_is_compiled_once_and_for_python_too() -> None:
    assert scaled_total(np.arange(4.0), 2.0) == 12.0
    assert total(np.arange(4.0)) == 6.0
    assert total.jitted is total.jitted
    [signature] = total.jitted.signatures
    assert len(signature) == 1


def test_only_functions_that_are_called_by_name_are_used() -> None:
    """An attribute of the same name, such as ``policy.update`` in the function `update`, is none."""
    assert list(scaled_total.uses) == ["total"]
    assert "update_one" in update.uses and "update" not in update.uses


def test_a_table_holds_numbers_arrays_functions_and_tables() -> None:
    inner = Table("inner-of-a-test", count="index", row="vector")
    outer = Table("outer-of-a-test", ready="flag", size="real", inside=inner, call="real(vector)")
    values = {"ready": True, "size": 2.5, "inside": {"count": 3, "row": np.arange(3.0)}, "call": total}
    table = Shared(outer, **values)
    for shared in (table, pickle.loads(pickle.dumps(table)), copy.deepcopy(table)):
        assert (shared.ready, shared.size, shared.inside.count) == (True, 2.5, 3)
        assert shared.inside.row.tolist() == [0.0, 1.0, 2.0]
        shared.inside.count += 4
        assert shared.inside.count == 7 and shared.values["inside"]["count"] == 7
        assert shared.address % 64 == 0
    assert copy.deepcopy(table).inside.row is not table.inside.row
    with pytest.raises(AttributeError):
        _ = table.no_such_field


@compiled("void(state)")
def write_numbers(state: Any) -> None:
    state.resting.debt = 2.5
    state.belief.active = state.belief.active + 2
    state.scratch.careful = True
    mine = numbers(state)
    mine.alpha = mine.alpha + state.resting.debt
    mine.start[1] = 4.0
    mine.places[1, 0] = 7.0


numbers = OwnFields({"places": 2}, alpha=1, start=3)


@pytest.mark.parametrize("compiles", [True, False])
def test_compiled_code_and_python_share_named_numbers(compiles: bool) -> None:
    """Numbers of a table and an estimator's own fields are the same memory on both sides."""
    state = Belief(np.zeros(3), np.eye(3), own_fields=numbers).state
    numbers(state).alpha = 1.0
    (write_numbers if compiles else write_numbers.plain)(state)
    mine = numbers(state)
    assert (state.resting.debt, state.belief.active, state.scratch.careful) == (2.5, 5, True)
    assert mine.alpha == 3.5 and mine.start.tolist() == [0.0, 4.0, 0.0]
    assert mine.places.shape == (8, 2) and mine.places[1].tolist() == [7.0, 0.0]


def test_what_a_python_form_calls_is_needed() -> None:
    assert needed([twice]) == [twice, scaled_total]
    assert needed([scaled_total]) == [scaled_total]


USED = """
import sys
import numpy as np
import slamkit.filters.ideal, slamkit.filters.observability_constrained_ukf, slamkit.filters.robocentric
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
code = {(v, name) for v in functions for name in ("jitted", "in_table") if name in vars(v)}
print(*sorted(f"{v.__name__}.{name}" for v, name in code - known))
"""


@pytest.mark.parametrize("name", ["iterated", "oc", "invariant", "robocentric", "oc-ukf"])
def test_a_filter_knows_what_it_compiles(name: str) -> None:
    """Run compiled and, for its nullity, as Python, it calls nothing that is not on its list."""
    # The first fills the cache: what is compiled anew brings along all that it calls.
    for _ in range(2):
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
    assert all(isinstance(f, Compiled) and name in ("jitted", "in_table") for f, name in known)


def test_prepare_knows_its_filters() -> None:
    with pytest.raises(InputError, match="no filter 'kalman'"):
        prepare(["ekf", "kalman"], [WORLDS["standing"]()], jobs=1)
    prepare(["ekf"], [WORLDS["standing"]()], jobs=1)
