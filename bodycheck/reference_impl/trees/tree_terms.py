"""The Taylor coefficients of the motion of a tree, by the recursive Newton-Euler equations.

series[ROWS * i + r, k] is the k-th coefficient of the quantity r of body i, in turned axes (e_z along the
joint's axis). At order k, `advance` extends coordinates and rotations to k + 1; `residual` computes the
forces that the joints must supply if u'_k = 0; and `response` adds what u'_k changes. Order 0 is the dynamics
of one state, without motion. The response to unit vectors is the mass matrix. Sources: Luh, Walker and Paul
(1980), On-line computational scheme for mechanical manipulators, J. Dyn. Syst. Meas. Control 102, 69; Walker
and Orin (1982), Efficient dynamic computer simulation of robotic mechanisms, ibid. 104, 205 (method 1).
"""

from __future__ import annotations

from typing import Any

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    Three,
    add_product,
    by_double,
    exactly,
    high_part,
    minus,
    nothing,
    over_double,
    plus,
    put,
    renorm,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.taylor.taylor_terms import added, cauchy, put_vector, subtracted, vector_terms
from bodycheck.reference_impl.trees.prepared_tree import (
    AT_BODY,
    AT_PARENT,
    DAMPING,
    FORCE,
    INERTIA,
    MASS,
    PARENT,
    POINT,
    RATE,
    RATES,
    REST,
    ROTATION,
    STIFFNESS,
    TORQUE,
    TRANSLATION,
    ZERO,
)
from bodycheck.reference_impl.trees.tree_numbers import (
    ARM,
    AXIS,
    BALL,
    CARRIED,
    F_ZERO,
    MOMENT,
    OMEGA,
    PLACE,
    ROWS,
    SLIDE,
    SPACE,
    SPEED,
    SPIN,
    SQUARES,
    TURNED,
    WORLD_AXES,
    WORLD_IN_ZERO,
    A,
    E,
    F,
    N,
    Structure,
    Y,
    add_vector,
    back,
    cauchy_of_three,
    constant,
    cross,
    from_world,
    opposite,
    put_joint_force,
    scaled,
    through,
    to_child,
    to_zero,
)

# ---------------------------------------------------------------------------------------------- coordinates


@kernel
def advance(structure: Structure, sines: Array, series: Numbers, k: int) -> None:
    """Extend coordinates, rotations and sines of loads to order k + 1: q' = u, or q omega / 2."""
    share = over_double(exactly(series, 1.0), k + 1.0)
    for i in range(len(structure)):
        own, rotation = ROWS * i, structure[i, ROTATION]
        for j in range((0, 1, 3)[structure[i, TRANSLATION]]):
            put(series, own + PLACE + j, k + 1, times(share, term(series, own + SPEED + j, k)))
        if rotation == AXIS:
            angle, spin = own + TURNED, own + SPIN + 2
            put(series, angle, k + 1, times(share, term(series, spin, k)))
            put(series, angle + 1, k + 1, opposite(times(share, cauchy(series, spin, angle + 2, k))))
            put(series, angle + 2, k + 1, times(share, cauchy(series, spin, angle + 1, k)))
        elif rotation == BALL:
            _spin_quaternion(series, own + TURNED, own + SPIN, k, by_double(share, 0.5))
            put_rotation(series, own, k + 1)
    for j in range(len(sines)):
        row = ROWS * len(structure) + 2 * j
        sine, cosine = term(series, row, k), term(series, row + 1, k)
        put(series, row, k + 1, times(share, by_double(cosine, sines[j, 1])))
        put(series, row + 1, k + 1, times(share, by_double(sine, -sines[j, 1])))


@kernel
def _spin_quaternion(series: Numbers, q: int, spin: int, k: int, half: Any) -> None:
    """q' = q omega / 2, the coefficient k + 1 = 1 / (2 half)."""
    w = opposite(cauchy_of_three(series, q + 1, 1, spin, k))
    x = minus(
        plus(cauchy(series, q, spin, k), cauchy(series, q + 2, spin + 2, k)),
        cauchy(series, q + 3, spin + 1, k),
    )
    y = minus(
        plus(cauchy(series, q, spin + 1, k), cauchy(series, q + 3, spin, k)),
        cauchy(series, q + 1, spin + 2, k),
    )
    z = minus(
        plus(cauchy(series, q, spin + 2, k), cauchy(series, q + 1, spin + 1, k)),
        cauchy(series, q + 2, spin, k),
    )
    put(series, q, k + 1, times(half, w))
    put_vector(series, q + 1, k + 1, (times(half, x), times(half, y), times(half, z)))


@kernel
def put_rotation(series: Numbers, own: int, k: int) -> None:
    """E_k of the unit quaternion of a body, from products of its terms."""
    w, e = own + TURNED, own + E
    x, y, z = w + 1, w + 2, w + 3
    xx, yy, zz = cauchy(series, x, x, k), cauchy(series, y, y, k), cauchy(series, z, z, k)
    xy, xz, yz = cauchy(series, x, y, k), cauchy(series, x, z, k), cauchy(series, y, z, k)
    wx, wy, wz = cauchy(series, w, x, k), cauchy(series, w, y, k), cauchy(series, w, z, k)
    one = exactly(series, 1.0 if k == 0 else 0.0)
    put(series, e, k, minus(one, by_double(plus(yy, zz), 2.0)))
    put(series, e + 1, k, by_double(minus(xy, wz), 2.0))
    put(series, e + 2, k, by_double(plus(xz, wy), 2.0))
    put(series, e + 3, k, by_double(plus(xy, wz), 2.0))
    put(series, e + 4, k, minus(one, by_double(plus(xx, zz), 2.0)))
    put(series, e + 5, k, by_double(minus(yz, wx), 2.0))
    put(series, e + 6, k, by_double(minus(xz, wy), 2.0))
    put(series, e + 7, k, by_double(plus(yz, wx), 2.0))
    put(series, e + 8, k, minus(one, by_double(plus(xx, yy), 2.0)))


@kernel
def put_world_axes(structure: Structure, constants: Numbers, series: Numbers, k: int) -> None:
    """The columns of R^T, Q^T R_parent^T in the rows WORLD_IN_ZERO and E^T of it in the rows WORLD_AXES."""
    for i in range(len(structure)):
        own, parent = ROWS * i, structure[i, PARENT]
        for j in range(3):
            column = own + WORLD_IN_ZERO + 3 * j
            if parent >= 0:
                axis = vector_terms(series, ROWS * parent + WORLD_AXES + 3 * j, k)
                put_vector(series, column, k, back(constants, i, ZERO, axis))
            else:
                for row in range(3):
                    entry = term(constants, i, ZERO + 3 * j + row) if k == 0 else nothing(series)
                    put(series, column + row, k, entry)
            axis = to_child(series, structure[i, ROTATION], own, column, k)
            put_vector(series, own + WORLD_AXES + 3 * j, k, axis)


# --------------------------------------------------------------------------------------- Newton and Euler


@kernel
def put_omega(structure: Structure, constants: Numbers, series: Numbers, i: int, k: int) -> None:
    """omega = E^T Q^T omega_parent + S u, the coefficients k."""
    own, parent = ROWS * i, structure[i, PARENT]
    if parent >= 0:
        omega = vector_terms(series, ROWS * parent + OMEGA, k)
        put_vector(series, own + CARRIED, k, back(constants, i, ZERO, omega))
        carried = to_child(series, structure[i, ROTATION], own, own + CARRIED, k)
        put_vector(series, own + OMEGA, k, added(carried, vector_terms(series, own + SPIN, k)))
    else:
        put_vector(series, own + OMEGA, k, vector_terms(series, own + SPIN, k))


@kernel
def _point(series: Numbers, own: int, k: int, r: Three) -> Three:
    """(alpha x r + omega x (omega x r))_k of a body, r constant."""
    omega = vector_terms(series, own + OMEGA, k + 1)
    xx, yy, zz = vector_terms(series, own + SQUARES, k)
    xy, xz, yz = vector_terms(series, own + SQUARES + 3, k)
    x, y, z = cross(omega, r)
    x, y, z = by_double(x, k + 1.0), by_double(y, k + 1.0), by_double(z, k + 1.0)
    x = add_product(add_product(subtract_product(x, plus(yy, zz), r[0]), xy, r[1]), xz, r[2])
    y = add_product(subtract_product(add_product(y, xy, r[0]), plus(xx, zz), r[1]), yz, r[2])
    z = subtract_product(add_product(add_product(z, xz, r[0]), yz, r[1]), plus(xx, yy), r[2])
    return renorm(x), renorm(y), renorm(z)


@kernel
def _torque(constants: Numbers, series: Numbers, i: int, k: int) -> Three:
    """(I alpha + omega x I omega)_k."""
    own = ROWS * i
    x, y, z = vector_terms(series, own + OMEGA, k + 1)
    x, y, z = through(
        constants, i, INERTIA, (by_double(x, k + 1.0), by_double(y, k + 1.0), by_double(z, k + 1.0))
    )
    a, b, c = (
        constant(constants, i, INERTIA),
        constant(constants, i, INERTIA + 3),
        constant(constants, i, INERTIA + 6),
    )
    xx, yy, zz = vector_terms(series, own + SQUARES, k)
    xy, xz, yz = vector_terms(series, own + SQUARES + 3, k)
    x = add_product(add_product(add_product(x, c[0], xy), c[1], minus(yy, zz)), minus(c[2], b[1]), yz)
    x = subtract_product(x, b[0], xz)
    y = add_product(add_product(add_product(y, a[1], yz), a[2], minus(zz, xx)), minus(a[0], c[2]), xz)
    y = subtract_product(y, c[1], xy)
    z = add_product(add_product(add_product(z, b[2], xz), b[0], minus(xx, yy)), minus(b[1], a[0]), xy)
    z = subtract_product(z, a[2], yz)
    return renorm(x), renorm(y), renorm(z)


@kernel
def residual(
    structure: Structure, constants: Numbers, gravity: Numbers, series: Numbers, out: Numbers, k: int
) -> None:
    """Set out (rates, 1) to the generalised forces that the joints must supply at order k if u'_k = 0.

    The rows F and N hold minus the loads on the bodies, if any, and then force and torque about the centre,
    with those of the children. The rates of a free body are those of b = R^T (v' - g) and of omega.
    """
    none = nothing(series)
    for i in range(len(structure)):
        own = ROWS * i
        put_vector(series, own + SPIN, k + 1, (none, none, none))
        put_omega(structure, constants, series, i, k + 1)
        x, y, z = own + OMEGA, own + OMEGA + 1, own + OMEGA + 2
        squares = cauchy(series, x, x, k), cauchy(series, y, y, k), cauchy(series, z, z, k)
        put_vector(series, own + SQUARES, k, squares)
        products = cauchy(series, x, y, k), cauchy(series, x, z, k), cauchy(series, y, z, k)
        put_vector(series, own + SQUARES + 3, k, products)
        put_vector(series, own + A, k, _acceleration(structure, constants, gravity, series, i, k))
        force = scaled(term(constants, i, MASS), vector_terms(series, own + A, k))
        add_vector(series, own + F, k, force)
        add_vector(series, own + N, k, _torque(constants, series, i, k))
    for i in range(len(structure) - 1, -1, -1):
        own = ROWS * i
        force, torque = vector_terms(series, own + F, k), vector_terms(series, own + N, k)
        moment = subtracted(torque, cross(constant(constants, i, AT_BODY), force))
        put_vector(series, own + MOMENT, k, moment)
        put_joint_force(structure, out, i, force, moment)
        if structure[i, PARENT] >= 0:
            _pass_on(structure, constants, series, i, k)


@kernel
def _acceleration(
    structure: Structure, constants: Numbers, gravity: Numbers, series: Numbers, i: int, k: int
) -> Three:
    """(R^T (x'' - g))_k of the centre of a body if u'_k = 0; sets the rows Y and ARM."""
    none = nothing(series)
    own, parent = ROWS * i, structure[i, PARENT]
    if structure[i, TRANSLATION] == SPACE:
        return none, none, none
    if parent >= 0:
        above = ROWS * parent
        at_joint = _point(series, above, k, constant(constants, i, AT_PARENT))
        at_joint = added(at_joint, vector_terms(series, above + A, k))
    elif k == 0:
        at_joint = (
            opposite(term(gravity, 0, 0)),
            opposite(term(gravity, 1, 0)),
            opposite(term(gravity, 2, 0)),
        )
    else:
        at_joint = none, none, none
    y = back(constants, i, ZERO, at_joint)
    if structure[i, TRANSLATION] == SLIDE:
        y = added(y, _sliding(series, own, k))
    put_vector(series, own + Y, k, y)
    turned = to_child(series, structure[i, ROTATION], own, own + Y, k)
    return subtracted(turned, _point(series, own, k, constant(constants, i, AT_BODY)))


@kernel
def _sliding(series: Numbers, own: int, k: int) -> Three:
    """((A e) s + 2 omega x e s')_k in zero axes, omega that of the parent; sets the rows ARM."""
    x, y, z = own + CARRIED, own + CARRIED + 1, own + CARRIED + 2
    across = plus(by_double(term(series, y, k + 1), k + 1.0), cauchy(series, x, z, k))
    along = minus(cauchy(series, y, z, k), by_double(term(series, x, k + 1), k + 1.0))
    inward = opposite(plus(cauchy(series, x, x, k), cauchy(series, y, y, k)))
    put_vector(series, own + ARM, k, (across, along, inward))
    speed, place = own + SPEED, own + PLACE
    return (
        plus(cauchy(series, place, own + ARM, k), by_double(cauchy(series, speed, y, k), 2.0)),
        minus(cauchy(series, place, own + ARM + 1, k), by_double(cauchy(series, speed, x, k), 2.0)),
        cauchy(series, place, own + ARM + 2, k),
    )


@kernel
def _pass_on(structure: Structure, constants: Numbers, series: Numbers, i: int, k: int) -> None:
    """Add force and torque of a joint to those of the parent."""
    own, above = ROWS * i, ROWS * structure[i, PARENT]
    rotation = structure[i, ROTATION]
    force = to_zero(series, rotation, own, own + F, k)
    put_vector(series, own + F_ZERO, k, force)
    moment = to_zero(series, rotation, own, own + MOMENT, k)
    if structure[i, TRANSLATION] == SLIDE:
        place, none = own + PLACE, nothing(series)
        arm = cauchy(series, place, own + F_ZERO, k), cauchy(series, place, own + F_ZERO + 1, k)
        moment = added(moment, (opposite(arm[1]), arm[0], none))
    force = through(constants, i, ZERO, force)
    add_vector(series, above + F, k, force)
    arm_moment = cross(constant(constants, i, AT_PARENT), force)
    add_vector(series, above + N, k, added(through(constants, i, ZERO, moment), arm_moment))


# --------------------------------------------------------------------------------------------------- loads


@kernel
def put_pushes(pushes: Numbers, pushed: Structure, series: Numbers, n: int, k: int) -> None:
    """Set the rows F and N of n bodies to minus the loads; those in world axes need `put_world_axes`."""
    none = nothing(series)
    for i in range(n):
        put_vector(series, ROWS * i + F, k, (none, none, none))
        put_vector(series, ROWS * i + N, k, (none, none, none))
    for j in range(len(pushed)):
        own = ROWS * pushed[j, 0]
        force, torque = constant(pushes, j, FORCE), constant(pushes, j, TORQUE)
        if pushed[j, 1]:
            force = from_world(series, own, force, k)
            torque = from_world(series, own, torque, k)
        elif k > 0:
            continue
        torque = added(torque, cross(constant(pushes, j, POINT), force))
        put_vector(series, own + F, k, subtracted(vector_terms(series, own + F, k), force))
        put_vector(series, own + N, k, subtracted(vector_terms(series, own + N, k), torque))


@kernel
def put_joint_torques(
    structure: Structure,
    constants: Numbers,
    torques: Numbers,
    sines: Array,
    sine_rates: Structure,
    series: Numbers,
    out: Numbers,
    k: int,
) -> None:
    """Set out (rates, 1) to (-stiffness (q - rest) - damping u + torque)_k of each joint."""
    for row in range(len(high_part(out))):
        put(out, row, 0, term(torques, row, 0) if k == 0 else nothing(series))
    for j in range(len(sines)):
        swing = by_double(term(series, ROWS * len(structure) + 2 * j, k), sines[j, 0])
        put(out, sine_rates[j], 0, plus(term(out, sine_rates[j], 0), swing))
    for i in range(len(structure)):
        own, row = ROWS * i, structure[i, RATE]
        is_turned = structure[i, ROTATION] == AXIS
        spring = term(series, own + (TURNED if is_turned else PLACE), k)
        if k == 0:
            spring = minus(spring, term(constants, i, REST))
        put(out, row, 0, subtract_product(term(out, row, 0), term(constants, i, STIFFNESS), spring))
        first = own + (SPEED if structure[i, TRANSLATION] != 0 else SPIN + 2 * is_turned)
        for j in range(structure[i, RATES]):
            share = subtract_product(
                term(out, row + j, 0), term(constants, i, DAMPING), term(series, first + j, k)
            )
            put(out, row + j, 0, renorm(share))
