"""Vectors and rotations in the series of a tree.

series[ROWS * i + r, k] is the k-th Taylor coefficient of the quantity r of body i, in turned axes: e_z along
the joint's axis. Zero axes are those that the child's coincide with at coordinate 0.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    Three,
    add_product,
    by_double,
    minus,
    nothing,
    plus,
    put,
    renorm,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.taylor.taylor_terms import added, cauchy, put_vector, vector_terms
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.prepared_tree import RATE, ROTATION, TRANSLATION

Structure: TypeAlias = NDArray[np.int64]

PLACE, TURNED, E, SPEED, SPIN = 0, 3, 7, 16, 19
"""Rows of a joint: translation; angle, cosine and sine, or quaternion; E, child to zero axes; rates."""
OMEGA, SQUARES, CARRIED = 22, 25, 31
"""Rows: omega; its products xx, yy, zz, xy, xz, yz; Q^T omega of the parent."""
ARM, Y, A, F, N, MOMENT, F_ZERO, WORLD_IN_ZERO, WORLD_AXES, ROWS = 34, 37, 40, 43, 46, 49, 52, 55, 64, 73
"""Rows: A e of a slide, y, R^T (x'' - g) of the centre; force and torque about the centre; moment at the
joint; force in zero axes; the axes of the world in zero axes and in turned body axes (3 each)."""

AXIS, BALL, SLIDE, SPACE = (
    int(Rotation.AXIS),
    int(Rotation.BALL),
    int(Translation.AXIS),
    int(Translation.SPACE),
)


@kernel
def cross(a: Three, b: Three) -> Three:
    """a x b."""
    return (
        renorm(subtract_product(times(a[1], b[2]), a[2], b[1])),
        renorm(subtract_product(times(a[2], b[0]), a[0], b[2])),
        renorm(subtract_product(times(a[0], b[1]), a[1], b[0])),
    )


@kernel
def scaled(x: Any, a: Three) -> Three:
    """x a."""
    return times(x, a[0]), times(x, a[1]), times(x, a[2])


@kernel
def dot_entries(numbers: Numbers, i: int, j: int, step: int, v: Three) -> Any:
    """m . v, m the numbers [i, j], [i, j + step], [i, j + 2 step]."""
    total = times(term(numbers, i, j), v[0])
    total = add_product(total, term(numbers, i, j + step), v[1])
    return renorm(add_product(total, term(numbers, i, j + 2 * step), v[2]))


@kernel
def through(numbers: Numbers, i: int, j: int, v: Three) -> Three:
    """M v, M the nine numbers from [i, j]."""
    return (
        dot_entries(numbers, i, j, 1, v),
        dot_entries(numbers, i, j + 3, 1, v),
        dot_entries(numbers, i, j + 6, 1, v),
    )


@kernel
def back(numbers: Numbers, i: int, j: int, v: Three) -> Three:
    """M^T v, M the nine numbers from [i, j]."""
    return (
        dot_entries(numbers, i, j, 3, v),
        dot_entries(numbers, i, j + 1, 3, v),
        dot_entries(numbers, i, j + 2, 3, v),
    )


@kernel
def constant(numbers: Numbers, i: int, j: int) -> Three:
    """Return the numbers [i, j], [i, j + 1], [i, j + 2]."""
    return term(numbers, i, j), term(numbers, i, j + 1), term(numbers, i, j + 2)


@kernel
def add_vector(series: Numbers, row: int, k: int, v: Three) -> None:
    """Add to the k-th coefficients of three rows."""
    put_vector(series, row, k, added(vector_terms(series, row, k), v))


@kernel
def turned_by(c: Any, s: Any, v: Three) -> Three:
    """Rz v, c and s the cosine and the sine of the angle."""
    return (
        renorm(subtract_product(times(c, v[0]), s, v[1])),
        renorm(add_product(times(s, v[0]), c, v[1])),
        v[2],
    )


@kernel
def opposite(x: Any) -> Any:
    """-x."""
    return by_double(x, -1.0)


# ------------------------------------------------------------------------------- products with the rotation E


@kernel
def to_child(series: Numbers, rotation: int, own: int, row: int, k: int) -> Three:
    """(E^T v)_k, v in the rows from `row`; own: the first row of the body."""
    if rotation == AXIS:
        c, s = own + TURNED + 1, own + TURNED + 2
        return (
            plus(cauchy(series, c, row, k), cauchy(series, s, row + 1, k)),
            minus(cauchy(series, c, row + 1, k), cauchy(series, s, row, k)),
            term(series, row + 2, k),
        )
    if rotation == BALL:
        return (
            cauchy_of_three(series, own + E, 3, row, k),
            cauchy_of_three(series, own + E + 1, 3, row, k),
            cauchy_of_three(series, own + E + 2, 3, row, k),
        )
    return vector_terms(series, row, k)


@kernel
def to_zero(series: Numbers, rotation: int, own: int, row: int, k: int) -> Three:
    """(E v)_k, v in the rows from `row`; own: the first row of the body."""
    if rotation == AXIS:
        c, s = own + TURNED + 1, own + TURNED + 2
        return (
            minus(cauchy(series, c, row, k), cauchy(series, s, row + 1, k)),
            plus(cauchy(series, s, row, k), cauchy(series, c, row + 1, k)),
            term(series, row + 2, k),
        )
    if rotation == BALL:
        return (
            cauchy_of_three(series, own + E, 1, row, k),
            cauchy_of_three(series, own + E + 3, 1, row, k),
            cauchy_of_three(series, own + E + 6, 1, row, k),
        )
    return vector_terms(series, row, k)


@kernel
def cauchy_of_three(series: Numbers, i: int, step: int, j: int, k: int) -> Any:
    """(a . b)_k, a in the rows i, i + step, i + 2 step, b in the rows j, j + 1, j + 2."""
    total = nothing(series)
    for n in range(k + 1):
        total = add_product(total, term(series, i, n), term(series, j, k - n))
        total = add_product(total, term(series, i + step, n), term(series, j + 1, k - n))
        total = add_product(total, term(series, i + 2 * step, n), term(series, j + 2, k - n))
    return renorm(total)


@kernel
def to_child_now(series: Numbers, rotation: int, own: int, v: Three) -> Three:
    """E_0^T v."""
    if rotation == AXIS:
        return turned_by(term(series, own + TURNED + 1, 0), opposite(term(series, own + TURNED + 2, 0)), v)
    if rotation == BALL:
        return (
            dot_terms(series, own + E, 3, v),
            dot_terms(series, own + E + 1, 3, v),
            dot_terms(series, own + E + 2, 3, v),
        )
    return v


@kernel
def to_zero_now(series: Numbers, rotation: int, own: int, v: Three) -> Three:
    """E_0 v."""
    if rotation == AXIS:
        return turned_by(term(series, own + TURNED + 1, 0), term(series, own + TURNED + 2, 0), v)
    if rotation == BALL:
        return (
            dot_terms(series, own + E, 1, v),
            dot_terms(series, own + E + 3, 1, v),
            dot_terms(series, own + E + 6, 1, v),
        )
    return v


@kernel
def dot_terms(series: Numbers, i: int, step: int, v: Three) -> Any:
    """a . v, a the constant terms of the rows i, i + step, i + 2 step."""
    total = times(term(series, i, 0), v[0])
    total = add_product(total, term(series, i + step, 0), v[1])
    return renorm(add_product(total, term(series, i + 2 * step, 0), v[2]))


@kernel
def put_row(numbers: Numbers, i: int, j: int, v: Three) -> None:
    """Set the numbers [i, j], [i, j + 1], [i, j + 2]."""
    put(numbers, i, j, v[0])
    put(numbers, i, j + 1, v[1])
    put(numbers, i, j + 2, v[2])


@kernel
def put_joint_force(structure: Structure, out: Numbers, i: int, force: Three, moment: Three) -> None:
    """Set the components of force and moment along the rates of a joint."""
    row = structure[i, RATE]
    if structure[i, TRANSLATION] == SLIDE:
        put(out, row, 0, force[2])
        row += 1
    elif structure[i, TRANSLATION] == SPACE:
        put_vector(out, row, 0, force)
        row += 3
    if structure[i, ROTATION] == AXIS:
        put(out, row, 0, moment[2])
    elif structure[i, ROTATION] == BALL:
        put_vector(out, row, 0, moment)


@kernel
def dot(a: Three, b: Three) -> Any:
    """a . b."""
    return renorm(add_product(add_product(times(a[0], b[0]), a[1], b[1]), a[2], b[2]))


@kernel
def from_world(series: Numbers, own: int, v: Three, k: int) -> Three:
    """(R^T v)_k, v constant in world axes."""
    x = scaled(v[0], vector_terms(series, own + WORLD_AXES, k))
    y = scaled(v[1], vector_terms(series, own + WORLD_AXES + 3, k))
    return added(added(x, y), scaled(v[2], vector_terms(series, own + WORLD_AXES + 6, k)))


@kernel
def to_world(series: Numbers, own: int, v: Three) -> Three:
    """R_0 v, v in turned axes."""
    return (
        dot(vector_terms(series, own + WORLD_AXES, 0), v),
        dot(vector_terms(series, own + WORLD_AXES + 3, 0), v),
        dot(vector_terms(series, own + WORLD_AXES + 6, 0), v),
    )
