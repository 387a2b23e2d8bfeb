"""Steps on the rotation group: Runge-Kutta-Munthe-Kaas, Crouch-Grossman, Buss, SPIRAL, splittings."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from bodycheck.reference_impl.arrays import Array, solved
from bodycheck.reference_impl.one_step_maps.first_order import CARRIED, Carried, gyroscopic
from bodycheck.reference_impl.one_step_maps.one_step_map import (
    Loads,
    Motion,
    OneStepMap,
    Solid,
    back,
    rotated,
    times,
    weighted_sum,
)
from bodycheck.reference_impl.one_step_maps.tableaus import CROUCH_GROSSMAN_3, EXPLICIT, NamedTableau
from bodycheck.reference_impl.rotations import (
    cross,
    exp_quaternion,
    hat,
    quaternion_product,
    quaternion_to_matrix,
)

_DIFFERENCE = 1e-7  # rad, of a derivative for Newton's iterations

Correction: TypeAlias = Literal["none", "first", "second", "exact", "products"]


def inverse_dexp(u: Array, omega: Array, correction: Correction) -> Array:
    """u' with (exp u)' = exp(u) omega: omega + u x omega / 2 + c u x (u x omega), Bortz (1971)."""
    if correction == "none":
        return omega
    bracket = cross(u, omega)
    first = omega + 0.5 * bracket
    if correction == "first":
        return first
    if correction == "second":
        return first + cross(u, bracket) / 12.0
    angle = np.linalg.norm(u, axis=-1, keepdims=True)
    small = angle < 0.05
    safe = np.where(small, 1.0, angle)
    closed = (1.0 - 0.5 * safe / np.tan(0.5 * safe)) / (safe * safe)
    square = angle * angle
    series = 1.0 / 12.0 + square / 720.0 + square**2 / 30240.0 + square**3 / 1209600.0
    return first + np.where(small, series, closed) * cross(u, bracket)


def _carried_of(solid: Solid, carried: Carried, motion: Motion, rotation: Array) -> Array:
    if carried == "body":
        return motion.omega
    if carried == "world":
        return times(rotation, motion.omega)
    return times(rotation, times(solid.inertia, motion.omega))


def _omega_of(solid: Solid, carried: Carried, spin: Array, rotation: Array) -> Array:
    """omega (n, 3) in body axes."""
    if carried == "body":
        return spin
    inward = back(rotation, spin)
    return inward if carried == "world" else times(solid.inverse, inward)


def _carried_rate(solid: Solid, carried: Carried, omega: Array, torque: Array, rotation: Array) -> Array:
    """The rate of what is carried; torque (n, 3) in body axes."""
    if carried == "momentum":
        return times(rotation, torque)
    rate = times(solid.inverse, torque - gyroscopic(solid, omega))
    return rate if carried == "body" else times(rotation, rate)


@dataclass(frozen=True)
class _LieRungeKutta:
    """A tableau on R^9 for x, v and the spin, and on the rotation group for the attitude."""

    tableau: NamedTableau
    carried: Carried
    correction: Correction

    def __call__(self, solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
        h = np.asarray(dt)[..., None]
        rotation = motion.orthogonal
        spin = _carried_of(solid, self.carried, motion, rotation)
        flat = np.concatenate([motion.position, motion.velocity, spin], axis=-1)
        rates: list[Array] = []
        angle_rates: list[Array] = []
        for row, c in zip(self.tableau.a, self.tableau.c, strict=True):
            y = flat + h * weighted_sum(row, rates, flat)
            u = h * weighted_sum(row, angle_rates, spin)
            q = self._attitude(motion.quaternion, row, angle_rates, u, h)
            at = quaternion_to_matrix(q)
            omega = _omega_of(solid, self.carried, y[..., 6:], at)
            force, torque = loads(
                motion.t + c * np.asarray(dt), y[..., :3], at, y[..., 3:6], times(at, omega)
            )
            carried_rate = _carried_rate(solid, self.carried, omega, torque, at)
            rates.append(np.concatenate([y[..., 3:6], force / solid.mass[..., None], carried_rate], axis=-1))
            angle_rates.append(
                omega if self.correction == "products" else inverse_dexp(u, omega, self.correction)
            )
        end = flat + h * weighted_sum(self.tableau.b, rates, flat)
        u = h * weighted_sum(self.tableau.b, angle_rates, spin)
        q = self._attitude(motion.quaternion, self.tableau.b, angle_rates, u, h)
        omega = _omega_of(solid, self.carried, end[..., 6:], quaternion_to_matrix(q))
        return Motion(
            t=motion.t + np.asarray(dt),
            position=end[..., :3],
            velocity=end[..., 3:6],
            quaternion=q,
            omega=omega,
        )

    def _attitude(self, q: Array, weights: Array, angle_rates: list[Array], u: Array, h: Array) -> Array:
        if self.correction != "products":
            return rotated(q, u)
        for weight, angle_rate in zip(weights, angle_rates, strict=False):
            if weight != 0.0:
                q = rotated(q, h * weight * angle_rate)
        return q


_CORRECTIONS: dict[Correction, tuple[str, str, str]] = {
    "none": (
        "on the rotation group, stages averaged",
        "q+ = q exp(dt sum b_i omega_i / 2), of order 2 at most",
        "MuJoCo RK4 before 4.0, Pinocchio's integrate in a Runge-Kutta loop",
    ),
    "first": (
        "Munthe-Kaas, one commutator",
        "q+ = q exp(dt sum b_i k_i / 2), k_i = omega_i + u_i x omega_i / 2, u_i = dt sum a_ij k_j",
        "Munthe-Kaas (1998), BIT 38, 92",
    ),
    "second": (
        "Munthe-Kaas, two commutators",
        "as with one commutator, k_i with + u_i x (u_i x omega_i) / 12",
        "Munthe-Kaas (1999), Appl. Numer. Math. 29, 115",
    ),
    "exact": (
        "Munthe-Kaas",
        "as with one commutator, k_i by the inverse of the derivative of exp in closed form",
        "Munthe-Kaas (1999), Appl. Numer. Math. 29, 115; Bortz (1971)",
    ),
    "products": (
        "Crouch-Grossman products",
        "q+ = q exp(dt b_1 omega_1 / 2) exp(dt b_2 omega_2 / 2) ...",
        "Crouch and Grossman (1993), J. Nonlinear Sci. 3, 1",
    ),
}
_ORDERS: dict[Correction, int] = {"none": 2, "first": 3, "second": 5, "exact": 8, "products": 2}


def lie_group_maps() -> Iterator[OneStepMap]:
    """Yield every map of this module."""
    for tableau in EXPLICIT:
        for carried, axes in CARRIED.items():
            for correction, (words, formula, source) in _CORRECTIONS.items():
                if tableau.name == "midpoint" and correction == "products":
                    continue  # with one factor per product, the same as without correction
                yield OneStepMap(
                    f"{tableau.name} {words}{axes}",
                    f"{formula}; the tableau of {tableau.source} for x, v and the spin",
                    source,
                    min(tableau.order, _ORDERS[correction]),
                    _LieRungeKutta(tableau, carried, correction),
                    stages=True,
                )
    for carried, axes in CARRIED.items():
        yield OneStepMap(
            f"CG3{axes}",
            "Crouch-Grossman products of order 3",
            CROUCH_GROSSMAN_3.source,
            3,
            _LieRungeKutta(CROUCH_GROSSMAN_3, carried, "products"),
            stages=True,
        )
    yield from _single_maps()


def _commutator_free(solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
    h = np.asarray(dt)[..., None]
    q, x, v = motion.quaternion, motion.position, motion.velocity
    momentum = _carried_of(solid, "momentum", motion, motion.orthogonal)

    def rates(
        share: float, attitude: Array, at: Array, speed: Array, spin: Array
    ) -> tuple[Array, Array, Array]:
        rotation = quaternion_to_matrix(attitude)
        omega = _omega_of(solid, "momentum", spin, rotation)
        force, torque = loads(motion.t + share * np.asarray(dt), at, rotation, speed, times(rotation, omega))
        return omega, times(rotation, torque), force / solid.mass[..., None]

    w1, t1, a1 = rates(0.0, q, x, v, momentum)
    q2 = rotated(q, 0.5 * h * w1)
    v2 = v + 0.5 * h * a1
    w2, t2, a2 = rates(0.5, q2, x + 0.5 * h * v, v2, momentum + 0.5 * h * t1)
    v3 = v + 0.5 * h * a2
    w3, t3, a3 = rates(0.5, rotated(q, 0.5 * h * w2), x + 0.5 * h * v2, v3, momentum + 0.5 * h * t2)
    v4 = v + h * a3
    w4, t4, a4 = rates(1.0, rotated(q2, h * (w3 - 0.5 * w1)), x + h * v3, v4, momentum + h * t3)
    q = rotated(q, h * (3.0 * w1 + 2.0 * w2 + 2.0 * w3 - w4) / 12.0)
    q = rotated(q, h * (-w1 + 2.0 * w2 + 2.0 * w3 + 3.0 * w4) / 12.0)
    momentum = momentum + h * (t1 + 2.0 * t2 + 2.0 * t3 + t4) / 6.0
    return Motion(
        t=motion.t + np.asarray(dt),
        position=x + h * (v + 2.0 * v2 + 2.0 * v3 + v4) / 6.0,
        velocity=v + h * (a1 + 2.0 * a2 + 2.0 * a3 + a4) / 6.0,
        quaternion=q,
        omega=_omega_of(solid, "momentum", momentum, quaternion_to_matrix(q)),
    )


@dataclass(frozen=True)
class _Buss:
    """R+ = exp(dt w) R, w the mean omega of the Taylor series; L+ = L + dt tau, omega+ = I(R+)^-1 L+.

    In world axes w = omega + dt omega' / 2 (+ dt^2 / 12 omega' x omega where augmented) + dt^2 / 6 omega''
    (+ dt^3 / 24 (omega''' + omega'' x omega) at the fourth order), under a torque held in world axes.
    """

    terms: int
    augmented: bool = True

    def __call__(self, solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
        h = np.asarray(dt)[..., None]
        rotation = motion.orthogonal
        omega = times(rotation, motion.omega)
        force, torque_body = loads(motion.t, motion.position, rotation, motion.velocity, omega)
        torque = times(rotation, torque_body)
        momentum = times(rotation, times(solid.inertia, motion.omega))
        tensor = rotation @ solid.inertia @ np.swapaxes(rotation, -1, -2)
        inverse = rotation @ solid.inverse @ np.swapaxes(rotation, -1, -2)
        # in world axes I' = [omega]x I - I [omega]x; differentiate I omega' = tau - omega x L, L' = tau
        first = times(inverse, torque - cross(omega, momentum))
        mean = omega + 0.5 * h * first
        if self.augmented:
            mean = mean + h * h * cross(first, omega) / 12.0
        if self.terms >= 3:
            bending = cross(omega, times(tensor, first)) - times(tensor, cross(omega, first))
            second = times(inverse, -cross(first, momentum) - cross(omega, torque) - bending)
            mean = mean + h * h * second / 6.0
        if self.terms >= 4:
            mean = mean + h**3 * (self._third(tensor, inverse, omega, torque) + cross(second, omega)) / 24.0
        q = quaternion_product(exp_quaternion(h * mean), motion.quaternion)
        momentum = momentum + h * torque
        velocity = motion.velocity + h * force / solid.mass[..., None]
        return Motion(
            t=motion.t + np.asarray(dt),
            position=motion.position + 0.5 * h * (motion.velocity + velocity),
            velocity=velocity,
            quaternion=q,
            omega=_omega_of(solid, "momentum", momentum, quaternion_to_matrix(q)),
        )

    @staticmethod
    def _third(tensor: Array, inverse: Array, omega: Array, torque: Array) -> Array:
        """omega''' in world axes under a constant torque, from the derivatives of I and L'' = 0."""
        w0 = omega
        i0 = tensor
        k0 = hat(w0)
        i1 = k0 @ i0 - i0 @ k0
        w1 = times(inverse, torque - times(i1, w0))
        k1 = hat(w1)
        i2 = k1 @ i0 - i0 @ k1 + k0 @ i1 - i1 @ k0
        w2 = times(inverse, -2.0 * times(i1, w1) - times(i2, w0))
        k2 = hat(w2)
        i3 = k2 @ i0 - i0 @ k2 + 2.0 * (k1 @ i1 - i1 @ k1) + k0 @ i2 - i2 @ k0
        return times(inverse, -3.0 * times(i1, w2) - 3.0 * times(i2, w1) - times(i3, w0))


def _ssp_spin(solid: Solid, omega: Array, torque: Array, h: Array) -> Array:
    """omega after h by the SSP RK3 under a constant torque in body axes."""
    k1 = h * times(solid.inverse, torque - gyroscopic(solid, omega))
    k2 = h * times(solid.inverse, torque - gyroscopic(solid, omega + k1))
    k3 = h * times(solid.inverse, torque - gyroscopic(solid, omega + 0.25 * (k1 + k2)))
    return omega + (k1 + k2 + 4.0 * k3) / 6.0


def _spiral(solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
    """q+ = q exp(dt omega / 2) exp(dt^2 omega' / 4), omega by SSP RK3."""
    h, rotation = np.asarray(dt)[..., None], motion.orthogonal
    force, torque = loads(motion.t, motion.position, rotation, motion.velocity, times(rotation, motion.omega))
    rate = times(solid.inverse, torque - gyroscopic(solid, motion.omega))
    q = rotated(rotated(motion.quaternion, h * motion.omega), 0.5 * h * h * rate)
    velocity = motion.velocity + h * force / solid.mass[..., None]
    return Motion(
        t=motion.t + np.asarray(dt),
        position=motion.position + h * velocity,
        velocity=velocity,
        quaternion=q,
        omega=_ssp_spin(solid, motion.omega, torque, h),
    )


def _verlet_spiral(solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
    """omega over dt / 2 by SSP RK3, q+ = q exp(dt omega / 2), omega over dt / 2 under the loads there."""
    h, rotation = np.asarray(dt)[..., None], motion.orthogonal
    force, torque = loads(motion.t, motion.position, rotation, motion.velocity, times(rotation, motion.omega))
    omega = _ssp_spin(solid, motion.omega, torque, 0.5 * h)
    middle = motion.velocity + 0.5 * h * force / solid.mass[..., None]
    position, q = motion.position + h * middle, rotated(motion.quaternion, h * omega)
    end_rotation = quaternion_to_matrix(q)
    force, torque = loads(
        motion.t + np.asarray(dt), position, end_rotation, middle, times(end_rotation, omega)
    )
    return Motion(
        t=motion.t + np.asarray(dt),
        position=position,
        velocity=middle + 0.5 * h * force / solid.mass[..., None],
        quaternion=q,
        omega=_ssp_spin(solid, omega, torque, 0.5 * h),
    )


def _moser_veselov(solid: Solid, quaternion: Array, momentum: Array, h: Array) -> tuple[Array, Array]:
    """F J - J F^T = h [m]x, m+ = F^T m, R+ = R F; J = tr(I) / 2 - I.

    With F = exp(f): sin|f| / |f| I f + (1 - cos|f|) / |f|^2 f x I f = h m, solved by Newton's iterations with
    a derivative by differences.
    """
    f = h * times(solid.inverse, momentum)
    for _ in range(12):
        value = _discrete_momentum(solid, f)
        columns = [
            (_discrete_momentum(solid, f + axis) - _discrete_momentum(solid, f - axis)) / (2.0 * _DIFFERENCE)
            for axis in np.eye(3) * _DIFFERENCE
        ]
        f = f - solved(np.stack(columns, axis=-1), value - h * momentum)
    return rotated(quaternion, f), back(quaternion_to_matrix(exp_quaternion(f)), momentum)


def _discrete_momentum(solid: Solid, f: Array) -> Array:
    angle = np.linalg.norm(f, axis=-1, keepdims=True)
    safe = np.where(angle > 0.0, angle, 1.0)
    sine = np.where(angle > 0.0, np.sin(safe) / safe, 1.0)
    rest = np.where(angle > 0.0, 0.5 * (np.sin(0.5 * safe) / (0.5 * safe)) ** 2, 0.5)
    inertia_f = times(solid.inertia, f)
    return sine * inertia_f + rest * cross(f, inertia_f)


@dataclass(frozen=True)
class _Kicked:
    """Half a kick by the loads, the free rotation by `drift`, and another half kick."""

    drift: Callable[[Solid, Array, Array, Array], tuple[Array, Array]]

    def __call__(self, solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
        h, rotation = np.asarray(dt)[..., None], motion.orthogonal
        force, torque = loads(
            motion.t, motion.position, rotation, motion.velocity, times(rotation, motion.omega)
        )
        momentum = times(solid.inertia, motion.omega) + 0.5 * h * torque
        middle = motion.velocity + 0.5 * h * force / solid.mass[..., None]
        position = motion.position + h * middle
        q, momentum = self.drift(solid, motion.quaternion, momentum, h)
        end_rotation = quaternion_to_matrix(q)
        omega = times(solid.inverse, momentum)
        force, torque = loads(
            motion.t + np.asarray(dt), position, end_rotation, middle, times(end_rotation, omega)
        )
        return Motion(
            t=motion.t + np.asarray(dt),
            position=position,
            velocity=middle + 0.5 * h * force / solid.mass[..., None],
            quaternion=q,
            omega=times(solid.inverse, momentum + 0.5 * h * torque),
        )


@dataclass(frozen=True)
class _PrincipalRotations:
    """Rotate about principal axes at the rate m_i / I_i, half a step about the first two on either side."""

    axes: tuple[int, int, int]

    def __call__(self, solid: Solid, q: Array, momentum: Array, h: Array) -> tuple[Array, Array]:
        moments, frame = solid.principal
        i, j, k = self.axes
        for axis, share in ((i, 0.5), (j, 0.5), (k, 1.0), (j, 0.5), (i, 0.5)):
            direction = np.broadcast_to(frame[..., axis], momentum.shape)
            rate = np.sum(direction * momentum, axis=-1, keepdims=True) / moments[..., axis, None]
            q, momentum = _rotated_about(q, momentum, share * h * rate * direction)
        return q, momentum


@dataclass(frozen=True)
class _SymmetricTop:
    """The free motion of the body with its middle moment made equal to another, and rotations for the rest.

    about: the principal axis of the symmetric part; the excess rotates about the axis `rest`.
    """

    about: int
    rest: int

    def __call__(self, solid: Solid, q: Array, momentum: Array, h: Array) -> tuple[Array, Array]:
        moments, frame = solid.principal
        equal = 3 - self.about - self.rest
        excess = 1.0 / moments[..., self.rest] - 1.0 / moments[..., equal]
        spin = 1.0 / moments[..., self.about] - 1.0 / moments[..., equal]
        q, momentum = self._about_axis(q, momentum, frame, self.rest, 0.5 * h * excess[..., None])
        # exp(dt L / I) about the fixed L, then the spin about the axis of symmetry
        q, momentum = _rotated_about(q, momentum, h * momentum / moments[..., equal, None])
        q, momentum = self._about_axis(q, momentum, frame, self.about, h * spin[..., None])
        return self._about_axis(q, momentum, frame, self.rest, 0.5 * h * excess[..., None])

    @staticmethod
    def _about_axis(q: Array, momentum: Array, frame: Array, axis: int, scale: Array) -> tuple[Array, Array]:
        direction = np.broadcast_to(frame[..., axis], momentum.shape)
        along = np.sum(direction * momentum, axis=-1, keepdims=True)
        return _rotated_about(q, momentum, scale * along * direction)


def _rotated_about(q: Array, momentum: Array, angle: Array) -> tuple[Array, Array]:
    increment = exp_quaternion(angle)
    return quaternion_product(q, increment), back(quaternion_to_matrix(increment), momentum)


def _composed_splitting(solid: Solid, motion: Motion, dt: Array, loads: Loads) -> Motion:
    """Blanes and Moan's S10 of order 6, with the drifts split as in integrators/splitting.py."""
    from bodycheck.reference_impl.integrators.splitting import DRIFTS, FIRST_PARTS, KICKS

    h = np.asarray(dt)[..., None]
    moments, frame = solid.principal
    middle = 1.0 / moments[..., 1, None]
    excess = {axis: 1.0 / moments[..., axis, None] - middle for axis in (0, 2)}
    q, x, v, t = motion.quaternion, motion.position, motion.velocity, motion.t
    rotation = motion.orthogonal
    momentum = times(rotation, times(solid.inertia, motion.omega))
    for i, kick in enumerate(KICKS):
        omega = _omega_of(solid, "momentum", momentum, rotation)
        force, torque = loads(t, x, rotation, v, times(rotation, omega))
        v = v + h * kick * force / solid.mass[..., None]
        momentum = momentum + h * kick * times(rotation, torque)
        if i == len(DRIFTS):
            break
        drift, first = DRIFTS[i], FIRST_PARTS[i]
        inward = back(rotation, momentum)
        q, inward = _rotated_about(q, inward, h * drift * middle * inward)
        for axis, share in ((0, first), (2, drift), (0, drift - first)):
            q, inward = _SymmetricTop._about_axis(q, inward, frame, axis, h * share * excess[axis])
        x = x + h * drift * v
        t = t + np.asarray(dt) * drift
        rotation = quaternion_to_matrix(q)
    return Motion(
        t=motion.t + np.asarray(dt),
        position=x,
        velocity=v,
        quaternion=q,
        omega=_omega_of(solid, "momentum", momentum, rotation),
    )


def _single_maps() -> Iterator[OneStepMap]:
    yield OneStepMap(
        "CF4",
        "q+ = q exp(dt (3k1 + 2k2 + 2k3 - k4) / 12) exp(dt (-k1 + 2k2 + 2k3 + 3k4) / 12), L+ by RK4",
        "Celledoni, Marthinsen and Owren (2003), FGCS 19, 341",
        4,
        _commutator_free,
        stages=True,
    )
    source = "Buss (2000), J. Comput. Phys. 164, 377"
    for name, terms, augmented in (
        ("Buss 2000, order 2", 2, False),
        ("Buss 2000, order 2 augmented", 2, True),
        ("Buss 2000, order 3", 3, True),
        ("Buss 2000, order 4", 4, True),
    ):
        formula = "R+ = exp(dt w) R, w the mean omega to this order under a constant torque; L+ = L + dt tau"
        yield OneStepMap(name, formula, source, terms, _Buss(terms, augmented))
    source = "del Valle, Angelidakis, Roy, Munoz and Poschel (2023), Comput. Phys. Commun., 109077"
    formula = "q+ = q exp(dt omega / 2) exp(dt^2 omega' / 4), omega+ by SSP RK3"
    yield OneStepMap("SPIRAL", formula, source, 2, _spiral)
    formula = "omega(dt/2) by SSP RK3, q+ = q exp(dt omega(dt/2) / 2), omega+ by SSP RK3 from omega(dt/2)"
    yield OneStepMap("SPIRAL, velocity Verlet", formula, source, 2, _verlet_spiral, stages=True)
    yield OneStepMap(
        "Moser-Veselov",
        "F J - J F^T = dt [L]x, L+ = F^T L, R+ = R F; L = I omega in body axes, J = tr(I) / 2 - I",
        "Moser and Veselov (1991), Commun. Math. Phys. 139, 217; loads as Lee, Leok and McClamroch (2007)",
        2,
        _Kicked(_moser_veselov),
        aliases=("Lie group variational integrator", "RATTLE on SO(3)"),
        reversible=True,
        stages=True,
    )
    for i, j, k in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        yield OneStepMap(
            f"splitting by principal rotations {i + 1}-{j + 1}-{k + 1}",
            "rotations about principal axes at L_i / I_i, symmetrically composed; moments ascending",
            "McLachlan (1993), Phys. Rev. Lett. 71, 3043; Dullweber, Leimkuhler and McLachlan (1997)",
            2,
            _Kicked(_PrincipalRotations((i, j, k))),
            reversible=True,
            stages=True,
        )
    for about in range(3):
        for rest in range(3):
            if rest != about:
                yield OneStepMap(
                    f"symmetric-top splitting {about + 1}, rest {rest + 1}",
                    "the exact motion of a symmetric top between half rotations about one principal axis",
                    "Touma and Wisdom (1994), Astron. J. 107, 1189",
                    2,
                    _Kicked(_SymmetricTop(about, rest)),
                    reversible=True,
                    stages=True,
                )
    yield OneStepMap(
        "splitting6",
        "kicks by the loads and drifts of the free body, itself split; S10 of order 6",
        "Blanes and Moan (2002), J. Comput. Appl. Math. 142, 313; Touma and Wisdom (1994)",
        6,
        _composed_splitting,
        reversible=True,
        stages=True,
    )
