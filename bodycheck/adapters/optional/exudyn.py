"""Exudyn: a rigid body whose rotation vector is stepped on the group, by each solver with a fixed step.

A node has the position and the rotation vector of the body, and their rates: the velocity in world axes and
omega in body axes. Users' functions of loads are called at every stage.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Stepping
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.adapters.optional.between_steps import FreeBodiesOnly, array
from bodycheck.adapters.optional.exudyn_solvers import ROUND_OFF, SOLVERS, ExudynSolver, fixed_steps
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import log_quaternion
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench


def _method_of(name: str, solver: ExudynSolver) -> Method:
    return Method(
        name=name,
        formula=solver.formula,
        order=solver.order,
        evaluations=solver.evaluations,
        torque="every stage",
        continuous_loads="every stage",
        conserves="R^T R = 1",
        source=f"Exudyn, DynamicSolverType.{solver.called}; Gerstmayr (2023), Multibody Syst. Dyn.",
        changed_defaults=("fixed steps, also of DOPRI5", "full Newton iterations, to round-off"),
        snippet=f"settings.timeIntegration.numberOfSteps = round(endTime / {{dt_s}}); "
        f"mbs.SolveDynamic(settings, solverType=exudyn.DynamicSolverType.{solver.called})",
    )


class Exudyn(FreeBodiesOnly):
    """Exudyn (Gerstmayr)."""

    name = "exudyn"
    distribution = "exudyn"
    requires = ("exudyn>=1.13.6",)
    modules = ("exudyn", "exudyn.itemInterface")
    methods: Mapping[str, Method] = {name: _method_of(name, solver) for name, solver in SOLVERS.items()}
    tree_model = "bodycheck.adapters.optional.exudyn_tree:ExudynTree"

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a system of one body."""
        return ExudynSimulation(scene, SOLVERS[method].called, dt_s)


class ExudynSimulation:
    """A system with one node, one body and, where the scene has any, its loads."""

    def __init__(self, scene: Scene, solver: str, dt_s: float) -> None:
        import exudyn
        from exudyn.itemInterface import LoadMassProportional, MarkerBodyMass, NodeRigidBodyRotVecLG

        self._exu: Any = exudyn
        self._scene, self._dt_s = scene, dt_s
        self._solver = getattr(exudyn.DynamicSolverType, solver)
        self.stepping: Stepping = "python" if scene.loads else "native"
        self._loads = StageLoads(replace(scene, gravity=np.zeros(3)))  # the weight is a load of its own
        self._container = exudyn.SystemContainer()
        self._system = self._container.AddSystem()
        self._node = self._system.AddNode(NodeRigidBodyRotVecLG(referenceCoordinates=[0.0] * 6))
        self._body = self._add_body()
        at = self._system.AddMarker(MarkerBodyMass(bodyNumber=self._body))
        self._weight = self._system.AddLoad(
            LoadMassProportional(markerNumber=at, loadVector=scene.gravity.tolist())
        )
        if scene.loads:
            self._add_loads()
        self._system.Assemble()
        self._settings = fixed_steps()
        self.reset()

    def _add_body(self) -> int:
        from exudyn.itemInterface import ObjectRigidBody

        inertia = self._scene.body.inertia
        moments = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))]
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # the names of 1.12 hold until 2031
            body = ObjectRigidBody(
                physicsMass=self._scene.body.mass, physicsInertia=moments, nodeNumber=self._node
            )
            return int(self._system.AddObject(body))

    def _add_loads(self) -> None:
        from exudyn.itemInterface import LoadForceVector, LoadTorqueVector, MarkerBodyRigid

        at = self._system.AddMarker(MarkerBodyRigid(bodyNumber=self._body, localPosition=[0.0] * 3))
        for kind, part in ((LoadForceVector, 0), (LoadTorqueVector, 1)):
            self._system.AddLoad(
                kind(
                    markerNumber=at,
                    loadVector=[0.0] * 3,
                    loadVectorUserFunction=lambda _, t_s, __, part=part: self._wrench(t_s)[part],
                )
            )

    def _wrench(self, t_s: float) -> tuple[Array, Array]:
        """Return force and torque (3,) in world axes at the present stage."""
        position, velocity, rotation, omega = self._state()
        force, torque = self._loads.at(t_s, position, rotation, velocity, rotation @ omega)
        return force, rotation @ torque

    def _largest_force(self, t_s: float) -> float:
        """Return the sum of the norms of forces in N and torques in N m, to which residuals are rounded."""
        omega, body = self._state()[3], self._scene.body
        loads = self._wrench(t_s) if self._scene.loads else ()
        terms = (body.mass * self._scene.gravity, np.cross(omega, body.inertia @ omega), *loads)
        return float(sum(np.linalg.norm(term) for term in terms))

    def _state(self) -> tuple[Array, Array, Array, Array]:
        """Return position, velocity, rotation (3, 3) and omega in body axes, of the node."""
        kind = self._exu.OutputVariableType
        outputs = (kind.Position, kind.Velocity, kind.RotationMatrix, kind.AngularVelocityLocal)
        found = [array(self._system.GetNodeOutput(self._node, output)) for output in outputs]
        return found[0], found[1], found[2].reshape(3, 3), found[3]

    def reset(self) -> None:
        """Restore the initial state at t = 0, without a wrench."""
        start, data = self._scene.initial, self._system.systemData
        pose = np.concatenate([start.position, log_quaternion(start.quaternion)])
        rates = np.concatenate([start.velocity, start.omega_body])
        for configuration in (self._exu.ConfigurationType.Initial, self._exu.ConfigurationType.Current):
            data.SetODE2Coordinates(pose, configuration)
            data.SetODE2Coordinates_t(rates, configuration)
        self._steps_made, self._size = 0, 0.0
        self.apply(NO_WRENCH)

    def apply(self, wrench: Wrench) -> None:
        """Replace the constant loads."""
        self._loads.wrench = wrench

    def advance(self, steps: int) -> None:
        """Make the steps by one call of the solver, which continues from the end of the last."""
        times = self._settings.timeIntegration
        times.startTime, times.numberOfSteps = self._steps_made * self._dt_s, steps
        self._steps_made += steps
        times.endTime = self._steps_made * self._dt_s
        self._size = max(self._size, self._largest_force(times.startTime))
        times.newton.absoluteTolerance = ROUND_OFF * self._size
        self._system.SolveDynamic(self._settings, solverType=self._solver, updateInitialValues=True)

    def read(self) -> Reading:
        """Return copies of the node's outputs; the matrix is its RotationMatrix."""
        position, velocity, rotation, omega = self._state()
        return Reading(position, velocity, rotation=rotation, omega_body=omega)

    def read_back(self) -> ReadBack:
        """Return the model as read from the system; the step is this adapter's."""
        held = self._system.GetObject(self._body)
        body = {name.removeprefix("physics").lower(): value for name, value in held.items()}  # until 1.11
        xx, yy, zz, yz, xz, xy = body["inertia"]
        gravity = array(self._system.GetLoad(self._weight)["loadVector"])
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        return ReadBack(float(body["mass"]), inertia, self._dt_s, gravity, self.read())

    def close(self) -> None:
        """Do nothing; the system is freed with this object."""
