"""A number type for compiled code that holds one number of each of eight lanes, so that one instruction moves eight
runs.

Arithmetic on it is elementwise and in the order written, like that on single numbers: a function of
`rx90b_flex.compiled` gives the same bits for a lane, compiled for numbers or for vectors. What has branches (sine, laws)
goes lane by lane.
"""

# numba's interface for extensions carries no types
# mypy: disable-error-code="no-untyped-call, attr-defined, misc"

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import box, intrinsic, lower_builtin, lower_cast, overload, register_model
from numba.np.arrayobj import make_array, populate_array

from rx90b_flex.compiled.compile import Array, counted

WIDTH = 8  # doubles in the widest registers there are; the compiler splits it where they are narrower

_INDEX = ir.IntType(32)
_LANES = ir.VectorType(ir.DoubleType(), WIDTH)


class Vector(types.Type):
    """The type of eight numbers; a single number is taken for eight equal ones."""

    def __init__(self) -> None:
        super().__init__(name=f"Vector{WIDTH}")

    def can_convert_from(self, typing_context: Any, other: Any) -> Any:
        return Conversion.safe if isinstance(other, types.Float) else None

    def unify(self, typing_context: Any, other: Any) -> Any:
        return self if isinstance(other, types.Float) else None


VECTOR = Vector()


@register_model(Vector)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, type_: Any) -> None:
        super().__init__(manager, type_, _LANES)


@lower_cast(types.Float, Vector)
def _all_equal(context: Any, builder: Any, from_type: Any, to_type: Any, value: Any) -> Any:
    number = context.cast(builder, value, from_type, types.float64)
    nothing = ir.Constant(_LANES, ir.Undefined)
    first = builder.insert_element(nothing, number, ir.Constant(_INDEX, 0))
    return builder.shuffle_vector(first, nothing, ir.Constant(ir.VectorType(_INDEX, WIDTH), [0] * WIDTH))


@box(Vector)
def _to_python(type_: Any, value: Any, context: Any) -> Any:
    return context.pyapi.make_none()  # functions that return vectors are for compiled code


def _define(function: Any, instruction: str, arguments: int) -> None:
    class Template(AbstractTemplate):
        def generic(self, args: Any, kws: Any) -> Any:
            fits = len(args) == arguments and all(isinstance(a, Vector | types.Float) for a in args)
            return signature(VECTOR, *args_of(args)) if fits and any(isinstance(a, Vector) for a in args) else None

    def args_of(args: Any) -> list[Any]:
        return [VECTOR] * len(args)

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return getattr(builder, instruction)(*args)

    infer_global(function)(Template)
    lower_builtin(function, *[Vector] * arguments)(lower)


for _name, _instruction in (("add", "fadd"), ("sub", "fsub"), ("mul", "fmul"), ("truediv", "fdiv")):
    _define(getattr(operator, _name), _instruction, 2)
    _define(getattr(operator, f"i{_name}"), _instruction, 2)
_define(operator.neg, "fneg", 1)


@intrinsic
def _lane_of(typing_context: Any, x: Any, lane: Any) -> Any:
    """One lane's number."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.extract_element(args[0], builder.trunc(args[1], _INDEX))

    return types.float64(VECTOR, types.int64), generate


@intrinsic
def _with_lane(typing_context: Any, x: Any, lane: Any, number: Any) -> Any:
    """The vector with another number in one lane."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.insert_element(args[0], args[2], builder.trunc(args[1], _INDEX))

    return VECTOR(VECTOR, types.int64, types.float64), generate


@intrinsic
def _as_vectors(typing_context: Any, numbers: Any) -> Any:
    """A flat array of numbers seen as one of vectors: the first eight are the first vector's lanes."""
    result = types.Array(VECTOR, 1, "C", aligned=False)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source = make_array(signature.args[0])(context, builder, args[0])
        array = make_array(signature.return_type)(context, builder)
        word = ir.IntType(64)
        count = builder.sdiv(builder.extract_value(source.shape, 0), ir.Constant(word, WIDTH))
        size = ir.Constant(word, 8 * WIDTH)
        populate_array(
            array,
            data=builder.bitcast(source.data, context.get_data_type(VECTOR).as_pointer()),
            shape=cgutils.pack_array(builder, [count]),
            strides=cgutils.pack_array(builder, [size]),
            itemsize=size,
            meminfo=source.meminfo,
            parent=source.parent,
        )
        context.nrt.incref(builder, signature.return_type, array._getvalue())
        return array._getvalue()

    return result(numbers), generate


@intrinsic
def _part(typing_context: Any, memory: Any, start: Any, shape: Any) -> Any:
    """An array of a shape in a flat one, from `start` on: a slice of it, reshaped, which takes the compiler far longer."""
    axes = len(shape)
    result = types.Array(memory.dtype, axes, "C", aligned=memory.aligned)

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source = make_array(signature.args[0])(context, builder, args[0])
        array = make_array(signature.return_type)(context, builder)
        sizes = cgutils.unpack_tuple(builder, args[2], axes)
        strides = [source.itemsize]
        for size in sizes[:0:-1]:
            strides.insert(0, builder.mul(strides[0], size))
        populate_array(
            array,
            data=builder.gep(source.data, [args[1]]),
            shape=cgutils.pack_array(builder, sizes),
            strides=cgutils.pack_array(builder, strides),
            itemsize=source.itemsize,
            meminfo=source.meminfo,
            parent=source.parent,
        )
        context.nrt.incref(builder, signature.return_type, array._getvalue())
        return array._getvalue()

    return result(memory, types.intp, types.UniTuple(types.intp, axes)), generate


part_of: Any = _part
lane_of: Any = _lane_of
with_lane: Any = _with_lane
as_vectors: Any = _as_vectors


def _of_vectors(array: Any) -> bool:
    return isinstance(array, types.Array) and isinstance(array.dtype, Vector)


def width_of(like: Any) -> Any:
    """How many lanes lie side by side in an array of vectors or of numbers."""
    raise NotImplementedError("in compiled code only")


@overload(width_of)
def _width_of(like):  # type: ignore[no-untyped-def]
    width = WIDTH if _of_vectors(like) else 1
    return lambda like: width


def seen_as(numbers: Any, like: Any) -> Any:
    """A flat array of numbers seen as one of vectors where `like` is one, as it is where that is one of numbers."""
    raise NotImplementedError("in compiled code only")


@overload(seen_as)
def _seen_as(numbers, like):  # type: ignore[no-untyped-def]
    if _of_vectors(like):
        return lambda numbers, like: as_vectors(numbers)
    return lambda numbers, like: numbers


def spread(x: Any, out: Any) -> None:
    """Each lane's number of x into `out` (lanes,)."""
    raise NotImplementedError("in compiled code only")


@overload(spread)
def _spread(x, out):  # type: ignore[no-untyped-def]
    if isinstance(x, Vector):

        def lanes(x, out):  # type: ignore[no-untyped-def]
            for lane in range(WIDTH):
                out[lane] = lane_of(x, lane)

        return lanes

    def number(x, out):  # type: ignore[no-untyped-def]
        for lane in range(len(out)):
            out[lane] = x

    return number


def larger_size(a: Any, b: Any) -> Any:
    """The larger of a and the size of b, for a of 0 or more."""
    raise NotImplementedError("in compiled code only")


@overload(larger_size)
def _larger_size(a, b):  # type: ignore[no-untyped-def]
    if isinstance(b, Vector):

        def lanes(a, b):  # type: ignore[no-untyped-def]
            out = 0.0 * b + a
            for lane in range(WIDTH):
                x = lane_of(b, lane)
                x = -x if x < 0.0 else x
                if x > lane_of(out, lane):
                    out = with_lane(out, lane, x)
            return out

        return lanes

    def numbers(a, b):  # type: ignore[no-untyped-def]
        b = -b if b < 0.0 else b
        return b if b > a else a

    return numbers


@counted
def aligned(count: int) -> Array:
    """Zeros for that many vectors, each in one line of the processor's cache."""
    room = np.zeros(WIDTH * (count + 1))
    start = (-room.ctypes.data % (8 * WIDTH)) // 8
    return room[start : start + WIDTH * count]


def working_memory(count: int, alone: bool | None) -> Array:
    """Zeros: so many vectors; so many numbers where a lane is `alone`, which is not None."""
    raise NotImplementedError("in compiled code only")


@overload(working_memory)
def _working_memory(count, alone):  # type: ignore[no-untyped-def]
    if isinstance(alone, types.NoneType):
        return lambda count, alone: as_vectors(aligned(count))
    return lambda count, alone: np.zeros(count)
