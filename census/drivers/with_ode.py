"""ODE's library by itself, in double precision, through ctypes."""

from __future__ import annotations

import ctypes
from ctypes import POINTER, c_double, c_int, c_void_p

from exact import SPIN, TOP, angle, of_quaternion, order, top

_ODE = ctypes.CDLL("libode.so.8")


class _Mass(ctypes.Structure):
    _fields_ = (("mass", c_double), ("c", c_double * 4), ("inertia", c_double * 12))


def _error(dt: float) -> float:
    for name in ("dWorldCreate", "dBodyCreate"):
        getattr(_ODE, name).restype = c_void_p
    _ODE.dBodyGetQuaternion.restype = POINTER(c_double)
    _ODE.dInitODE2(0)
    world = c_void_p(_ODE.dWorldCreate())
    body = c_void_p(_ODE.dBodyCreate(world))
    mass = _Mass()
    zero = c_double(0.0)
    _ODE.dMassSetParameters(
        ctypes.byref(mass), c_double(1.0), zero, zero, zero, *map(c_double, TOP), zero, zero, zero
    )
    _ODE.dBodySetMass(body, ctypes.byref(mass))
    _ODE.dBodySetFiniteRotationMode(body, c_int(1))
    _ODE.dBodySetAngularVel(body, *map(c_double, SPIN))
    for _ in range(round(1.0 / dt)):
        _ODE.dWorldStep(world, c_double(dt))
    return angle(top(1.0), of_quaternion(*(_ODE.dBodyGetQuaternion(body)[k] for k in range(4))))


def gyroscopic_error() -> list[float]:
    """Error of a symmetric top after 1 s at 1e-3 s, and its order."""
    coarse, fine = (_error(dt) for dt in (2e-3, 1e-3))
    return [fine, order(coarse, fine)]
