"""A scene followed by its Taylor series, whether its body is free to move or turns about a pivot."""

from __future__ import annotations

import numpy as np

from bodycheck.reference_impl import double_double as dd
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.double_double import DoubleDouble
from bodycheck.reference_impl.forcing import pivot_position
from bodycheck.reference_impl.jit import kernel
from bodycheck.reference_impl.paired import pair
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.taylor import Course, Resolution, Solution, solve_packed
from bodycheck.reference_impl.taylor_terms import OMEGA, V, X


def follow_scene(
    scene: Scene, course: Course, state: tuple[Array, Array], t_s: Array, resolution: Resolution
) -> Solution:
    """Follow a scene's course from a packed state through ascending times (n,); x and v are the centre's.

    The state ((13,), (13,)) ends where the course does. About a pivot its position and velocity are not
    looked at: they follow from its attitude.
    """
    if scene.pivot is None:
        return solve_packed(course, state, t_s, resolution)
    for part in state:
        part[V:] = 0.0
    turned = solve_packed(course, state, t_s, resolution)
    origin = np.array([pair(x) for x in pivot_position(scene)], dtype=np.float64)
    _put_centre(turned.high, turned.low, scene.pivot, origin)
    return turned


@kernel
def _put_centre(high: Array, low: Array, pivot: Array, origin: Array) -> None:
    """x = pivot's place - R r, v = -R (omega x r), r the pivot in body axes, into the states (n, 13)."""
    for k in range(len(high)):
        q = high[k, :OMEGA], low[k, :OMEGA]
        for a in range(3):
            b, c = (a + 1) % 3, (a + 2) % 3
            spin_b, spin_c = (high[k, OMEGA + b], low[k, OMEGA + b]), (high[k, OMEGA + c], low[k, OMEGA + c])
            swept = dd.subtract(dd.multiply(spin_c, (pivot[b], 0.0)), dd.multiply(spin_b, (pivot[c], 0.0)))
            high[k, V + a], low[k, V + a] = swept
        back = _turned(q, (-pivot[0], 0.0), (-pivot[1], 0.0), (-pivot[2], 0.0))
        speed = _turned(
            q,
            (high[k, V], low[k, V]),
            (high[k, V + 1], low[k, V + 1]),
            (high[k, V + 2], low[k, V + 2]),
        )
        for a in range(3):
            high[k, V + a], low[k, V + a] = speed[a]
            high[k, X + a], low[k, X + a] = dd.add((origin[a, 0], origin[a, 1]), back[a])


@kernel
def _turned(
    q: tuple[Array, Array], x: DoubleDouble, y: DoubleDouble, z: DoubleDouble
) -> tuple[DoubleDouble, DoubleDouble, DoubleDouble]:
    """R(q) v = v + w t + u x t, t = 2 u x v, of q = (w, u)."""
    u = (q[0][1], q[1][1]), (q[0][2], q[1][2]), (q[0][3], q[1][3])
    v = (x, y, z)
    t = (
        dd.scale(dd.subtract(dd.multiply(u[1], v[2]), dd.multiply(u[2], v[1])), 2.0),
        dd.scale(dd.subtract(dd.multiply(u[2], v[0]), dd.multiply(u[0], v[2])), 2.0),
        dd.scale(dd.subtract(dd.multiply(u[0], v[1]), dd.multiply(u[1], v[0])), 2.0),
    )
    w = q[0][0], q[1][0]
    return (
        dd.add(
            dd.add(x, dd.multiply(w, t[0])), dd.subtract(dd.multiply(u[1], t[2]), dd.multiply(u[2], t[1]))
        ),
        dd.add(
            dd.add(y, dd.multiply(w, t[1])), dd.subtract(dd.multiply(u[2], t[0]), dd.multiply(u[0], t[2]))
        ),
        dd.add(
            dd.add(z, dd.multiply(w, t[2])), dd.subtract(dd.multiply(u[0], t[1]), dd.multiply(u[1], t[0]))
        ),
    )
