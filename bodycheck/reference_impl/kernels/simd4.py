"""SIMD operations on four doubles, for kernels that process quaternions and vectors.

In compiled code, Lanes are a machine vector, independent of the auto-vectoriser. In plain Python they are a
tuple of four floats. Arrays of Lanes have the shape (rows, terms, 4).
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import Parameter
from inspect import signature as signature_of
from typing import Any, TypeAlias

from bodycheck._util.pinned_libraries import numba
from bodycheck.reference_impl.arrays import Array

types: Any = numba().types
ir: Any = numba().core.cgutils.ir  # llvmlite, a dependency of numba
models: Any = numba().extending.models
intrinsic, register_model = numba().extending.intrinsic, numba().extending.register_model

Lanes: TypeAlias = tuple[float, float, float, float]

_VECTOR = ir.VectorType(ir.DoubleType(), 4)
_MASK = ir.VectorType(ir.IntType(32), 4)
_UNALIGNED = 8  # bytes: numpy guarantees no larger alignment


class _LanesType(types.Type):  # type: ignore[misc]
    def __init__(self) -> None:
        super().__init__(name="Lanes")


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, numba_type: Any) -> None:
        super().__init__(manager, numba_type, _VECTOR)


_LANES = _LanesType()
_Emitter: TypeAlias = Callable[..., Any]


def _compiled_to(emit: _Emitter, result: Any = _LANES) -> Callable[[_Emitter], Any]:
    """Compile calls of the decorated function to the code that emit(builder, *values) builds."""

    def decorate(python: _Emitter) -> Any:
        if numba().config.DISABLE_JIT:
            return python

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            given = zip(signature.args, values, strict=True)
            return emit(builder, *(_as_emitted(context, builder, kind, value) for kind, value in given))

        @wraps(python)
        def typed(_context: Any, *arguments: Any) -> Any:
            return result(*arguments), generate

        # numba matches arguments by the parameter names of the signature
        context, named = Parameter("context", Parameter.POSITIONAL_OR_KEYWORD), signature_of(python)
        vars(typed)["__signature__"] = named.replace(parameters=[context, *named.parameters.values()])
        return intrinsic(typed)

    return decorate


def _as_emitted(context: Any, builder: Any, kind: types.Type, value: Any) -> Any:
    """Return the fields of an array, an integer cast to intp, any other value unchanged."""
    if isinstance(kind, types.Array):
        return context.make_array(kind)(context, builder, value)
    if isinstance(kind, types.Integer):
        return context.cast(builder, value, kind, types.intp)
    return value


# ---------------------------------------------------------------------------------------- load and store


def _address(builder: Any, array: Any, i: Any, k: Any) -> Any:
    """Return the address of array[i, k, 0]."""
    terms = builder.extract_value(array.shape, 1)
    lane = builder.mul(builder.add(builder.mul(i, terms), k), ir.Constant(i.type, 4))
    return builder.gep(array.data, [lane], inbounds=True)


def _emit_load(builder: Any, array: Any, i: Any, k: Any) -> Any:
    pointer = builder.bitcast(_address(builder, array, i, k), _VECTOR.as_pointer())
    return builder.load(pointer, align=_UNALIGNED)


@_compiled_to(_emit_load)
def load(array: Array, i: int, k: int) -> Lanes:
    """array[i, k], of a contiguous array (rows, terms, 4)."""
    a, b, c, d = array[i, k].tolist()
    return a, b, c, d


def _emit_lane_of(builder: Any, array: Any, i: Any, k: Any, lane: Any) -> Any:
    return builder.load(builder.gep(_address(builder, array, i, k), [lane], inbounds=True))


@_compiled_to(_emit_lane_of, types.float64)
def lane_of(array: Array, i: int, k: int, lane: int) -> float:
    """array[i, k, lane]."""
    return float(array[i, k, lane])


def _emit_store(builder: Any, array: Any, i: Any, k: Any, x: Any) -> Any:
    pointer = builder.bitcast(_address(builder, array, i, k), _VECTOR.as_pointer())
    builder.store(x, pointer, align=_UNALIGNED)
    return ir.Constant(ir.IntType(8).as_pointer(), None)


@_compiled_to(_emit_store, types.none)
def store(array: Array, i: int, k: int, x: Lanes) -> None:
    """array[i, k] = x."""
    array[i, k] = x


def _emit_lanes(builder: Any, *values: Any) -> Any:
    vector = ir.Constant(_VECTOR, ir.Undefined)
    for i, value in enumerate(values):
        vector = builder.insert_element(vector, value, ir.Constant(ir.IntType(32), i))
    return vector


@_compiled_to(_emit_lanes)
def lanes(a: float, b: float, c: float, d: float) -> Lanes:
    """(a, b, c, d)."""
    return a, b, c, d


@_compiled_to(lambda builder: ir.Constant(_VECTOR, [0.0] * 4))  # noqa: ARG005 - a constant
def nothing() -> Lanes:
    """(0, 0, 0, 0)."""
    return 0.0, 0.0, 0.0, 0.0


def _emit_unpacked(builder: Any, x: Any) -> Any:
    array = ir.Constant(ir.ArrayType(ir.DoubleType(), 4), ir.Undefined)
    for i in range(4):
        lane = builder.extract_element(x, ir.Constant(ir.IntType(32), i))
        array = builder.insert_value(array, lane, i)
    return array


@_compiled_to(_emit_unpacked, types.UniTuple(types.float64, 4))
def unpacked(x: Lanes) -> Lanes:
    """(x_0, x_1, x_2, x_3), as floats."""
    return x


# ----------------------------------------------------------------------------------------------- arithmetic


def _spread(builder: Any, s: Any) -> Any:
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), s, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_MASK, [0] * 4))


def _fused(builder: Any, total: Any, x: Any, y: Any) -> Any:
    return builder.fadd(total, builder.fmul(x, y, flags=("contract",)), flags=("contract",))


@_compiled_to(lambda builder, x, y: builder.fadd(x, y))
def plus(x: Lanes, y: Lanes) -> Lanes:
    """x + y."""
    return x[0] + y[0], x[1] + y[1], x[2] + y[2], x[3] + y[3]


@_compiled_to(lambda builder, x, y: builder.fsub(x, y))
def minus(x: Lanes, y: Lanes) -> Lanes:
    """x - y."""
    return x[0] - y[0], x[1] - y[1], x[2] - y[2], x[3] - y[3]


@_compiled_to(lambda builder, x, y: builder.fmul(x, y))
def times(x: Lanes, y: Lanes) -> Lanes:
    """x y, lane by lane."""
    return x[0] * y[0], x[1] * y[1], x[2] * y[2], x[3] * y[3]


@_compiled_to(lambda builder, x, s: builder.fmul(x, _spread(builder, s)))
def scaled(x: Lanes, s: float) -> Lanes:
    """s x."""
    return x[0] * s, x[1] * s, x[2] * s, x[3] * s


@_compiled_to(_fused)
def add_product(total: Lanes, x: Lanes, y: Lanes) -> Lanes:
    """Return total + x y, lane by lane, fused."""
    return plus(total, times(x, y))


@_compiled_to(lambda builder, total, x, s: _fused(builder, total, x, _spread(builder, s)))
def add_scaled(total: Lanes, x: Lanes, s: float) -> Lanes:
    """Return total + s x, fused."""
    return plus(total, scaled(x, s))


def _emit_shuffle(*order: int) -> _Emitter:
    return lambda builder, x: builder.shuffle_vector(
        x, ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_MASK, list(order))
    )


@_compiled_to(_emit_shuffle(1, 2, 0, 3))
def rotated(x: Lanes) -> Lanes:
    """(x_1, x_2, x_0, x_3): the first three lanes rotated by one."""
    return x[1], x[2], x[0], x[3]


@_compiled_to(_emit_shuffle(1, 0, 3, 2))
def neighbours_swapped(x: Lanes) -> Lanes:
    """(x_1, x_0, x_3, x_2)."""
    return x[1], x[0], x[3], x[2]


@_compiled_to(_emit_shuffle(2, 3, 0, 1))
def halves_swapped(x: Lanes) -> Lanes:
    """(x_2, x_3, x_0, x_1)."""
    return x[2], x[3], x[0], x[1]


@_compiled_to(_emit_shuffle(3, 2, 1, 0))
def backwards(x: Lanes) -> Lanes:
    """(x_3, x_2, x_1, x_0)."""
    return x[3], x[2], x[1], x[0]
