"""Evaluate recorded loads in double precision."""

from __future__ import annotations

import math

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.kernels.small_vectors import Mat, Vec
from bodycheck.reference_impl.loads.tape import (
    CONSTANT,
    COSINE,
    DIFFERENCE,
    OMEGA,
    OPERATION,
    OPERATIONS,
    POSITION,
    PRODUCT,
    QUOTIENT,
    RESULTS,
    ROOT,
    ROTATION,
    SCALED,
    SHIFTED,
    SINE,
    SUM,
    TIME,
    VELOCITY,
)


@kernel
def recorded_wrench(
    t: float, position: Vec, rotation: Mat, velocity: Vec, omega_world: Vec, loads: Array, first: int
) -> tuple[Vec, Vec]:
    """Force in N and torque about the centre of mass in N m, by the operations from loads[first]."""
    count = (len(loads) - first) // OPERATION
    values = np.empty(OPERATIONS + count)
    for i in range(3):
        values[POSITION + i] = position[i]
        values[VELOCITY + i] = velocity[i]
        values[OMEGA + i] = omega_world[i]
    for i in range(9):
        values[ROTATION + i] = rotation[i]
    for i in range(count):
        values[OPERATIONS + i] = _value(t, values, loads, first + OPERATION * i)
    last = OPERATIONS + count - RESULTS
    force = (values[last], values[last + 1], values[last + 2])
    return force, (values[last + 3], values[last + 4], values[last + 5])


@kernel
def _value(t: float, values: Array, loads: Array, row: int) -> float:
    """The result of one operation, whose constant is rounded to a double."""
    code, a, b, c = int(loads[row]), values[int(loads[row + 1])], values[int(loads[row + 2])], loads[row + 3]
    if code == TIME:
        value = t
    elif code == CONSTANT:
        value = c
    elif code == SUM:
        value = a + b
    elif code == DIFFERENCE:
        value = a - b
    elif code == PRODUCT:
        value = a * b
    elif code == QUOTIENT:
        value = a / b
    elif code == SCALED:
        value = a * c
    elif code == SHIFTED:
        value = a + c
    elif code == ROOT:
        value = math.sqrt(a)
    elif code == SINE:
        value = math.sin(a)
    elif code == COSINE:
        value = math.cos(a)
    else:  # never recorded
        value = math.nan
    return value
