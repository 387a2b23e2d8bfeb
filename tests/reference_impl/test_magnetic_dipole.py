"""A magnet in a uniform field: a pendulum about one axis; energy and axial momentum in general.

test_forced_truth.py compares `compass` with fifty digits, test_load_formulas.py its torque with forty, and
tests/adapters/test_continuous_loads.py tests every engine, free and about a pivot.
"""

from __future__ import annotations

from dataclasses import replace

import mpmath as mp
import numpy as np
import pytest

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.dynamics import angular_momentum
from bodycheck.reference_impl.loads.kinds.magnetic_dipole import MagneticDipole
from bodycheck.reference_impl.pivot import kinetic_energies
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.reference_impl.truth.motion_distance import potential_energy
from bodycheck.reports.measurement.work import working_loads
from bodycheck.scenarios.library import load_scenario

pytestmark = pytest.mark.nightly  # they compile kernels that few others use

COMPASS = load_scenario("compass").scene


def pendulum(rate: float, own_rate: float, t: float) -> tuple[mp.mpf, mp.mpf]:
    """Return angle and rate of theta'' = -n^2 sin theta from 0 with 40 digits, n the natural rate.

    sin(theta / 2) = k sn(n t, k), k = rate / (2 n), if it swings; sn(k n t, 1 / k) if it turns over. Source:
    Whittaker (1937), A Treatise on the Analytical Dynamics of Particles and Rigid Bodies, section 44.
    """
    n, k = mp.mpf(own_rate), mp.mpf(rate) / (2 * mp.mpf(own_rate))
    if k < 1:
        u = n * mp.mpf(t)
        return 2 * mp.asin(k * mp.ellipfun("sn", u, m=k**2)), rate * mp.ellipfun("cn", u, m=k**2)
    u, m = k * n * mp.mpf(t), 1 / k**2
    turns = mp.floor(u / (2 * mp.ellipk(m)) + mp.mpf(1) / 2)
    angle = 2 * (mp.asin(mp.ellipfun("sn", u, m=m)) * (-1) ** int(turns) + turns * mp.pi)
    return angle, rate * mp.ellipfun("dn", u, m=m)


@pytest.mark.parametrize("rate", [0.3, 1.5, 2.9, 4.5])
def test_magnet_about_one_axis_is_a_pendulum(rate: float) -> None:
    """Angle and rate equal the elliptic functions within the bounds, also if the magnet turns over."""
    body = RigidBody(1.0, np.diag([1.0, 2.0, 2.5]))
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.0, 0.0, rate]))
    dipole = MagneticDipole(np.array([2.0, 0.0, 0.0]), np.array([2.5, 0.0, 0.0]))
    scene = Scene(body, start, (dipole,), np.zeros(3), 6.0, 7)  # n^2 = 2 A m^2 x 2.5 T / 2.5 kg m^2
    truth = solve_truth(scene, scene.sample_times)
    assert truth.kind == "certified"
    for k, t in enumerate(scene.sample_times):
        with mp.workdps(40):
            angle, spin = pendulum(rate, mp.sqrt(2), float(t))
            w, x, y, z = (mp.mpf(c) for c in truth.trajectory.attitude[k].tolist())
            apart = 2 * mp.asin(z * mp.cos(angle / 2) - w * mp.sin(angle / 2))
            assert x == y == 0
            assert abs(apart) <= truth.bound_rad[k] <= 2e-15
            omega = truth.trajectory.omega_body[k].tolist()
            assert omega[:2] == [0.0, 0.0]
            assert abs(omega[2] - spin) <= truth.bound_omega_rad_s[k] <= 2e-15 * rate


def test_energy_and_momentum_along_the_field_are_constant() -> None:
    """E = K - (R m) . B and L . B of the truth are constant to round-off, although each part changes."""
    truth = solve_truth(COMPASS, COMPASS.sample_times).trajectory
    kinetic, potential = kinetic_energies(COMPASS, truth)[0], potential_energy(COMPASS, truth)
    assert np.ptp(potential) > 0.1 * np.max(kinetic)
    assert np.ptp(kinetic + potential) <= 4e-15 * np.max(kinetic)
    (dipole,) = COMPASS.loads
    assert isinstance(dipole, MagneticDipole)
    momentum = angular_momentum(truth.rotation_matrices, COMPASS.body.inertia, truth.omega_body)
    along = momentum @ dipole.field
    assert np.ptp(along) <= 4e-15 * np.max(np.linalg.norm(momentum, axis=1)) * np.linalg.norm(dipole.field)
    assert working_loads(COMPASS, 0.0, 1.0) == []


def test_wrong_sign_of_the_potential_is_detected() -> None:
    """With the field reversed, the energy of the same motion is far from constant."""
    truth = solve_truth(COMPASS, COMPASS.sample_times).trajectory
    (dipole,) = COMPASS.loads
    assert isinstance(dipole, MagneticDipole)
    turned = replace(COMPASS, loads=(replace(dipole, field=-dipole.field),))
    kinetic = kinetic_energies(COMPASS, truth)[0]
    assert np.ptp(kinetic + potential_energy(turned, truth)) > 0.1 * np.max(kinetic)


@pytest.mark.parametrize("method", ["rk4", "splitting6", "dop853", "taylor"])
def test_methods_of_high_order_conserve_the_energy(method: str) -> None:
    """The energy of a case drifts by at most its method's error."""
    setting = Setting(tolerance=1e-15) if method == "taylor" else Setting(dt_s=0.01)
    answer = record(Reference(), Case(COMPASS, method, setting))
    assert answer.trajectory is not None
    kinetic = kinetic_energies(COMPASS, answer.trajectory)[0]
    energy = kinetic + potential_energy(COMPASS, answer.trajectory)
    assert np.ptp(energy) <= {"rk4": 1e-8, "splitting6": 1e-11}.get(method, 1e-13) * np.max(kinetic)
