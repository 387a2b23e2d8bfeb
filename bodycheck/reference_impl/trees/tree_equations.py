"""The equations of motion of a tree, by recursive Newton-Euler, as rows of quadratic forms.

Axes of a body are turned so that the joint's axis is e_z. The unknowns of an order are the derivatives of the
rates; for a free body b = R^T (v' - g) in place of v', so that R is in no equation without loads in world
axes. Sources: Luh, Walker and Paul (1980), On-line computational scheme for mechanical manipulators, J. Dyn.
Syst. Meas. Control 102, 69; Walker and Orin (1982), Efficient dynamic computer simulation of robotic
mechanisms, ibid. 104, 205 (method 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from math import isqrt

import numpy as np
from numpy.typing import NDArray

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.rational import Vector, cross, dot, fractions, rotation_of, times, transposed
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.quadratic_forms import (
    Equations,
    Form,
    Response,
    Row,
    Rows,
    Three,
    number,
    packed,
    response_of,
)
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    JointSineTorque,
    JointTorque,
    TreeBody,
    TreeLoad,
    TreeScene,
    interval,
)

POSITION, QUATERNION, VELOCITY, BODY_OMEGA, JOINT_FORCE, JOINT_MOMENT, POSE = 0, 3, 7, 10, 13, 16, 19
"""Columns of a body's outputs: position and velocity of the centre in world axes; omega, and the wrench of
the joint about its point, in body axes."""
KINETIC, POTENTIAL, MOMENTUM, ANGULAR, TOTALS = 0, 1, 2, 5, 8
"""Places of the totals: energies, momentum and angular momentum about the origin, in world axes."""
_ONE = Fraction(1)


@dataclass(frozen=True, eq=False)
class TreeEquations:
    """The recorded equations of a tree of n bodies and nu rates under the loads of one interval.

    places (n,): the first row of each joint: its coordinates of translation, then angle, cosine and sine of
    the angle, cosine and sine of its half, or the quaternion; then the rates of translation and of rotation.
    main, end: the first rows of the forms and of the outputs. unknowns and results (nu,): the rows of the
    rates' derivatives (b for the velocity of a free body), and of the forces that are missing at the joints.
    sines (s,): the first row of each, its rate and phase. poses (n, POSE), totals (TOTALS,): output rows.
    """

    rows: Rows
    response: Response
    joints: NDArray[np.int64]
    unknowns: NDArray[np.int64]
    ahead: NDArray[np.int64]
    results: NDArray[np.int64]
    main: int
    end: int
    sine_rows: NDArray[np.int64]
    sines: Array
    poses: NDArray[np.int64]
    totals: NDArray[np.int64]


def acting_loads(scene: TreeScene, t_s: float) -> tuple[TreeLoad, ...]:
    """Return the loads that act at a time."""
    return tuple(load for load in scene.loads if interval(load)[0] <= t_s < interval(load)[1])


def tree_equations(scene: TreeScene, t_s: float = 0.0) -> TreeEquations:
    """Return the equations of a scene with the loads that act at a time; rates at the start are ignored."""
    return recorded_equations(scene.bodies, acting_loads(scene, t_s), tuple(scene.gravity))


@lru_cache(maxsize=64)
def recorded_equations(
    bodies: tuple[TreeBody, ...], loads: tuple[TreeLoad, ...], gravity: tuple[float, ...]
) -> TreeEquations:
    """Return the equations of bodies under loads that act at all times."""
    return _Recorder(bodies, loads, np.array(gravity)).recorded()


class _Body:
    """The constants of a body in turned axes, its rows, and the forms of its motion and forces."""

    def __init__(self, equations: Equations, body: TreeBody, above: _Body | None) -> None:
        self.joint, self.above = body.joint, above
        kind = body.joint.of_kind
        self.rotation, self.translation = kind.rotation, kind.translation
        self.turn = _turn(body)
        self.to_body = rotation_of(self.turn)
        to_turned = transposed(self.to_body)
        above_turn = above.turn if above else _IDENTITY
        zero = _composed(_conjugate(above_turn), _composed(fractions(body.joint.zero), self.turn))
        self.zero, self.zero_quaternion = rotation_of(zero), _unit(zero)
        self.at_parent = times(transposed(rotation_of(above_turn)), fractions(body.joint.at_parent))
        self.at_body = times(to_turned, fractions(body.joint.at_body))
        self.mass = Fraction(body.mass)
        self.inertia = _product(to_turned, _product(fractions(body.inertia), self.to_body))

        self.places = equations.inputs((0, 1, 3)[self.translation])
        self.turned = equations.inputs((0, 5, 4)[self.rotation])
        self.speeds = equations.inputs((0, 1, 3)[self.translation])
        self.spins = equations.inputs((0, 1, 3)[self.rotation])
        self.b = equations.inputs(3) if self.translation is Translation.SPACE else []
        self.has_children = False
        nothing = [equations.zero] * 3
        self.e: Three = []  # row by row
        self.carried, self.omega, self.alpha = nothing, nothing, nothing
        self.squares: list[Three] = []  # omega_i omega_j
        self.a, self.force, self.torque, self.moment = nothing, nothing, nothing, nothing
        self.position, self.velocity, self.v, self.quaternion = nothing, nothing, nothing, nothing

    def to_child(self, v: Three) -> Three:
        """E^T v."""
        if self.rotation is Rotation.AXIS:
            c, s = self.turned[1:3]
            return [c * v[0] + s * v[1], c * v[1] - s * v[0], v[2]]
        return v if self.rotation is Rotation.NONE else [_dot(self.e[i::3], v) for i in range(3)]

    def to_zero(self, v: Three) -> Three:
        """E v."""
        if self.rotation is Rotation.AXIS:
            c, s = self.turned[1:3]
            return [c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]]
        return v if self.rotation is Rotation.NONE else [_dot(self.e[3 * i : 3 * i + 3], v) for i in range(3)]


class _Recorder:
    """Record the equations: motions from the roots outwards, forces back to them, and what a state shows."""

    def __init__(self, bodies: tuple[TreeBody, ...], loads: tuple[TreeLoad, ...], gravity: Array) -> None:
        self.equations = Equations()
        self.none = [self.equations.zero] * 3
        self.gravity = fractions(gravity)
        self.bodies: list[_Body] = []
        for body in bodies:
            above = self.bodies[body.joint.parent] if body.joint.parent >= 0 else None
            self.bodies.append(_Body(self.equations, body, above))
            if above:
                above.has_children = True
        self.pushes = [load for load in loads if isinstance(load, BodyLoad)]
        self.torques = [load for load in loads if isinstance(load, JointTorque)]
        self.sines = [load for load in loads if isinstance(load, JointSineTorque)]
        self.swings = [self.equations.inputs(2) for _ in self.sines]
        self._axes: dict[_Body, list[Three]] = {}

    def recorded(self) -> TreeEquations:
        """Return the rows of all equations, and of poses and totals at order 0."""
        equations = self.equations
        equations.kind = Row.AHEAD
        for body in self.bodies:
            self._record_turning(body)
        for swing, (sine, cosine) in zip(self.sines, self.swings, strict=True):
            equations.define(sine, Row.INTEGRAL, cosine.by(Fraction(swing.rate)))
            equations.define(cosine, Row.INTEGRAL, sine.by(-Fraction(swing.rate)))
        for push in self.pushes:
            if push.load.axes == "world":
                self._world_axes(self.bodies[push.body])
        main, equations.kind = len(equations.kinds), Row.FORM
        for body in self.bodies:
            self._record_acceleration(body)
        for push in self.pushes:
            self._record_push(push)
        for body in reversed(self.bodies):
            self._record_forces(body)
        results = self._results()
        unknowns = [
            unknown
            for body in self.bodies
            for unknown in (
                *((row, False) for row in body.b),
                *((row, True) for row in (body.speeds if not body.b else [])),
                *((row, True) for row in body.spins),
            )
        ]
        end = len(equations.kinds)
        response = response_of(equations, unknowns, results)
        poses, totals = self._outputs()
        return TreeEquations(
            packed(equations),
            response,
            np.array([_first_row(body) for body in self.bodies], dtype=np.int64),
            np.array([number(row) for row, _ in unknowns], dtype=np.int64),
            np.array([int(is_ahead) for _, is_ahead in unknowns], dtype=np.int64),
            np.array([number(row) for row in results], dtype=np.int64),
            main,
            end,
            np.array([number(sine) for sine, _ in self.swings], dtype=np.int64),
            np.array([(swing.rate, swing.phase) for swing in self.sines]).reshape(-1, 2),
            poses,
            totals,
        )

    # ------------------------------------------------------------------------------- outwards: velocities

    def _record_turning(self, body: _Body) -> None:
        """q' = u, or q omega / 2; omega = E^T Q^T omega_parent + S u."""
        equations = self.equations
        is_free = body.translation is Translation.SPACE
        for place, speed in zip(body.places, body.speeds, strict=True):
            equations.define(place, Row.LATE if is_free else Row.INTEGRAL, speed)
        spin = self.none
        if body.rotation is Rotation.AXIS:
            angle, cosine, sine = body.turned[:3]
            equations.define(angle, Row.INTEGRAL, body.spins[0])
            equations.define(cosine, Row.INTEGRAL, (body.spins[0] * sine).by(-1))
            equations.define(sine, Row.INTEGRAL, body.spins[0] * cosine)
            spin = [*self.none[:2], body.spins[0]]
        elif body.rotation is Rotation.BALL:
            spin = body.spins
            rate = _product_of_quaternions(body.turned, [equations.zero, *spin])
            for part, form in zip(body.turned, rate, strict=True):
                equations.define(part, Row.INTEGRAL, form.by(Fraction(1, 2)))
            body.e = equations.rows(self._rotation(body.turned))
        body.carried = self.none
        if body.above:
            body.carried = equations.rows(_times(transposed(body.zero), body.above.omega))
        body.omega = equations.rows(_sum(body.to_child(body.carried), spin))
        if is_free:
            velocity = _sum(equations.constants(self.gravity), body.to_zero(body.b))
            for speed, form in zip(body.speeds, velocity, strict=True):
                equations.define(speed, Row.LATE, form)

    def _rotation(self, q: list[Form]) -> Three:
        """R(q), row by row."""
        square = [[self.equations.row(a * b) for b in q] for a in q]
        (_, wx, wy, wz), (_, xx, xy, xz), (_, _, yy, yz), (_, _, _, zz) = square
        one = self.equations.constant(_ONE)
        return [
            *(one - (yy + zz).by(2), (xy - wz).by(2), (xz + wy).by(2)),
            *((xy + wz).by(2), one - (xx + zz).by(2), (yz - wx).by(2)),
            *((xz - wy).by(2), (yz + wx).by(2), one - (xx + yy).by(2)),
        ]

    def _world_axes(self, body: _Body) -> list[Three]:
        """The axes of the world in those of the body: the columns of R^T = E^T Q^T R_parent^T."""
        if body not in self._axes:
            equations = self.equations
            above = (
                self._world_axes(body.above)
                if body.above
                else [equations.constants(_UNIT[3 * j : 3 * j + 3]) for j in range(3)]
            )
            turned = [equations.rows(_times(transposed(body.zero), axis)) for axis in above]
            self._axes[body] = [equations.rows(body.to_child(axis)) for axis in turned]
        return self._axes[body]

    # ---------------------------------------------------------------------------------------- accelerations

    def _record_acceleration(self, body: _Body) -> None:
        """a = E^T y - A r, y = Q^T (a_parent + A_parent r_parent) + what a slide adds; free bodies fall."""
        equations = self.equations
        body.alpha = [equations.derivative(part) for part in body.omega]
        body.squares = [[equations.row(a * b) for b in body.omega] for a in body.omega]
        a = body.b
        if not body.b:
            above = body.above
            if above:
                y = _sum(above.a, _arm(above.alpha, above.squares, body.at_parent))
            else:
                y = equations.constants([-g for g in self.gravity])
            y = _times(transposed(body.zero), y)
            if body.translation is Translation.AXIS:
                y = _sum(y, self._sliding(body))
            own = _arm(body.alpha, body.squares, body.at_body)
            a = _difference(body.to_child(y), own)
        body.a = equations.rows(a) if body.has_children else a
        body.force = [part.by(body.mass) for part in body.a]
        inertia = [_times(body.inertia, column) for column in body.squares]
        body.torque = _sum(_times(body.inertia, body.alpha), _crossed(inertia))

    def _sliding(self, body: _Body) -> Three:
        """(A e) s + 2 omega x e s' + e s'' in zero axes, A and omega those of the parent."""
        (place,), (speed,), (x, y, _) = body.places, body.speeds, body.carried
        alpha = [self.equations.derivative(part) for part in body.carried]
        squares = [[a * b for b in body.carried] for a in body.carried]
        arm = [place * part for part in self.equations.rows(_arm(alpha, squares, _UNIT[6:]))]
        swept = [(speed * y).by(2), (speed * x).by(-2), self.equations.derivative(speed)]
        return _sum(arm, swept)

    # -------------------------------------------------------------------------------------- back: the forces

    def _record_push(self, load: BodyLoad) -> None:
        """Subtract a load on a body from the force and the torque that it needs."""
        body = self.bodies[load.body]
        to_turned = transposed(body.to_body)
        value = self.equations.constants(fractions(load.load.value))
        if load.load.axes == "world":
            axes = self._world_axes(body)
            push = [_dot([axis[i] for axis in axes], value) for i in range(3)]
        else:
            push = _times(to_turned, value)
        if isinstance(load.load, Torque):
            body.torque = _difference(body.torque, push)
        else:
            body.force = _difference(body.force, push)
            at = times(to_turned, fractions(load.load.at))
            body.torque = _difference(body.torque, _cross(at, push))

    def _record_forces(self, body: _Body) -> None:
        """Pass force and moment at the joint on to the parent: Q E F, Q E n + r x Q E F."""
        equations = self.equations
        body.force = equations.rows(body.force)
        body.moment = _difference(body.torque, _cross(body.at_body, body.force))
        if not body.above:
            return
        body.moment = equations.rows(body.moment)
        force = equations.rows(body.to_zero(body.force))
        moment = body.to_zero(body.moment)
        if body.translation is Translation.AXIS:
            (place,) = body.places
            moment = _sum(moment, [(place * force[1]).by(-1), place * force[0], equations.zero])
        moment = equations.rows(moment)
        turned = _times(body.zero, force)
        body.above.force = _sum(body.above.force, turned)
        turned_moment = _sum(_times(body.zero, moment), _cross(body.at_parent, turned))
        body.above.torque = _sum(body.above.torque, turned_moment)

    def _results(self) -> list[Form]:
        """The forces that the joints need, less those of springs, dampers and loads."""
        applied = {body: [self.equations.zero] * body.joint.of_kind.rates for body in self.bodies}
        for load in self.torques:
            body = self.bodies[load.body]
            applied[body] = _sum(applied[body], self.equations.constants(fractions(load.value)))
        for swing, (sine, _) in zip(self.sines, self.swings, strict=True):
            body = self.bodies[swing.body]
            applied[body] = _sum(applied[body], [sine.by(Fraction(swing.amplitude))])
        forms: list[Form] = []
        for body in self.bodies:
            joint = body.joint
            needed = [
                *((), body.force[2:], body.force)[body.translation],
                *((), body.moment[2:], body.moment)[body.rotation],
            ]
            rates = [*body.speeds, *body.spins]
            if joint.of_kind.is_scalar:
                rest = self.equations.constant(Fraction(joint.rest))
                spring = [*body.places, *body.turned][0] - rest
                needed = [needed[0] + spring.by(Fraction(joint.stiffness))]
            for form, rate, given in zip(needed, rates, applied[body], strict=True):
                own = form + rate.by(Fraction(joint.damping)) - given
                if joint.armature:
                    own = own + self.equations.derivative(rate).by(Fraction(joint.armature))
                forms.append(own)
        first = self.equations.outputs(forms)
        return [Form(self.equations, {(int(row),): _ONE}) for row in first]

    # ----------------------------------------------------------------------------------- what a state shows

    def _outputs(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Record poses, velocities, wrenches, energies and momenta."""
        equations, forms = self.equations, []
        totals = [equations.zero] * TOTALS
        weight = [-g for g in self.gravity]
        for body in self.bodies:
            self._record_motion(body)
            wrench = [*body.force, *body.moment] if not body.b else [*self.none, *self.none]
            quaternion = _product_of_quaternions(
                body.quaternion, equations.constants(_conjugate(_unit(body.turn)))
            )
            forms += [*body.position, *quaternion, *body.velocity, *_times(body.to_body, body.omega)]
            forms += [*_times(body.to_body, wrench[:3]), *_times(body.to_body, wrench[3:])]
            spin = equations.rows(_times(body.inertia, body.omega))
            momentum = equations.rows([part.by(body.mass) for part in body.velocity])
            twice = _dot(momentum, body.velocity) + _dot(spin, body.omega)
            potential = _dot([part.by(body.mass) for part in body.position], equations.constants(weight))
            if body.joint.of_kind.is_scalar:
                stretch = equations.row(
                    [*body.places, *body.turned][0] - equations.constant(Fraction(body.joint.rest))
                )
                potential = potential + (stretch * stretch).by(Fraction(body.joint.stiffness) / 2)
            angular = _sum(_cross_forms(body.position, momentum), self._to_world(body, spin))
            totals = _sum(totals, [twice.by(Fraction(1, 2)), potential, *momentum, *angular])
        return equations.outputs(forms).reshape(-1, POSE), equations.outputs(totals)

    def _to_world(self, body: _Body, v: Three) -> Three:
        return [_dot(axis, v) for axis in self._world_axes(body)]

    def _record_motion(self, body: _Body) -> None:
        """Record position, velocity, its components in body axes, and the quaternion of turned axes."""
        equations, above = self.equations, body.above
        quaternion = equations.constants(body.zero_quaternion)
        position = equations.constants(body.at_parent)
        v = self.none
        if above:
            quaternion = _product_of_quaternions(above.quaternion, quaternion)
            v = _times(transposed(body.zero), _difference(above.v, _cross(body.at_parent, above.omega)))
            position = _sum(above.position, self._to_world(above, position))
        turned = body.turned
        if body.rotation is Rotation.AXIS:
            turned = [turned[3], *self.none[:2], turned[4]]
        if body.rotation is not Rotation.NONE:
            quaternion = _product_of_quaternions(equations.rows(quaternion), turned)
        body.quaternion = equations.rows(quaternion)
        if body.translation is Translation.AXIS:
            (place,), (speed,), (x, y, _) = body.places, body.speeds, body.carried
            v = _sum(v, [place * y, (place * x).by(-1), speed])
            position = _sum(position, self._to_world(body, [*self.none[:2], place]))
        at_body = equations.constants(body.at_body)
        body.v = equations.rows(_sum(body.to_child(v), _cross(body.at_body, body.omega)))
        body.position = equations.rows(_difference(position, self._to_world(body, at_body)))
        if body.b:
            axes = self._world_axes(body)
            body.position, body.velocity = body.places, body.speeds
            body.v = equations.rows([_dot([axis[i] for axis in axes], body.speeds) for i in range(3)])
        else:
            body.velocity = equations.rows(self._to_world(body, body.v))


# --------------------------------------------------------------------------------------- vectors of forms


def _sum(a: Three, b: Three) -> Three:
    return [x + y for x, y in zip(a, b, strict=True)]


def _difference(a: Three, b: Three) -> Three:
    return [x - y for x, y in zip(a, b, strict=True)]


def _dot(a: Three, b: Three) -> Form:
    first, *others = (x * y for x, y in zip(a, b, strict=True))
    return sum(others, first)


def _times(m: Vector, v: Three) -> Three:
    """M v, M constant."""
    return [v[0].by(m[i]) + v[1].by(m[i + 1]) + v[2].by(m[i + 2]) for i in (0, 3, 6)]


def _cross(a: Vector, v: Three) -> Three:
    """a x v, a constant."""
    return _times([Fraction(0), -a[2], a[1], a[2], Fraction(0), -a[0], -a[1], a[0], Fraction(0)], v)


def _cross_forms(a: Three, b: Three) -> Three:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def _arm(alpha: Three, squares: list[Three], r: Vector) -> Three:
    """alpha x r + omega x (omega x r), r constant; squares: omega_i omega_j."""
    length = squares[0][0] + squares[1][1] + squares[2][2]
    inward = [squares[i][0].by(r[0]) + squares[i][1].by(r[1]) + squares[i][2].by(r[2]) for i in range(3)]
    return [
        turning.by(-1) + along - length.by(part)
        for turning, along, part in zip(_cross(r, alpha), inward, r, strict=True)
    ]


def _crossed(m: list[Three]) -> Three:
    """omega x I omega, m[j] = I omega omega_j."""
    return [m[1][2] - m[2][1], m[2][0] - m[0][2], m[0][1] - m[1][0]]


def _product_of_quaternions(p: list[Form], q: list[Form]) -> list[Form]:
    """p q."""
    across = _cross_forms(p[1:], q[1:])
    return [
        p[0] * q[0] - _dot(p[1:], q[1:]),
        *(p[0] * y + q[0] * x + z for x, y, z in zip(p[1:], q[1:], across, strict=True)),
    ]


# ------------------------------------------------------------------------------------ rational constants

_IDENTITY: Vector = [_ONE, *[Fraction(0)] * 3]
_UNIT: Vector = fractions(np.eye(3))


def _first_row(body: _Body) -> int:
    rows = [*body.places, *body.turned, *body.speeds, *body.spins]
    return number(rows[0]) if rows else 0


def _turn(body: TreeBody) -> Vector:
    """Return the quaternion, of any norm, of the rotation from turned axes to body axes: e_z to the axis."""
    if not body.joint.of_kind.has_axis:
        return _IDENTITY
    x, y, z = axis = fractions(body.joint.axis)
    length = _root(dot(axis, axis))
    if z >= 0:
        return [length + z, -y, x, Fraction(0)]
    return [-y, length - z, Fraction(0), x]  # half a turn about e_x first, which avoids 0 at -e_z


def _root(square: Fraction) -> Fraction:
    """sqrt(square) to 2^-160, relative."""
    shift = 320 + 2 * abs(square.numerator.bit_length() - square.denominator.bit_length())
    return Fraction(isqrt((square.numerator << shift) // square.denominator), 1 << shift // 2)


def _unit(v: Vector) -> Vector:
    """v / |v| to 2^-160."""
    norm = _root(dot(v, v))
    return [x / norm for x in v]


def _product(a: Vector, b: Vector) -> Vector:
    """A B."""
    return [dot(a[3 * i : 3 * i + 3], b[j::3]) for i in range(3) for j in range(3)]


def _conjugate(q: Vector) -> Vector:
    return [q[0], -q[1], -q[2], -q[3]]


def _composed(p: Vector, q: Vector) -> Vector:
    """P q, the rotation by q, then by p."""
    a, b = p[1:], q[1:]
    across = cross(a, b)
    return [p[0] * q[0] - dot(a, b), *(p[0] * y + q[0] * x + z for x, y, z in zip(a, b, across, strict=True))]
