"""Trees in motion, to forty digits: bodies held together by forces, by their Taylor series in integers.

Each body has its own position, rotation matrix, velocity and omega, each joint a force and a moment at its
point; one linear system gives all accelerations. No equation, variable or code is bodycheck's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from operator import mul
from typing import Any

import numpy as np
from mpmath import mp, mpf

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.loads.kinds.torque import Torque
from bodycheck.reference_impl.trees.tree_scene import (
    BodyLoad,
    JointSineTorque,
    JointTorque,
    TreeScene,
    interval,
)
from tests.helpers.maximal_coordinates import _Bodies, _exact, _rotation, _unit

BITS = 190
ORDER = 40
_DIGITS = 62
_SMALL = 1e-45  # of the last terms
Fixed = list[int]  # a series, or the constant of one


def _fixed(x: Any) -> int:
    return int(mp.floor(mpf(x) * mpf(2) ** BITS + mpf("0.5")))


def _conv(a: Fixed, b: Fixed, k: int) -> int:
    """(a b)_k."""
    return sum(map(mul, a[: k + 1], b[k::-1])) >> BITS


def _scaled(c: int, x: int) -> int:
    return c * x >> BITS


@dataclass
class TreeSample:
    """position, velocity, omega (b, 3) and rotation (b, 9) of the bodies, q of hinges and slides, in mpf."""

    position: Any
    velocity: Any
    omega: Any
    rotation: Any
    q: dict[int, Any]


class _Body:
    def __init__(self, scene: TreeScene, i: int, bodies: _Bodies, velocity: Any, omega: Any) -> None:
        body, joint = scene.bodies[i], scene.bodies[i].joint
        rotation = bodies.rotation[i]
        self.kind, self.parent = joint.kind, joint.parent
        self.mass = _fixed(body.mass)
        self.inertia = [_fixed(x) for x in np.ravel(body.inertia)]
        self.at_body = [_fixed(x) for x in joint.at_body]
        self.at_parent = [_fixed(x) for x in joint.at_parent]
        axis = _unit(_exact(joint.axis)) if joint.kind in ("hinge", "slide") else _exact(np.zeros(3))
        self.axis = [_fixed(x) for x in axis]
        self.axis_above = [_fixed(x) for x in _rotation(_exact(joint.zero)) @ axis]
        self.stiffness, self.rest, self.damping = (
            _fixed(x) for x in (joint.stiffness, joint.rest, joint.damping)
        )
        self.x = [[_fixed(x)] for x in bodies.position[i]]
        self.v = [[_fixed(x)] for x in velocity[i]]
        self.r = [[_fixed(x)] for x in np.ravel(rotation)]
        self.w = [[_fixed(x)] for x in rotation.T @ omega[i]]
        self.q = [_fixed(joint.coordinates[0])] if joint.kind in ("hinge", "slide") else [0]
        self.u = [[_fixed(x)] for x in joint.rates] if joint.kind != "free" else []
        self.first = 0

    def series(self) -> list[Fixed]:
        return [*self.x, *self.v, *self.r, *self.w, self.q, *self.u]


class _System:
    """The equations of one step: rows of (unknown, series of its coefficient)."""

    def __init__(self, scene: TreeScene, bodies: list[_Body], t: Any) -> None:
        self.scene, self.bodies, self.t = scene, bodies, t
        count = 12 * len(bodies)
        for body in bodies:
            body.first, count = count, count + len(body.u)
        self.count = count
        self.made: list[tuple[Fixed, Any]] = []
        self._reaches: dict[int, list[Fixed]] = {}
        self.rows = list(self._rows())
        self.z: list[Fixed] = [[] for _ in range(count)]
        self.sines = []
        for load in scene.loads:
            if isinstance(load, JointSineTorque):
                phase = mpf(load.rate) * t + mpf(load.phase)
                self.sines.append((load, [_fixed(mp.sin(phase))], [_fixed(mp.cos(phase))]))

    # every coefficient is a constant, a component of R, a combination of such, or one times a slide's place

    def _combination(self, terms: Sequence[tuple[int, Fixed]]) -> Fixed:
        out: Fixed = []
        self.made.append((out, lambda k: sum(_scaled(c, s[k]) for c, s in terms if c)))
        return out

    def _product(self, a: Fixed, b: Fixed) -> Fixed:
        out: Fixed = []
        self.made.append((out, lambda k: _conv(a, b, k)))
        return out

    def _rows(self) -> Iterator[list[tuple[int, Fixed]]]:
        one = 1 << BITS
        for i, body in enumerate(self.bodies):
            a, alpha, f, m = (12 * i + 3 * part for part in range(4))
            children = [(c, child) for c, child in enumerate(self.bodies) if child.parent == i]
            reach = {c: self._reach(child) for c, child in children}
            for j in range(3):  # Newton, world axes
                yield [(a + j, [body.mass]), (f + j, [-one]), *((12 * c + 6 + j, [one]) for c, _ in children)]
            for j in range(3):  # Euler, body axes
                row = [(alpha + k, [body.inertia[3 * j + k]]) for k in range(3)]
                row += [(m + k, self._combination([(-one, body.r[3 * k + j])])) for k in range(3)]
                row += self._crossed(f, body, [[x] for x in body.at_body], j, -one)
                for c, _ in children:
                    row += [(12 * c + 9 + k, body.r[3 * k + j]) for k in range(3)]
                    row += self._crossed(12 * c + 6, body, reach[c], j, one)
                yield row
            yield from self._joint_rows(i, body, one)

    def _reach(self, child: _Body) -> list[Fixed]:
        """The joint's point of a child from the centre of its parent, in the parent's axes."""
        number = self.bodies.index(child)
        if number in self._reaches:
            return self._reaches[number]
        self._reaches[number] = made = self._made_reach(child)
        return made

    def _made_reach(self, child: _Body) -> list[Fixed]:
        if child.kind != "slide":
            return [[x] for x in child.at_parent]
        out: list[Fixed] = []
        for place, along in zip(child.at_parent, child.axis_above, strict=True):
            made: Fixed = []
            self.made.append(
                (made, lambda k, p=place, e=along: (p if k == 0 else 0) + _scaled(e, child.q[k]))
            )
            out.append(made)
        return out

    def _crossed(self, first: int, body: _Body, r: list[Fixed], j: int, sign: int) -> list[tuple[int, Fixed]]:
        """Component j of sign r x R^T f, f from unknown `first`."""
        b, c = (j + 1) % 3, (j + 2) % 3
        out = []
        for k in range(3):
            terms = [(r[b], body.r[3 * k + c], sign), (r[c], body.r[3 * k + b], -sign)]
            out.append((first + k, self._bilinear(terms)))
        return out

    def _bilinear(self, terms: list[tuple[Fixed, Fixed, int]]) -> Fixed:
        """The sum of sign a b; a may be a constant."""
        used = [(a, b, sign) for a, b, sign in terms if len(a) != 1 or a[0]]
        out: Fixed = []

        def value(k: int) -> int:
            return sum(_conv(a, b, k) if sign > 0 else -_conv(a, b, k) for a, b, sign in used)

        self.made.append((out, value))
        return out

    def _joint_rows(self, i: int, body: _Body, one: int) -> Iterator[list[tuple[int, Fixed]]]:
        """What the joint forbids of the accelerations, and its forces along its rates."""
        a, alpha, f, m = (12 * i + 3 * part for part in range(4))
        if body.kind == "free":
            yield from ([(place, [one])] for place in range(f, f + 6))
            return
        above = self.bodies[body.parent] if body.parent >= 0 else None
        reach = self._reach(body) if above else []
        for j in range(3):  # the joint's points, world axes
            row = [(a + j, [one]), *self._arm(alpha, body, [[x] for x in body.at_body], j, one)]
            if above:
                row.append((12 * body.parent + j, [-one]))
                row += self._arm(12 * body.parent + 3, above, reach, j, -one)
            if body.kind == "slide":
                row.append((body.first, self._along(above, body, j, -one)))
            yield row
        for j in range(3):  # angular accelerations, world axes
            row = [(alpha + k, body.r[3 * j + k]) for k in range(3)]
            if above:
                row += [
                    (12 * body.parent + 3 + k, self._combination([(-one, above.r[3 * j + k])]))
                    for k in range(3)
                ]
            if body.kind == "hinge":
                row.append((body.first, self._turned(body, body.axis, j, -one)))
            elif body.kind == "ball":
                row += [(body.first + k, self._combination([(-one, body.r[3 * j + k])])) for k in range(3)]
            yield row
        if body.kind == "ball":
            for j in range(3):
                yield [(m + k, body.r[3 * k + j]) for k in range(3)]
        else:
            first = f if body.kind == "slide" else m
            yield [(first + k, self._turned(body, body.axis, k, one)) for k in range(3)]

    def _turned(self, body: _Body, v: list[int], j: int, sign: int) -> Fixed:
        """Component j of sign R v, v constant."""
        return self._combination([(sign * c >> BITS, body.r[3 * j + k]) for k, c in enumerate(v)])

    def _along(self, above: _Body | None, body: _Body, j: int, sign: int) -> Fixed:
        """Component j of sign times the slide's axis in world axes."""
        if above is None:
            return [sign * body.axis_above[j] >> BITS]
        return self._turned(above, body.axis_above, j, sign)

    def _arm(self, first: int, body: _Body, r: list[Fixed], j: int, sign: int) -> list[tuple[int, Fixed]]:
        """Component j of sign R (alpha x r), alpha from unknown `first`."""
        out = []
        for k in range(3):  # alpha_k e_k x r = alpha_k (r_b e_c - r_c e_b) with b, c after k
            b, c = (k + 1) % 3, (k + 2) % 3
            terms = [(r[b], body.r[3 * j + c], sign), (r[c], body.r[3 * j + b], -sign)]
            out.append((first + k, self._bilinear(terms)))
        return out

    # ------------------------------------------------------------------------------------- right-hand sides

    def right_sides(self, k: int) -> list[int]:
        """The coefficients k of the right-hand sides, in the order of the rows."""
        out: list[int] = []
        pushes = self._pushes(k)
        for i, body in enumerate(self.bodies):
            force, torque, joint = pushes[i]
            momentum = [
                sum(_scaled(body.inertia[3 * j + c], body.w[c][k]) for c in range(3)) for j in range(3)
            ]
            body.momentum = [[*old[:k], new] for old, new in zip(body.momentum, momentum, strict=True)]
            spin = _crossed(body.w, body.momentum, k)
            out += force
            out += [t - s for t, s in zip(torque, spin, strict=True)]
            if body.kind == "free":
                out += [0] * 6
                continue
            above = self.bodies[body.parent] if body.parent >= 0 else None
            own = self._inward(body, [[x] for x in body.at_body], k, f"own{i}")
            points = [-x for x in self._in_world(body, own, k)]
            if above:
                reach = self._reaches[i]
                swept = self._inward(above, reach, k, f"above{i}")
                if body.kind == "slide":
                    along = [[x] for x in body.axis_above]
                    turned = _crossed_constant(above.w, along, k)
                    series = self._kept(f"turned{i}", turned, k)
                    swept_k = [2 * _conv(s, body.u[0], k) for s in series]
                    swept = self._kept(
                        f"swept{i}", [s[k] + x for s, x in zip(swept, swept_k, strict=True)], k
                    )
                points = [p + x for p, x in zip(points, self._in_world(above, swept, k), strict=True)]
            out += points
            relative = [0, 0, 0]
            if body.kind == "hinge":
                spin_series = self._kept(f"spin{i}", [_scaled(e, body.u[0][k]) for e in body.axis], k)
                relative = _crossed(body.w, spin_series, k)
            elif body.kind == "ball":
                relative = _crossed(body.w, body.u, k)
            turning = self._kept(f"turning{i}", relative, k)
            out += self._in_world(body, turning, k)
            out += joint
        return out

    def _kept(self, name: str, values: list[int], k: int) -> list[Fixed]:
        """Append coefficients k to named series, and return these."""
        series = self.named.setdefault(name, [[] for _ in values])
        for one, value in zip(series, values, strict=True):
            del one[k:]
            one.append(value)
        return series

    def _inward(self, body: _Body, r: list[Fixed], k: int, name: str) -> list[Fixed]:
        """omega x (omega x r) in body axes, as a series."""
        w = body.w
        along = self._kept(f"{name} w.r", [sum(_conv(r[j], w[j], k) for j in range(3))], k)[0]
        square = self._kept(f"{name} w.w", [sum(_conv(w[j], w[j], k) for j in range(3))], k)[0]
        return self._kept(name, [_conv(w[j], along, k) - _conv(r[j], square, k) for j in range(3)], k)

    def _in_world(self, body: _Body, v: list[Fixed], k: int) -> list[int]:
        return [sum(_conv(body.r[3 * j + c], v[c], k) for c in range(3)) for j in range(3)]

    def _pushes(self, k: int) -> list[tuple[list[int], list[int], list[int]]]:
        """Force in world axes, torque in body axes, and joint forces of each body, at order k."""
        out = []
        gravity = [_fixed(g) if k == 0 else 0 for g in self.scene.gravity]
        for body in self.bodies:
            joint = [-_scaled(body.damping, u[k]) for u in body.u]
            if body.kind in ("hinge", "slide"):
                joint[0] -= _scaled(body.stiffness, body.q[k] - (body.rest if k == 0 else 0))
            out.append(([_scaled(body.mass, g) for g in gravity], [0, 0, 0], joint))
        for load in self.scene.loads:
            force, torque, joint = out[load.body]
            body = self.bodies[load.body]
            if isinstance(load, JointSineTorque):
                continue
            if not interval(load)[0] <= self.t < interval(load)[1]:
                continue
            if isinstance(load, JointTorque):
                for j, x in enumerate(load.value):
                    joint[j] += _fixed(x) if k == 0 else 0
                continue
            assert isinstance(load, BodyLoad)
            value = [_fixed(x) for x in load.load.value]
            in_body = [x if k == 0 else 0 for x in value]
            in_world = in_body
            if load.load.axes == "world":
                in_body = [sum(_scaled(value[c], body.r[3 * c + j][k]) for c in range(3)) for j in range(3)]
            else:
                in_world = [sum(_scaled(value[c], body.r[3 * j + c][k]) for c in range(3)) for j in range(3)]
            if isinstance(load.load, Torque):
                for j in range(3):
                    torque[j] += in_body[j]
                continue
            at = [_fixed(x) for x in load.load.at]
            for j in range(3):
                b, c = (j + 1) % 3, (j + 2) % 3
                force[j] += in_world[j]
                torque[j] += _scaled(at[b], in_body[c]) - _scaled(at[c], in_body[b])
        for load, sine, _ in self.sines:
            out[load.body][2][0] += _scaled(_fixed(load.amplitude), sine[k])
        return out

    # ---------------------------------------------------------------------------------------------- orders

    def expand(self) -> None:
        """Fill all series to the order."""
        self.named: dict[str, list[Fixed]] = {}
        for body in self.bodies:
            body.momentum = [[], [], []]
        inverse: Any = None
        for k in range(ORDER):
            for out, value in self.made:
                out.append(value(k))
            if k == 0:
                self.now = [[(column, entry[0]) for column, entry in row if entry[0]] for row in self.rows]
                dense = np.zeros((self.count, self.count))
                for i, row in enumerate(self.now):
                    for column, entry in row:
                        dense[i, column] += float(mpf(entry) / mpf(2) ** BITS)
                inverse = np.linalg.inv(dense)
            right = self.right_sides(k)
            for i, row in enumerate(self.rows):
                right[i] -= (
                    sum(sum(map(mul, e[1 : k + 1], self.z[c][k - 1 :: -1])) for c, e in row if k) >> BITS
                )
            for one, value in zip(self.z, self._solved(inverse, right), strict=True):
                one.append(value)
            self._integrate(k)

    def _solved(self, inverse: Array, right: list[int]) -> list[int]:
        """Solve the constant equations by repeated correction in doubles."""
        x = [0] * self.count
        rest = right
        for _ in range(40):
            largest = max(map(abs, rest))
            if largest < 1 << 12:
                return x
            shift = max(largest.bit_length() - 60, 0)
            change = inverse @ np.array([float(r >> shift) for r in rest])
            step = [int(c) << shift for c in change]
            x = [a + b for a, b in zip(x, step, strict=True)]
            rest = [
                r - (sum(e * step[c] for c, e in row) >> BITS) for r, row in zip(rest, self.now, strict=True)
            ]
        raise ArithmeticError("the equations of a tree could not be solved")

    def _integrate(self, k: int) -> None:
        for i, body in enumerate(self.bodies):
            z = [self.z[12 * i + j][k] for j in range(6)]
            new_x = [v[k] // (k + 1) for v in body.v]
            turned = [0] * 9
            for j in range(3):  # R' = R [omega]x
                for c in range(3):
                    a, b = (c + 1) % 3, (c + 2) % 3
                    turned[3 * j + c] = _conv(body.r[3 * j + a], body.w[b], k) - _conv(
                        body.r[3 * j + b], body.w[a], k
                    )
            body.q.append(body.u[0][k] // (k + 1) if body.kind in ("hinge", "slide") else 0)
            for series, values in (
                (body.x, new_x),
                (body.v, [x // (k + 1) for x in z[:3]]),
                (body.r, [x // (k + 1) for x in turned]),
                (body.w, [x // (k + 1) for x in z[3:]]),
                (body.u, [self.z[body.first + j][k] // (k + 1) for j in range(len(body.u))]),
            ):
                for one, value in zip(series, values, strict=True):
                    one.append(value)
        for load, sine, cosine in self.sines:
            rate = _fixed(load.rate)
            new = _scaled(rate, cosine[k]) // (k + 1), -_scaled(rate, sine[k]) // (k + 1)
            sine.append(new[0])
            cosine.append(new[1])


def _crossed(a: list[Fixed], b: list[Fixed], k: int) -> list[int]:
    return [
        _conv(a[(j + 1) % 3], b[(j + 2) % 3], k) - _conv(a[(j + 2) % 3], b[(j + 1) % 3], k) for j in range(3)
    ]


def _crossed_constant(a: list[Fixed], b: list[Fixed], k: int) -> list[int]:
    return [
        _conv(b[(j + 2) % 3], a[(j + 1) % 3], k) - _conv(b[(j + 1) % 3], a[(j + 2) % 3], k) for j in range(3)
    ]


def tree_samples(scene: TreeScene, t_s: Sequence[float]) -> list[TreeSample]:
    """Return the motion at ascending times, from the start as exact doubles."""
    with mp.workdps(_DIGITS):
        exact = _exact(scene.q0), _exact(scene.u0)
        places = _Bodies(scene, exact[0])
        velocity, omega = places.velocities(exact[1])
        bodies = [_Body(scene, i, places, velocity, omega) for i in range(len(scene.bodies))]
        out: list[TreeSample] = []
        due = list(t_s)
        edges = [mpf(0), *map(mpf, scene.switches_before(float(t_s[-1]))), mpf(t_s[-1])]
        for begin, end in pairwise(edges):
            t = begin
            while t < end or (due and due[0] == t):
                if due and due[0] == t:
                    out.append(_sample(bodies))
                    due.pop(0)
                    continue
                system = _System(scene, bodies, t)
                system.expand()
                series = [one for body in bodies for one in body.series()]
                last = max(
                    (mpf(max(abs(s[k]) for s in series)) / mpf(2) ** BITS) ** (mpf(1) / k)
                    for k in (ORDER - 1, ORDER)
                )
                step = mpf(_SMALL) ** (mpf(1) / ORDER) / last if last else end - t
                after = min(end, t + step, *(mpf(d) for d in due[:1] if d > t))
                _advance(bodies, after - t)
                t = after
        return out


def _advance(bodies: list[_Body], h: Any) -> None:
    step = _fixed(h)
    for body in bodies:
        for series in body.series():
            total = 0
            for c in reversed(series):
                total = c + (total * step >> BITS)
            series[:] = [total]


def _sample(bodies: list[_Body]) -> TreeSample:
    def numbers(part: str) -> Any:
        return np.array(
            [[mpf(s[0]) / mpf(2) ** BITS for s in getattr(body, part)] for body in bodies], dtype=object
        )

    scalars = {
        i: mpf(body.q[0]) / mpf(2) ** BITS for i, body in enumerate(bodies) if body.kind in ("hinge", "slide")
    }
    return TreeSample(numbers("x"), numbers("v"), numbers("w"), numbers("r"), scalars)
