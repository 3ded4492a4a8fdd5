"""The types of compiled code and the three tables that it shares with Python. Importing this module imports Numba.

A table crosses into compiled code as one address, whatever it holds: fields are loaded from the memory behind it.
That matters three times: a call with two dozen arrays would cost microseconds, a function passed as an argument costs
30 µs at every call, and Numba's own structures count references at every load of a field.
"""

# mypy: disable-error-code="attr-defined, misc, no-untyped-def, untyped-decorator, no-untyped-call"
# Numba has no type information, and these signatures are written in its own types.

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit
from numba.core import cgutils, types
from numba.core.datamodel import models as data_models
from numba.core.datamodel import register_default
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin, lower_cast, lower_getattr_generic
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, unbox
from numba.np.arrayobj import populate_array

void, real, index, flag = types.void, types.float64, types.int64, types.boolean
vector, matrix, cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
integers, flags = types.int64[::1], types.boolean[::1]

WORD = 8  # bytes


class TableType(types.Type):
    """Type of a table: the address of a row of words, a field after the other."""

    def __init__(self, kind: str) -> None:
        super().__init__(name=f"slamkit.{kind}")

    @property
    def fields(self) -> dict[str, Any]:
        """Type of each field, in the order of the words."""
        return FIELDS[self.name]

    def first_word(self, field: str) -> int:
        """Where a field begins."""
        return _first_words(self.name)[field]


@cache
def _first_words(table: str) -> dict[str, int]:
    sizes = [words(field) for field in FIELDS[table].values()]
    return dict(zip(FIELDS[table], np.cumsum([0, *sizes]).tolist(), strict=False))


def words(field: Any) -> int:
    """How many words a field takes: an array its address and its shape, all else one."""
    return 1 + field.ndim if isinstance(field, types.Array) else 1


class Passed(types.Array):
    """Type of an array as an argument of a function in a table: its address and its extents.

    Numba passes five words and two for each dimension, most of which nobody reads.
    """

    def __init__(self, array: Any) -> None:
        super().__init__(array.dtype, array.ndim, "C", name=f"slamkit.Passed({array})")


@register_default(Passed)
class PassedModel(data_models.ArrayModel):
    """Within a function it is an array like any other, which borrows its memory."""

    def get_argument_type(self) -> Any:
        """An address and as many numbers as there are dimensions."""
        return tuple(self._models[self.get_field_position(name)].get_argument_type() for name in ("data", "shape"))

    def as_argument(self, builder: Any, value: Any) -> Any:
        """What is passed of an array."""
        return self.get(builder, value, "data"), tuple(cgutils.unpack_tuple(builder, self.get(builder, value, "shape")))

    def from_argument(self, builder: Any, value: Any) -> Any:
        """The array again."""
        data, shape = value
        return contiguous_array(builder, self._fe_type, data, shape)


@lower_cast(types.Array, Passed)
@lower_cast(Passed, types.Array)
def cast_array(context: Any, builder: Any, before: Any, after: Any, value: Any) -> Any:
    """They differ only while they are passed."""
    return value


def contiguous_array(builder: Any, kind: Any, data: Any, shape: Any) -> Any:
    """A C-contiguous array that borrows its memory."""
    array = cgutils.create_struct_proxy(kind)(cpu_target.target_context, builder)
    itemsize = ir.Constant(ir.IntType(64), np.dtype(str(kind.dtype)).itemsize)
    strides = [itemsize]
    for extent in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], extent))
    populate_array(array, data=data, shape=shape, strides=strides, itemsize=itemsize, meminfo=None)
    return array._getvalue()


@intrinsic
def part(typing: Any, array: Any, first: Any, count: Any) -> Any:
    """Rows first … first + count - 1 of a C-contiguous array, which must be there."""
    kind = array.copy()

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        whole = context.make_array(array)(context, builder, arguments[0])
        shape, start = cgutils.unpack_tuple(builder, whole.shape), arguments[1]
        for extent in shape[1:]:
            start = builder.mul(start, extent)
        return contiguous_array(builder, kind, builder.gep(whole.data, [start]), [arguments[2], *shape[1:]])

    return kind(array, types.int64, types.int64), generate


class Function(types.Callable, types.Opaque):
    """Type of a compiled function that is known by its address only.

    Numba's own type of functions can also be one of Python, which makes every call of it a dozen times as much code.
    """

    def __init__(self, signature: Any) -> None:
        self.signature = signature
        super().__init__(name=f"slamkit.Function({signature})")

    def get_call_type(self, context: Any, arguments: Any, keywords: Any) -> Any:
        """The signature, to which a call casts its arguments."""
        return self.signature.replace(recvr=self) if len(arguments) == len(self.signature.args) else None

    def get_call_signatures(self) -> tuple[list[Any], bool]:
        """All signatures, and whether they are templates."""
        return [self.signature], False

    def get_impl_key(self, signature: Any) -> Any:
        """Where Numba finds `call_function`."""
        return Function


@register_default(Function)
class FunctionModel(data_models.PrimitiveModel):
    """A function is an address."""

    def __init__(self, manager: Any, function: Function) -> None:
        super().__init__(manager, function, ir.IntType(64))


@lower_builtin(Function, Function, types.VarArg(types.Any))
def call_function(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """A call of the function at an address, as of any other that Numba has compiled."""
    returned, kinds, convention = signature.return_type, signature.args[1:], context.call_conv
    function = builder.inttoptr(arguments[0], convention.get_function_type(returned, kinds).as_pointer())
    status, result = convention.call_function(builder, function, returned, kinds, arguments[1:])
    with cgutils.if_unlikely(builder, status.is_error):
        convention.return_status_propagate(builder, status)
    return result


@register_default(TableType)
class TableModel(data_models.PrimitiveModel):
    """A table is an address."""

    def __init__(self, manager: Any, table: TableType) -> None:
        super().__init__(manager, table, ir.IntType(64))


@infer_getattr
class TableAttribute(AttributeTemplate):
    """``table.field`` has the field's type."""

    key = TableType

    def generic_resolve(self, table: TableType, field: str) -> Any:
        return table.fields.get(field)


@lower_getattr_generic(TableType)
def load_field(context: Any, builder: Any, table: TableType, address: Any, field: str) -> Any:
    """The field as a value; an array borrows its memory, which Python keeps alive during a call."""
    kind, first = table.fields[field], table.first_word(field)
    base = builder.inttoptr(address, ir.IntType(64).as_pointer())
    loaded = [builder.load(builder.gep(base, [ir.Constant(ir.IntType(64), first + k)])) for k in range(words(kind))]
    if isinstance(kind, types.Array):
        data = builder.inttoptr(loaded[0], context.get_data_type(kind.dtype).as_pointer())
        return contiguous_array(builder, kind, data, loaded[1:])
    if kind is real:
        return builder.bitcast(loaded[0], ir.DoubleType())
    return builder.trunc(loaded[0], ir.IntType(1)) if kind is flag else loaded[0]


def _table_at(table: TableType) -> Any:
    @intrinsic
    def at(typing: Any, address: Any) -> Any:
        return table(types.int64), lambda context, builder, signature, arguments: arguments[0]

    return at


@unbox(TableType)
def unbox_table(table: TableType, shared: Any, c: Any) -> Any:
    """The address that an object of Python names."""
    address = c.pyapi.object_getattr_string(shared, "address")
    value = c.pyapi.long_as_longlong(address)
    c.pyapi.decref(address)
    return NativeValue(value, is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


class Handle:
    """A table in memory.

    Parameters
    ----------
    kind : {"state", "models", "policy"}
    **fields
        Its fields; arrays must be C-contiguous and stay alive as long as the handle is used.
    """

    def __init__(self, kind: str, **fields: Any) -> None:
        table = self.table = WORDS[kind]
        self.fields: dict[str, Any] = {}
        self.row = np.zeros(sum(words(field) for field in table.fields.values()), dtype=np.int64)
        self.address = self.row.ctypes.data
        self.put(**{name: fields[name] for name in table.fields})

    def put(self, **fields: Any) -> None:
        """Let fields be these from now on."""
        table = self.table
        self.fields.update(fields)
        for name, value in fields.items():
            row = _words_of(name, table.fields[name], value)
            first = table.first_word(name)
            self.row[first : first + len(row)] = row


def _words_of(name: str, field: Any, value: Any) -> list[int]:
    if isinstance(field, types.Array):
        assert value.flags.c_contiguous and value.ndim == field.ndim and value.dtype == str(field.dtype), name
        return [value.ctypes.data, *value.shape]
    if isinstance(field, Function):
        try:
            result = value.get_compile_result(field.signature)
        except TypingError:  # compiled by its author, for Numba's own arrays only
            result = _with_arrays(value, len(field.signature.args)).get_compile_result(field.signature)
        return [result.library.get_pointer_to_function(result.fndesc.llvm_func_name)]
    if field is real:
        return [int(np.array(value, dtype=np.float64).view(np.int64))]
    return [int(value)]


def _with_arrays(compiled: Any, arguments: int) -> Any:
    """A function that calls one that is compiled already."""
    names = ", ".join(f"a{k}" for k in range(arguments))
    return njit(eval(f"lambda {names}: compiled({names})", {"compiled": compiled}))


def function(*arguments: Any, result: Any = void) -> Any:
    """Type of a function; one without a result writes into its last arguments."""
    return Function(result(*map(passed, arguments)))


def passed(kind: Any) -> Any:
    """A type as that of an argument."""
    return Passed(kind) if isinstance(kind, types.Array) else kind


state, models, policy = TableType("state"), TableType("models"), TableType("policy")
STATE_FIELDS = {
    "mean": vector,  # (capacity,) pose, then two numbers a landmark; of what is active
    "cov": matrix,  # (capacity, capacity) lower triangle, likewise
    "points": vector,  # (capacity,) where the lever arms of the Jacobians are taken, if not at the mean
    "memory": vector,  # (6,) a variant's own few numbers
    "size": integers,  # (11,) see ACTIVE and what follows it in `slamkit.compiled`
    "work": vector,  # (8,) what decides when to flush, see `slamkit.cycle.steps.upkeep`
    "Phi": matrix,  # (capacity, columns) Φ, see `slamkit.belief.kernels`
    "minus_Psi": matrix,  # (columns, columns) lower triangle of -Ψ
    "theta": vector,  # (columns,) ϑ
    "g": matrix,  # (rows, columns) L⁻¹ H Φ
    "few": matrix,  # (rows, columns) g of the updates since the last flush, while there is room
    "count": integers,  # (1,) how many rows, or -1: there are more
    "columns": integers,  # (columns,) A₀ as coordinates of the whole map
    "owner": integers,  # (capacity,) active coordinate → coordinate of the whole map
    "local": integers,  # (room,) coordinate of the whole map → active coordinate, or -1 where it rests
    "rest": vector,  # (whole,) mean as of the last flush
    "rest_points": vector,  # (whole,) likewise
    "store": vector,  # covariance as of the last flush: one triangle in panels, or both, row after row
    "V": matrix,  # (whole, r) what a flush under way has yet to subtract is V Vᵀ; r = 0 where none is
    "pose": vector,  # (3,) the pose that the step arrives at
    "F": matrix,  # (3, 3)
    "Q": matrix,  # (3, 3)
    "before": vector,  # (24,) memory, F and Q before a prediction that may yet be refused
    "G": matrix,  # (3, m)
    "sigma_u": matrix,  # (m, m)
    "at": vector,  # (3 + 2n,) the point at which a scan is linearised
    "slots": integers,  # (n,) slots of the sightings that an update uses
    "order": integers,  # (n,) their places in the scan
    "innovations": matrix,  # (n, k) what the scan's sightings said, in the scan's order
    "nis": vector,  # (n,)
    "truth": matrix,  # (n, 2) true positions of the scan's landmarks, where a filter is told them
    "accepted": flags,  # (n,)
    "saved": vector,  # mean, points, memory and covariance before a small step
    "z": vector,  # (rows,) their measurements, one after the other
    "z_hat": vector,  # (k,) one predicted measurement
    "y": vector,  # (rows,) innovation
    "effective": vector,  # (rows,) innovation as the linear update wants it
    "H_pose": matrix,  # (rows, 3)
    "H_landmark": matrix,  # (rows, 2)
    "noise": matrix,  # (rows, k) the k × k noise of each sighting, one below the other
    "S": matrix,  # (rows, rows)
    "L": matrix,  # (rows, rows) lower Cholesky factor of S
    "w": matrix,  # (rows, capacity) L⁻¹ H P
    "t": vector,  # (rows,) L⁻¹ y
    "dx": vector,  # (capacity,) correction in the filter's error coordinates
    "gathered": matrix,  # (5, capacity) rows of the covariance under the sighting at hand
    "G_pose": matrix,  # (2, 3)
    "G_z": matrix,  # (2, k)
    "block": matrix,  # (2, 2) noise of a new landmark
}
MODELS_FIELDS = {
    "move": function(vector, vector, real, vector, vector),
    "motion_jacobians": function(vector, vector, real, vector, matrix, matrix),
    "control_noise": function(vector, real, vector, matrix),
    "pose_noise": function(vector, vector, real, vector, matrix),
    "drive": function(vector, vector, real, vector, vector, matrix, matrix, matrix, matrix),
    "drives": flag,  # whether `drive` is the model's own, else it means nothing
    "predict": function(vector, vector, vector, vector),
    "sensor_jacobians": function(vector, vector, vector, matrix, matrix),
    "residual": function(vector, vector, vector, vector),
    "invert": function(vector, vector, vector, vector),
    "inverse_jacobians": function(vector, vector, vector, matrix, matrix),
    "sight": function(vector, vector, vector, vector, vector, vector, matrix, matrix),
    "sights": flag,  # likewise of `sight`
    "motion_params": vector,
    "sensor_params": vector,
    "R": matrix,
}
POLICY_FIELDS = {
    "motion": function(models, state, vector, real),
    "sensor": function(models, state, vector, vector, index, vector, index),
    "start": function(models, state, index, index, vector),
    "scan": function(models, state, integers, flag),
    "correct": function(policy, models, state, index, result=index),
    "retract": function(state),
    "report": function(state, vector, matrix),
    "step": function(policy, models, state, vector, real, integers, matrix, result=index),
    "gate": real,
    "iterations": index,
    "batch": flag,
}
FIELDS = {state.name: STATE_FIELDS, models.name: MODELS_FIELDS, policy.name: POLICY_FIELDS}
#: Address → table. An integer costs a call a tenth of what an object does, whose type Numba has to ask for.
as_state, as_models, as_policy = _table_at(state), _table_at(models), _table_at(policy)
WORDS = {
    "void": void, "real": real, "index": index, "flag": flag, "vector": vector, "matrix": matrix, "cube": cube,
    "integers": integers, "flags": flags, "state": state, "models": models, "policy": policy,
}  # fmt: skip
#: The same for a function in a table.
PASSED = {word: passed(kind) for word, kind in WORDS.items()}
