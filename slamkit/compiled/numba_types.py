"""Tables as types of Numba. Importing this module imports Numba.

One address crosses into compiled code instead of fifty arrays. That matters three times: a call with two dozen arrays
costs microseconds, a function passed as an argument costs 30 µs at every call, and Numba's own structures count
references at every load of a field.
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
from numba.core.errors import TypingError
from numba.core.imputils import lower_builtin, lower_cast, lower_getattr_generic, lower_setattr_generic
from numba.core.registry import cpu_target
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, register_model, unbox
from numba.np.arrayobj import populate_array

from slamkit.compiled.tables import TABLES, OwnFields, Table

void, real, index, flag = types.void, types.float64, types.int64, types.boolean
vector, matrix, cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
integers, flags = types.int64[::1], types.boolean[::1]

WORD = ir.IntType(64)
BYTES = 8  # of a word


class TableType(types.Type):
    """Type of a table: the address of its row."""

    def __init__(self, name: str) -> None:
        super().__init__(name=f"slamkit.{name}")
        self.table_name = name

    @property
    def table(self) -> Table:
        """The declaration."""
        return TABLES[self.table_name]


class OwnType(types.Type):
    """Type of an estimator's own numbers: the address of the state's row."""

    def __init__(self, fields: OwnFields) -> None:
        super().__init__(name=f"slamkit.own({fields.sizes}, {fields.per_sighting})")
        self.fields = fields


class Passed(types.Array):
    """Type of an array as an argument of a function in a table: its address and its extents.

    Numba passes five words and two for each dimension, and few of them are read. A sighting passes twenty arrays.
    """

    def __init__(self, array: Any) -> None:
        super().__init__(array.dtype, array.ndim, "C", name=f"slamkit.Passed({array})")


@register_model(Passed)
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
    itemsize = ir.Constant(WORD, np.dtype(str(kind.dtype)).itemsize)
    strides = [itemsize]
    for extent in reversed(shape[1:]):
        strides.insert(0, builder.mul(strides[0], extent))
    populate_array(array, data=data, shape=shape, strides=strides, itemsize=itemsize, meminfo=None)
    return array._getvalue()


@intrinsic
def rows_of(typing: Any, array: Any, first: Any, count: Any) -> Any:
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


@register_model(Function)
@register_model(TableType)
@register_model(OwnType)
class AddressModel(data_models.PrimitiveModel):
    """An address."""

    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, WORD)


@lower_builtin(Function, Function, types.VarArg(types.Any))
def call_function(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
    """A call of the function at an address, as of any other that Numba has compiled."""
    returned, kinds, convention = signature.return_type, signature.args[1:], context.call_conv
    function = builder.inttoptr(arguments[0], convention.get_function_type(returned, kinds).as_pointer())
    status, result = convention.call_function(builder, function, returned, kinds, arguments[1:])
    with cgutils.if_unlikely(builder, status.is_error):
        convention.return_status_propagate(builder, status)
    return result


@infer_getattr
class TableAttribute(AttributeTemplate):
    """``table.field`` has the field's type."""

    key = TableType

    def generic_resolve(self, table: TableType, field: str) -> Any:
        kind = table.table.fields.get(field)
        return None if kind is None else type_of(kind)


@infer_getattr
class OwnAttribute(AttributeTemplate):
    """An estimator's own number is a real, or a vector, or the matrix with a row for each sighting."""

    key = OwnType

    def generic_resolve(self, own: OwnType, field: str) -> Any:
        fields = own.fields
        if field in fields.per_sighting:
            return matrix
        return None if field not in fields.sizes else real if fields.sizes[field] == 1 else vector


def _word_at(builder: Any, address: Any, word: int) -> Any:
    base = builder.inttoptr(address, WORD.as_pointer())
    return builder.gep(base, [ir.Constant(WORD, word)])


@lower_getattr_generic(TableType)
def load_field(context: Any, builder: Any, table: TableType, address: Any, field: str) -> Any:
    """The field as a value; an array borrows its memory, which Python keeps alive during a call."""
    declared = table.table
    kind, first = declared.fields[field], declared.first[field]
    if isinstance(kind, Table):
        return builder.add(address, ir.Constant(WORD, BYTES * first))
    kind = type_of(kind)
    words = 1 + kind.ndim if isinstance(kind, types.Array) else 1
    loaded = [builder.load(_word_at(builder, address, first + k)) for k in range(words)]
    if isinstance(kind, types.Array):
        data = builder.inttoptr(loaded[0], context.get_data_type(kind.dtype).as_pointer())
        return contiguous_array(builder, kind, data, loaded[1:])
    if kind is real:
        return builder.bitcast(loaded[0], ir.DoubleType())
    return builder.trunc(loaded[0], ir.IntType(1)) if kind is flag else loaded[0]


@lower_setattr_generic(TableType)
def store_field(context: Any, builder: Any, signature: Any, arguments: Any, field: str) -> Any:
    """A number of the table ← a value."""
    table, kind = signature.args[0].table, type_of(signature.args[0].table.fields[field])
    address, value = arguments
    value = context.cast(builder, value, signature.args[1], kind)
    if kind is real:
        value = builder.bitcast(value, WORD)
    elif kind is flag:
        value = builder.zext(value, WORD)
    builder.store(value, _word_at(builder, address, table.first[field]))


def _own(context: Any, builder: Any, address: Any) -> tuple[Any, Any]:
    """Where an estimator's own numbers begin, and how many there are."""
    first = TABLES["state"].first["own"]
    data, length = (builder.load(_word_at(builder, address, first + k)) for k in range(2))
    return builder.inttoptr(data, ir.DoubleType().as_pointer()), length


@lower_getattr_generic(OwnType)
def load_own(context: Any, builder: Any, own: OwnType, address: Any, field: str) -> Any:
    """An estimator's own number, vector or matrix."""
    fields = own.fields
    data, length = _own(context, builder, address)
    start = builder.gep(data, [ir.Constant(WORD, fields.first[field])])
    if field in fields.per_sighting:
        columns = ir.Constant(WORD, fields.per_sighting[field])
        rows = builder.sdiv(builder.sub(length, ir.Constant(WORD, fields.fixed)), columns)
        return contiguous_array(builder, matrix, start, [rows, columns])
    if fields.sizes[field] == 1:
        return builder.load(start)
    return contiguous_array(builder, vector, start, [ir.Constant(WORD, fields.sizes[field])])


@lower_setattr_generic(OwnType)
def store_own(context: Any, builder: Any, signature: Any, arguments: Any, field: str) -> Any:
    """One of an estimator's own numbers ← a value."""
    address, value = arguments
    data, _ = _own(context, builder, address)
    value = context.cast(builder, value, signature.args[1], real)
    builder.store(value, builder.gep(data, [ir.Constant(WORD, signature.args[0].fields.first[field])]))


def own_accessor(fields: OwnFields) -> Any:
    """A function of the state that gives an estimator's own numbers."""
    kind = OwnType(fields)

    @intrinsic
    def own(typing: Any, state: Any) -> Any:
        return kind(state), lambda context, builder, signature, arguments: arguments[0]

    return own


def _table_at(table: TableType) -> Any:
    @intrinsic
    def at(typing: Any, address: Any) -> Any:
        return table(types.int64), lambda context, builder, signature, arguments: arguments[0]

    return at


@unbox(TableType)
def unbox_table(table: TableType, shared: Any, c: Any) -> Any:
    """The address that an object of Python names; what asking for it raises is raised by the call."""
    address, value = c.pyapi.object_getattr_string(shared, "address"), cgutils.alloca_once(c.builder, WORD)
    with c.builder.if_then(cgutils.is_not_null(c.builder, address), likely=True):
        c.builder.store(c.pyapi.long_as_longlong(address), value)
        c.pyapi.decref(address)
    return NativeValue(c.builder.load(value), is_error=cgutils.is_not_null(c.builder, c.pyapi.err_occurred()))


@cache
def table_type(name: str) -> TableType:
    """The type of the table of that name."""
    return TableType(name)


_WORDS = {
    "void": void, "real": real, "index": index, "flag": flag, "vector": vector, "matrix": matrix, "cube": cube,
    "integers": integers, "flags": flags,
}  # fmt: skip


def signature_of(words: str, *, in_table: bool = False) -> Any:
    """A signature of Numba from one in words. Functions `in_table` take arrays as `Passed`."""
    returned, _, arguments = words.rstrip(") ").partition("(")
    kinds = [type_of(word.strip()) for word in arguments.split(",")]
    if in_table:
        kinds = [Passed(kind) if isinstance(kind, types.Array) else kind for kind in kinds]
    return type_of(returned.strip())(*kinds)


@cache
def type_of(kind: str | Table) -> Any:
    """The type of a word, of the signature of a function in a table, or of a table."""
    if isinstance(kind, Table):
        return table_type(kind.name)
    if "(" in kind:
        return Function(signature_of(kind, in_table=True))
    return _WORDS[kind] if kind in _WORDS else table_type(kind)


def address_of(function: Any, words: str) -> int:
    """Address of a compiled function for a table that wants this signature."""
    function = getattr(function, "in_table", function)
    signature = signature_of(words, in_table=True)
    try:
        result = function.get_compile_result(signature)
    except TypingError:  # compiled by its author, for Numba's own arrays only
        result = _with_arrays(function, len(signature.args)).get_compile_result(signature)
    return int(result.library.get_pointer_to_function(result.fndesc.llvm_func_name))


def _with_arrays(compiled: Any, arguments: int) -> Any:
    """A function that calls one that is compiled already."""
    names = ", ".join(f"a{k}" for k in range(arguments))
    return njit(eval(f"lambda {names}: compiled({names})", {"compiled": compiled}))


#: Address → table. An integer costs a call a tenth of what an object does, whose type Numba has to ask for.
as_state, as_models, as_policy = (_table_at(table_type(name)) for name in ("state", "models", "policy"))
