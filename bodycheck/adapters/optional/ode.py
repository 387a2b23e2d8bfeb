"""ODE, the Open Dynamics Engine, through the shared library of the system and ctypes.

Quaternions are scalar-first, velocities and forces in world axes; a step clears force and torque. Needs a
library in double precision, as Debian's and Ubuntu's libode8 is.
"""

from __future__ import annotations

import ctypes
import ctypes.util
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bodycheck._util.errors import UnavailableError
from bodycheck.adapters.contract import Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import BetweenSteps, FreeBodiesOnly
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene, State

_LIBRARY, _INSTALL = "ode", "apt install libode8"
_RULE = "gyroscopic term of the new omega and the old momentum"
_INFINITESIMAL = Method(
    name="step",
    formula=f"{_RULE}, additive quaternion renormalised",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| = 1; linear momentum",
    source="ODE, dWorldStep, dBodySetGyroscopicMode(1), dxStepBody",
    snippet="dWorldStep(world, {dt_s})",
)
_FINITE = replace(
    _INFINITESIMAL,
    name="step-finite",
    formula=_RULE,
    changed_defaults=("dBodySetFiniteRotationMode(1)",),
    snippet="dBodySetFiniteRotationMode(body, 1); dWorldStep(world, {dt_s})",
)
_real, _pointer = ctypes.c_double, ctypes.c_void_p


class _Mass(ctypes.Structure):
    _fields_ = (("mass", _real), ("c", _real * 4), ("inertia", _real * 12))


_SIGNATURES: Mapping[str, tuple[Any, tuple[Any, ...]]] = {
    "dInitODE2": (ctypes.c_int, (ctypes.c_uint,)),
    "dCheckConfiguration": (ctypes.c_int, (ctypes.c_char_p,)),
    "dGetConfiguration": (ctypes.c_char_p, ()),
    "dWorldCreate": (_pointer, ()),
    "dWorldDestroy": (None, (_pointer,)),
    "dWorldSetGravity": (None, (_pointer, _real, _real, _real)),
    "dWorldGetGravity": (None, (_pointer, _pointer)),
    "dWorldStep": (ctypes.c_int, (_pointer, _real)),
    "dBodyCreate": (_pointer, (_pointer,)),
    "dMassSetParameters": (None, (_pointer, *[_real] * 10)),
    "dBodySetMass": (None, (_pointer, _pointer)),
    "dBodyGetMass": (None, (_pointer, _pointer)),
    "dBodySetFiniteRotationMode": (None, (_pointer, ctypes.c_int)),
    "dBodySetPosition": (None, (_pointer, _real, _real, _real)),
    "dBodySetQuaternion": (None, (_pointer, _pointer)),
    "dBodySetLinearVel": (None, (_pointer, _real, _real, _real)),
    "dBodySetAngularVel": (None, (_pointer, _real, _real, _real)),
    "dBodyAddForce": (None, (_pointer, _real, _real, _real)),
    "dBodyAddTorque": (None, (_pointer, _real, _real, _real)),
    **{
        f"dBodyGet{name}": (ctypes.POINTER(_real), (_pointer,))
        for name in ("Position", "Quaternion", "Rotation", "LinearVel", "AngularVel")
    },
}


class Ode(FreeBodiesOnly):
    """ODE (Smith 2001-2024)."""

    name = "ode"
    system_library = _LIBRARY
    install = _INSTALL
    methods: Mapping[str, Method] = {method.name: method for method in (_INFINITESIMAL, _FINITE)}

    def __init__(self) -> None:
        path = ctypes.util.find_library(_LIBRARY)
        if path is None:
            raise UnavailableError(f"ode: no shared library {_LIBRARY} on this system: {_INSTALL}")
        self._library: Any = ctypes.CDLL(path)
        for name, (result, arguments) in _SIGNATURES.items():
            function = getattr(self._library, name)
            function.restype, function.argtypes = result, arguments
        if not self._library.dCheckConfiguration(b"ODE_double_precision"):
            raise UnavailableError(f"ode: {path} is in single precision: {_INSTALL}")
        self._library.dInitODE2(0)
        self.version = path.partition(".so.")[2] or path

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a world of one body."""
        return BetweenSteps(scene, dt_s, _Body(self._library, scene, dt_s, finite=method == _FINITE.name))


class _Body:
    stepping: Stepping = "python"

    def __init__(self, library: Any, scene: Scene, dt_s: float, *, finite: bool) -> None:
        self._ode, self._dt_s = library, dt_s
        self._world = library.dWorldCreate()
        self._body = library.dBodyCreate(self._world)
        library.dWorldSetGravity(self._world, *scene.gravity)
        mass, inertia = _Mass(), scene.body.inertia
        parameters = (
            scene.body.mass,
            0.0,
            0.0,
            0.0,
            *np.diag(inertia),
            inertia[0, 1],
            inertia[0, 2],
            inertia[1, 2],
        )
        library.dMassSetParameters(ctypes.byref(mass), *map(float, parameters))
        library.dBodySetMass(self._body, ctypes.byref(mass))
        library.dBodySetFiniteRotationMode(self._body, int(finite))

    def model(self) -> tuple[float, Array, float, Array]:
        mass, gravity = _Mass(), (_real * 4)()
        self._ode.dBodyGetMass(self._body, ctypes.byref(mass))
        self._ode.dWorldGetGravity(self._world, gravity)
        inertia = np.array(mass.inertia).reshape(3, 4)[:, :3]
        return mass.mass, inertia, self._dt_s, np.array(gravity)[:3]

    def set_state(self, state: State) -> None:
        ode, body = self._ode, self._body
        ode.dBodySetPosition(body, *state.position)
        ode.dBodySetQuaternion(body, (_real * 4)(*state.quaternion))
        ode.dBodySetLinearVel(body, *state.velocity)
        ode.dBodySetAngularVel(body, *state.omega_world)

    def step(self, steps: int, force: Array, torque: Array) -> None:
        for _ in range(steps):
            self._ode.dBodyAddForce(self._body, *force)
            self._ode.dBodyAddTorque(self._body, *torque)
            self._ode.dWorldStep(self._world, self._dt_s)

    def read(self) -> Reading:
        return Reading(
            self._get("Position", 3),
            self._get("LinearVel", 3),
            quaternion=self._get("Quaternion", 4),
            rotation=self._get("Rotation", 12).reshape(3, 4)[:, :3],
            omega_world=self._get("AngularVel", 3),
        )

    def _get(self, name: str, count: int) -> Array:
        return np.array(getattr(self._ode, f"dBodyGet{name}")(self._body)[:count])

    def __del__(self) -> None:
        self._ode.dWorldDestroy(self._world)
