"""The response of a tree to the derivatives of its rates: the mass matrix, its factors, the accelerations."""

from __future__ import annotations

from bodycheck.reference_impl.kernels.generic_precision import (
    Numbers,
    exactly,
    high_part,
    nothing,
    over,
    over_double,
    plus,
    put,
    renorm,
    subtract_product,
    term,
    times,
)
from bodycheck.reference_impl.kernels.jit import kernel
from bodycheck.reference_impl.taylor.taylor_terms import added, put_vector, subtracted, vector_terms
from bodycheck.reference_impl.trees.prepared_tree import (
    ARMATURE,
    AT_BODY,
    AT_PARENT,
    INERTIA,
    MASS,
    PARENT,
    RATE,
    RATES,
    ROTATION,
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
    A,
    F,
    N,
    Structure,
    Y,
    add_vector,
    back,
    constant,
    cross,
    opposite,
    put_joint_force,
    put_row,
    scaled,
    through,
    to_child_now,
    to_zero_now,
)


@kernel
def response(
    structure: Structure,
    constants: Numbers,
    series: Numbers,
    work: Numbers,
    x: Numbers,
    out: Numbers,
    k: int,
    keep: bool,
) -> None:
    """Set out (rates, 1) to M x, by the change of forces if u'_k = x; keep: add all changes to the series.

    work (n, 12): the changes of alpha, acceleration, force and torque of each body.
    """
    for i in range(len(structure)):
        _respond(structure, constants, series, work, x, i, k, keep)
    for i in range(len(structure) - 1, -1, -1):
        own, parent = ROWS * i, structure[i, PARENT]
        force, torque = constant(work, i, 6), constant(work, i, 9)
        moment = subtracted(torque, cross(constant(constants, i, AT_BODY), force))
        put_joint_force(structure, out, i, force, moment)
        for row in range(structure[i, RATE], structure[i, RATE] + structure[i, RATES]):
            rotor = times(term(constants, i, ARMATURE), term(x, row, 0))
            put(out, row, 0, plus(term(out, row, 0), rotor))
        if keep:
            add_vector(series, own + F, k, force)
            add_vector(series, own + N, k, torque)
            add_vector(series, own + MOMENT, k, moment)
        if parent < 0:
            continue
        force = to_zero_now(series, structure[i, ROTATION], own, force)
        moment = to_zero_now(series, structure[i, ROTATION], own, moment)
        if structure[i, TRANSLATION] == SLIDE:
            place, none = term(series, own + PLACE, 0), nothing(series)
            moment = added(moment, (opposite(times(place, force[1])), times(place, force[0]), none))
        if keep:
            add_vector(series, own + F_ZERO, k, force)
        force = through(constants, i, ZERO, force)
        moment = added(through(constants, i, ZERO, moment), cross(constant(constants, i, AT_PARENT), force))
        put_row(work, parent, 6, added(constant(work, parent, 6), force))
        put_row(work, parent, 9, added(constant(work, parent, 9), moment))


@kernel
def _respond(
    structure: Structure,
    constants: Numbers,
    series: Numbers,
    work: Numbers,
    x: Numbers,
    i: int,
    k: int,
    keep: bool,
) -> None:
    """Set the row of a body in work, its own force and torque only, from the row of its parent and x."""
    none = nothing(series)
    own, parent, row = ROWS * i, structure[i, PARENT], structure[i, RATE]
    carried = y = (none, none, none)
    if parent >= 0:
        alpha = constant(work, parent, 0)
        carried = back(constants, i, ZERO, alpha)
        at_joint = added(constant(work, parent, 3), cross(alpha, constant(constants, i, AT_PARENT)))
        y = back(constants, i, ZERO, at_joint)
    arm = carried[1], opposite(carried[0]), none
    speed = none, none, none
    if structure[i, TRANSLATION] == SLIDE:
        speed = term(x, row, 0), none, none
        y = added(y, added(scaled(term(series, own + PLACE, 0), arm), (none, none, speed[0])))
        row += 1
    elif structure[i, TRANSLATION] == SPACE:
        y = vector_terms(x, row, 0)
        row += 3
    spin = none, none, none
    if structure[i, ROTATION] == AXIS:
        spin = none, none, term(x, row, 0)
    elif structure[i, ROTATION] == BALL:
        spin = vector_terms(x, row, 0)
    alpha = added(to_child_now(series, structure[i, ROTATION], own, carried), spin)
    if structure[i, TRANSLATION] == SPACE:
        a = y
    else:
        a = to_child_now(series, structure[i, ROTATION], own, y)
        a = subtracted(a, cross(alpha, constant(constants, i, AT_BODY)))
    put_row(work, i, 0, alpha)
    put_row(work, i, 3, a)
    put_row(work, i, 6, scaled(term(constants, i, MASS), a))
    put_row(work, i, 9, through(constants, i, INERTIA, alpha))
    if keep:
        share = over_double(exactly(series, 1.0), k + 1.0)
        put_vector(series, own + SPEED, k + 1, scaled(share, speed))
        put_vector(series, own + SPIN, k + 1, scaled(share, spin))
        add_vector(series, own + OMEGA, k + 1, scaled(share, alpha))
        add_vector(series, own + CARRIED, k + 1, scaled(share, carried))
        add_vector(series, own + ARM, k, arm)
        add_vector(series, own + Y, k, y)
        add_vector(series, own + A, k, a)


@kernel
def put_mass_matrix(
    structure: Structure,
    constants: Numbers,
    series: Numbers,
    work: Numbers,
    x: Numbers,
    out: Numbers,
    mass: Numbers,
) -> None:
    """Set mass (rates, rates) to M at the constant terms: its columns are the responses to unit vectors.

    x (rates, 1) is 0, and out (rates, 1) is overwritten.
    """
    rates = len(high_part(mass))
    for j in range(rates):
        put(x, j, 0, exactly(series, 1.0))
        response(structure, constants, series, work, x, out, 0, False)
        put(x, j, 0, nothing(series))
        for i in range(rates):
            put(mass, i, j, term(out, i, 0))


@kernel
def factor(mass: Numbers) -> None:
    """Replace M by L below and D on its diagonal, M = L D L^T."""
    for j in range(len(high_part(mass))):
        for i in range(j, len(high_part(mass))):
            total = term(mass, i, j)
            for n in range(j):
                product = times(term(mass, i, n), term(mass, n, n))
                total = subtract_product(total, product, term(mass, j, n))
            total = renorm(total)
            put(mass, i, j, total if i == j else over(total, term(mass, j, j)))


@kernel
def solve(factors: Numbers, x: Numbers) -> None:
    """Replace x (rates, 1) by M^-1 x, given the factors of M."""
    rates = len(high_part(factors))
    for i in range(rates):
        total = term(x, i, 0)
        for n in range(i):
            total = subtract_product(total, term(factors, i, n), term(x, n, 0))
        put(x, i, 0, renorm(total))
    for i in range(rates):
        put(x, i, 0, over(term(x, i, 0), term(factors, i, i)))
    for i in range(rates - 1, -1, -1):
        total = term(x, i, 0)
        for n in range(i + 1, rates):
            total = subtract_product(total, term(factors, n, i), term(x, n, 0))
        put(x, i, 0, renorm(total))
