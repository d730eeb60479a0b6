"""Four numbers side by side, which the processor works on at once: vectors for kernels, as a type of numba's.

numba looks for such work in loops over arrays only, not in formulas for x, y and z. Here a formula is written once, for
vectors, which are added, subtracted and multiplied, with each other and with numbers. Each function says in Python what
it means; that is what runs where numba is told not to compile.
"""

from __future__ import annotations

import operator

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import lower_builtin, models, register_model, type_callable

SIZE = 4


def load(array, at):
    """Four numbers of a C-contiguous array (...) from the flat index `at` on; nobody checks that they are there."""
    return array.reshape(-1)[at : at + SIZE]


def lanes(x, y, z, w):
    """The vector of four numbers."""
    return np.array([x, y, z, w])


def components(vector):
    """The four numbers of a vector."""
    return tuple(vector)


def dot(one, other):
    """Scalar product of the first three components."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


class Lanes(types.Type):
    """A vector of four floats, in a register where the processor has such."""

    def __init__(self):
        super().__init__(name="lanes")


LANES = Lanes()
_VECTOR = ir.VectorType(ir.DoubleType(), SIZE)
_ANY = ir.Constant(_VECTOR, ir.Undefined)


def _index(lane):
    return ir.Constant(ir.IntType(32), lane)


@register_model(Lanes)
class _Model(models.PrimitiveModel):
    def __init__(self, manager, of):
        super().__init__(manager, of, _VECTOR)


@type_callable(load)
def _type_load(context):
    def typed(array, at):
        if isinstance(array, types.Array) and array.layout == "C" and array.dtype == types.float64:
            return LANES
        return None

    return typed


@lower_builtin(load, types.Array, types.Integer)
def _load(context, builder, signature, arguments):
    array, at = arguments
    data = context.make_array(signature.args[0])(context, builder, array).data
    place = builder.bitcast(builder.gep(data, [at]), _VECTOR.as_pointer())
    return builder.load(place, align=8)


@type_callable(lanes)
def _type_lanes(context):
    def typed(x, y, z, w):
        return LANES if {x, y, z, w} == {types.float64} else None

    return typed


@lower_builtin(lanes, types.float64, types.float64, types.float64, types.float64)
def _lanes(context, builder, signature, arguments):
    vector = _ANY
    for lane, number in enumerate(arguments):
        vector = builder.insert_element(vector, number, _index(lane))
    return vector


@type_callable(components)
def _type_components(context):
    def typed(vector):
        return types.UniTuple(types.float64, SIZE) if vector == LANES else None

    return typed


@lower_builtin(components, LANES)
def _components(context, builder, signature, arguments):
    numbers = [builder.extract_element(arguments[0], _index(lane)) for lane in range(SIZE)]
    return context.make_tuple(builder, signature.return_type, numbers)


@type_callable(dot)
def _type_dot(context):
    def typed(one, other):
        return types.float64 if one == other == LANES else None

    return typed


@lower_builtin(dot, LANES, LANES)
def _dot(context, builder, signature, arguments):
    products = builder.fmul(*arguments)
    x, y, z = (builder.extract_element(products, _index(lane)) for lane in range(3))
    return builder.fadd(builder.fadd(x, y), z)


def _register(operation, instruction, *cases):
    """Type and compile an operator for pairs of vectors and numbers."""

    @type_callable(operation)
    def _type(context):
        def typed(one, other):
            return LANES if (one, other) in cases else None

        return typed

    def compiled(context, builder, signature, arguments):
        vectors = []
        for of, value in zip(signature.args, arguments, strict=True):
            if of != LANES:
                first = builder.insert_element(_ANY, value, _index(0))
                value = builder.shuffle_vector(
                    first, _ANY, ir.Constant(ir.VectorType(ir.IntType(32), SIZE), [0] * SIZE)
                )
            vectors.append(value)
        return getattr(builder, instruction)(*vectors)

    for case in cases:
        lower_builtin(operation, *case)(compiled)


_register(operator.add, "fadd", (LANES, LANES))
_register(operator.sub, "fsub", (LANES, LANES))
_register(operator.mul, "fmul", (LANES, LANES), (LANES, types.float64), (types.float64, LANES))
