"""The fixed-step integrators, one file each."""

from __future__ import annotations

from bodycheck.reference_impl.integrators.cf4 import LIE4
from bodycheck.reference_impl.integrators.dop853 import DOP853
from bodycheck.reference_impl.integrators.euler import EULER
from bodycheck.reference_impl.integrators.euler_svd import EULER_SVD
from bodycheck.reference_impl.integrators.explicit_gyro import M1
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.integrators.lie_euler import ROTATION_FIRST
from bodycheck.reference_impl.integrators.linearly_implicit import M2
from bodycheck.reference_impl.integrators.linearly_implicit_gyro import M3
from bodycheck.reference_impl.integrators.quaternion_euler import QUATERNION_EULER
from bodycheck.reference_impl.integrators.rk4 import RK4
from bodycheck.reference_impl.integrators.splitting import SPLITTING6

INTEGRATORS: dict[str, Integrator] = {
    integrator.name: integrator
    for integrator in (
        EULER,
        EULER_SVD,
        ROTATION_FIRST,
        QUATERNION_EULER,
        RK4,
        M1,
        M2,
        M3,
        LIE4,
        SPLITTING6,
        DOP853,
    )
}
