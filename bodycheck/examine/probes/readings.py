"""Consistency of the readings of a motion: omega with the attitude, velocity with the position.

Between two samples, h apart, log(q_k^-1 q_k+1) / h is the mean of omega_k and omega_k+1 up to O(h), for any
method, and (x_k+1 - x_k) / h is the mean of v_k and v_k+1.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from bodycheck.examine.probes.finding import Finding, FindingLimit, Sampled, delay_finding, limit, noise
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_momentum, rotational_energy
from bodycheck.reference_impl.rotations import (
    conjugate,
    log_quaternion,
    matrix_to_quaternion,
    project_to_so3,
    quaternion_product,
)
from bodycheck.reference_impl.trajectory import Trajectory

_UNIT = 1e-12  # an attitude with a larger error is not normalised after each step


def reading_findings(motions: Sequence[Sampled], resolution: float) -> Iterator[Finding]:
    """Yield whether the readings of one free motion are consistent, and what the motion conserves.

    motions: of one scene, coarsest step first. resolution: relative, of the states after all steps.
    """
    yield from _omega_findings(motions, resolution)
    yield from _velocity_findings(motions, resolution)
    yield from _conserved(motions, resolution)
    yield from _attitude_findings(motions, resolution)


def _omega_findings(motions: Sequence[Sampled], resolution: float) -> Iterator[Finding]:
    delays = []
    for axes in ("body", "world"):
        readings = [getattr(motion.trajectory, f"omega_{axes}_rad_s") for motion in motions]
        if readings[0] is None:
            continue
        rates = [turning(motion.trajectory, axes, motion.dt_s) for motion in motions]
        found = _Agreement(motions, rates, readings, resolution, 1.0)
        yield found.reading(f"omega_{axes}_reading", "omega is not the derivative of the attitude")
        delays.append(found.delay("attitude_delay", "the attitude is read"))
    yield delays[0]
    if len(delays) > 1:
        yield _omega_world_delay(motions[-1])


def _omega_world_delay(motion: Sampled) -> Finding:
    """Return by how many steps omega in world axes lags behind that in body axes.

    They differ by h R omega' per step; of a free body, omega' = -I^-1 (omega x I omega) in body axes.
    """
    path, inertia = motion.trajectory, motion.scene.body.inertia
    assert path.omega_world_rad_s is not None
    omega, rotation = path.omega_body[-1], path.rotation_matrices[-1]
    per_step = motion.dt_s * rotation @ np.linalg.solve(inertia, np.cross(inertia @ omega, omega))
    return _lag(
        "omega_world_delay",
        path.omega_world_rad_s[-1] - rotation @ omega,
        per_step,
        "compared with omega in body axes, omega in world axes is read",
    )


def _lag(check: str, difference: Array, per_step: Array, late: str) -> Finding:
    """Return how many steps a reading lags behind another: their difference (3,) over that per step."""
    return delay_finding(check, -float(difference @ per_step / (per_step @ per_step)), late)


def _velocity_findings(motions: Sequence[Sampled], resolution: float) -> Iterator[Finding]:
    paths = [motion.trajectory for motion in motions]
    rates = [np.diff(m.trajectory.position_m, axis=0) / m.dt_s for m in motions]
    farthest = float(np.max(np.abs(paths[-1].position_m)))
    found = _Agreement(motions, rates, [path.velocity_m_s for path in paths], resolution, farthest)
    yield found.reading("velocity_reading", "the velocity is not the derivative of the position")
    yield found.delay("position_delay", "the position is read")


def turning(path: Trajectory, axes: str, dt_s: float) -> Array:
    """log(q_k^-1 q_k+1) / h in body axes, log(q_k+1 q_k^-1) / h in world axes: (n - 1, 3) in rad/s."""
    before, after = path.attitude[:-1], path.attitude[1:]
    pair = (conjugate(before), after) if axes == "body" else (after, conjugate(before))
    return log_quaternion(quaternion_product(*pair)) / dt_s


class _Agreement:
    """The mismatch between a derivative and its reading, over the largest reading, at several steps.

    Values are means over cells, where a cell is one coarsest step and holds several finer ones.
    """

    def __init__(
        self,
        motions: Sequence[Sampled],
        rates: Sequence[Array],
        readings: Sequence[Array],
        resolution: float,
        largest_state: float,
    ) -> None:
        """rates (n, 3): derivatives of a state between samples; held (n + 1, 3): readings at the samples."""
        self._cells = len(rates[0])
        self._steps_s = [motion.dt_s for motion in motions]
        scale = np.max(np.linalg.norm(readings[-1], axis=-1))  # not float(): readings of zero must give NaN
        mismatches = [
            (rate - 0.5 * (read[:-1] + read[1:])) / scale for rate, read in zip(rates, readings, strict=True)
        ]
        self._mismatches = [self._in_cells(mismatch) for mismatch in mismatches]
        self._per_cell = len(rates[-1]) // self._cells
        self._start = readings[-1][0] / scale
        resolved = resolution * (1.0 + largest_state / (scale * motions[0].scene.duration_s))
        self._round_off = noise(mismatches[-1]) + resolved

    def _in_cells(self, values: Array) -> Array:
        return np.asarray(values.reshape(self._cells, -1, 3).mean(axis=1))

    @property
    def _limit(self) -> FindingLimit:
        return limit(self._steps_s, self._mismatches, self._round_off)

    def reading(self, check: str, wrong: str) -> Finding:
        """Return the limit of the mismatch over the largest reading."""
        return self._limit.finding(check, wrong)

    def delay(self, check: str, late: str) -> Finding:
        """Return by how many steps the state lags behind the motion that its derivative describes.

        A state that lags by k steps loses k h times the derivative once, at the start. Relative to a mean
        over n steps that is k / n.
        """
        difference = self._limit.value[0] - self._mismatches[-1][0]
        return delay_finding(
            check, self._per_cell * float(difference @ self._start / (self._start @ self._start)), late
        )


def _conserved(motions: Sequence[Sampled], resolution: float) -> Iterator[Finding]:
    """Yield the changes of what a free body conserves: L in world axes, and 1/2 omega . I omega."""
    inertia = motions[0].scene.body.inertia
    momenta, energies = [], []
    for motion in motions:
        path = motion.trajectory
        momenta.append(angular_momentum(path.rotation_matrices, inertia, path.omega_body))
        energies.append(rotational_energy(inertia, path.omega_body)[:, np.newaxis])
    text = "angular momentum is not conserved without a torque"
    yield _change("angular_momentum_change", motions, momenta, resolution, text)
    text = "rotational energy is not conserved without a torque"
    yield _change("rotational_energy_change", motions, energies, resolution, text)


def _change(
    check: str, motions: Sequence[Sampled], series: Sequence[Array], resolution: float, wrong: str
) -> Finding:
    cells = len(motions[0].trajectory.t_s) - 1
    scale = np.linalg.norm(series[-1][0])
    changes = [(s - s[0])[:: (len(s) - 1) // cells][1:] / scale for s in series]
    round_off = float(np.maximum(resolution, len(series[-1]) * noise(series[-1]) / scale))
    return limit([m.dt_s for m in motions], changes, round_off).finding(check, wrong)


def _attitude_findings(motions: Sequence[Sampled], resolution: float) -> Iterator[Finding]:
    paths = [motion.trajectory for motion in motions]
    if paths[0].quaternion is not None and paths[0].rotation is not None:
        yield _same_attitude(motions, resolution)
        yield _rotation_delay(motions[-1])
    steps_s = [motion.dt_s for motion in motions]
    if paths[0].quaternion is not None:
        sizes = [_largest_norm_error(path) for path in paths]
        yield _normalisation("quaternion_norm", steps_s, sizes, "|q| - 1", resolution)
    if paths[0].rotation is not None:
        sizes = [_largest_orthogonality_error(path) for path in paths]
        yield _normalisation("rotation_orthogonality", steps_s, sizes, "||R^T R - I||", resolution)


def _same_attitude(motions: Sequence[Sampled], resolution: float) -> Finding:
    """Return the angle between the engine's quaternion and its rotation matrix for the same states."""
    cells = len(motions[0].trajectory.t_s)
    angles, scatter = [], 0.0
    for motion in motions:
        path = motion.trajectory
        assert path.rotation is not None
        turned = matrix_to_quaternion(project_to_so3(path.rotation))
        between = log_quaternion(quaternion_product(conjugate(path.attitude), turned))
        scatter = noise(between)
        angles.append(between[:: (len(between) - 1) // (cells - 1)])
    found = limit([m.dt_s for m in motions], angles, max(resolution, scatter))
    return found.finding("rotation_reading", "the rotation matrix differs from the quaternion")


def _rotation_delay(motion: Sampled) -> Finding:
    """Return by how many steps the matrix lags behind the quaternion: they differ by omega h per step."""
    path = motion.trajectory
    assert path.rotation is not None
    turned = matrix_to_quaternion(project_to_so3(path.rotation[-1]))
    between = log_quaternion(quaternion_product(conjugate(path.attitude[-1]), turned))
    per_step = motion.dt_s * path.omega_body[-1]
    return _lag(
        "rotation_delay", between, per_step, "compared with the quaternion, the rotation matrix is read"
    )


def _largest_norm_error(path: Trajectory) -> float:
    assert path.quaternion is not None
    return float(np.max(np.abs(np.linalg.norm(path.quaternion, axis=-1) - 1.0)))


def _largest_orthogonality_error(path: Trajectory) -> float:
    assert path.rotation is not None
    product = np.einsum("nji,njk->nik", path.rotation, path.rotation)
    return float(np.max(np.linalg.norm(product - np.eye(3), axis=(-2, -1))))


def _normalisation(
    check: str, steps_s: Sequence[float], sizes: Sequence[float], size_name: str, resolution: float
) -> Finding:
    """Return a property, which is never inconsistent, because some engines do not normalise by design.

    The order is that of the last two steps. resolution: relative, of the states after all steps.
    """
    unit = max(_UNIT, resolution)
    message = ""
    if sizes[-1] > unit:
        order = np.log(sizes[-2] / sizes[-1]) / np.log(steps_s[-2] / steps_s[-1])
        message = f"not renormalised: {size_name} = {sizes[-1]:.3g} at {steps_s[-1]:.6g} s, order {order:.2f}"
    return Finding(check, sizes[-1], 0.0, sizes[-1], message=message)
