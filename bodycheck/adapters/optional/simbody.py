"""Simbody through OpenSim: a body on OpenSim's FreeJoint, by each integrator at fixed steps.

The coordinates are Euler angles, R = Rx(q0) Ry(q1) Rz(q2), and the position of the body; the speeds are
omega and the velocity in world axes. A PrescribedForce holds the loads, in world axes.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import BetweenSteps, FreeBodiesOnly, array
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene, State

_INTEGRATORS: Mapping[str, tuple[str, int, int]] = {
    "runge-kutta-merson": ("RungeKuttaMerson", 4, 5),
    "runge-kutta3": ("RungeKutta3", 3, 3),
    "runge-kutta2": ("RungeKutta2", 2, 2),
    "verlet": ("Verlet", 2, 1),
    "semi-explicit-euler2": ("SemiExplicitEuler2", 1, 2),
    "explicit-euler": ("ExplicitEuler", 1, 1),
}
"""Method -> the end of a member of Manager.IntegratorMethod, order, and evaluations per step."""


def _method_of(name: str) -> Method:
    called, order, evaluations = _INTEGRATORS[name]
    member = f"IntegratorMethod_{called}"
    return Method(
        name=name,
        formula=f"Simbody's {called} for y = (Euler angles, x, omega, v)",
        order=order,
        evaluations=evaluations,
        torque="zero-order hold",
        conserves="R^T R = 1; linear momentum",
        source=f"OpenSim, Manager.{member}; Sherman, Seth and Delp (2011), Procedia IUTAM 2, 241",
        changed_defaults=("fixed steps in place of error control",),
        snippet=f"manager.setIntegratorMethod(opensim.Manager.{member}); "
        "manager.setIntegratorFixedStepSize({dt_s})",
    )


class Simbody(FreeBodiesOnly):
    """Simbody (Sherman, Seth and Delp 2011) through OpenSim."""

    name = "simbody"
    distribution = "opensim"
    requires = ("opensim>=4.6",)
    modules = ("opensim",)
    methods: Mapping[str, Method] = {name: _method_of(name) for name in _INTEGRATORS}

    def __init__(self) -> None:
        import opensim

        opensim.Logger.setLevelString("Off")
        super().__init__()

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a model of one body on a free joint."""
        return BetweenSteps(scene, dt_s, _Body(scene, method, dt_s))


class _Body:
    stepping: Stepping = "python"

    def __init__(self, scene: Scene, method: str, dt_s: float) -> None:
        import opensim

        self._o: Any = opensim
        self._dt_s = dt_s
        self._model = opensim.Model()
        self._model.setGravity(self._vector(scene.gravity))
        tensor = scene.body.inertia
        inertia = opensim.Inertia(*map(float, (*np.diag(tensor), tensor[0, 1], tensor[0, 2], tensor[1, 2])))
        self._body = opensim.Body("body", scene.body.mass, opensim.Vec3(0.0), inertia)
        self._model.addBody(self._body)
        self._model.addJoint(opensim.FreeJoint("free", self._model.getGround(), self._body))
        self._loads = opensim.PrescribedForce("loads", self._body)
        for add in (
            self._loads.setForceFunctions,
            self._loads.setTorqueFunctions,
            self._loads.setPointFunctions,
        ):
            add(*(opensim.Constant(0.0) for _ in range(3)))
        self._loads.set_pointIsGlobal(False)
        self._model.addForce(self._loads)
        self._state = self._model.initSystem()
        self._manager = opensim.Manager(self._model)
        self._manager.setIntegratorMethod(
            getattr(opensim.Manager, f"IntegratorMethod_{_INTEGRATORS[method][0]}")
        )
        # the end of each call ends the step: one step of exactly dt
        self._manager.setIntegratorFixedStepSize(dt_s * (1.0 + 1e-6))
        self._manager.setWriteToStorage(False)
        self._manager.setPerformAnalyses(False)

    def _vector(self, values: Array) -> Any:
        return self._o.Vec3(*map(float, values))

    def model(self) -> tuple[float, Array, float, Array]:
        held = self._body.getInertia()
        moments, products = (
            array([part.get(i) for i in range(3)]) for part in (held.getMoments(), held.getProducts())
        )
        xy, xz, yz = products
        inertia = np.diag(moments) + np.array([[0.0, xy, xz], [xy, 0.0, yz], [xz, yz, 0.0]])
        return self._body.getMass(), inertia, self._dt_s, array(self._model.getGravity().to_numpy())

    def set_state(self, state: State) -> None:
        r = state.rotation
        angles = (
            math.atan2(-r[1, 2], r[2, 2]),
            math.asin(max(-1.0, min(1.0, r[0, 2]))),
            math.atan2(-r[0, 1], r[0, 0]),
        )
        q, u = self._o.Vector(self._state.getNQ(), 0.0), self._o.Vector(self._state.getNU(), 0.0)
        for index, value in enumerate((*angles, *state.position)):
            q[index] = float(value)
        for index, value in enumerate((*state.omega_world, *state.velocity)):
            u[index] = float(value)
        self._state.setQ(q)
        self._state.setU(u)
        self._steps = 0
        self._start()

    def _start(self) -> None:
        """Let the integrator start here, so that it keeps no derivative of earlier loads."""
        self._state.setTime(self._steps * self._dt_s)
        self._manager.initialize(self._state)

    def step(self, steps: int, force: Array, torque: Array) -> None:
        functions = (self._loads.get_forceFunctions(), self._loads.get_torqueFunctions())
        for held, values in zip(functions, (force, torque), strict=True):
            for index, value in enumerate(values):
                self._o.Constant.safeDownCast(held.get(index)).setValue(float(value))
        self._start()
        for _ in range(steps):
            self._steps += 1
            self._state = self._manager.integrate(self._steps * self._dt_s)

    def read(self) -> Reading:
        self._model.realizeVelocity(self._state)
        turn, body, state = self._body.getTransformInGround(self._state).R(), self._body, self._state
        return Reading(
            array(body.getPositionInGround(state).to_numpy()),
            array(body.getLinearVelocityInGround(state).to_numpy()),
            rotation=array([[turn.get(i, k) for k in range(3)] for i in range(3)]),
            omega_world=array(body.getAngularVelocityInGround(state).to_numpy()),
        )
