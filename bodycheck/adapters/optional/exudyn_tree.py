"""Trees in Exudyn: an ObjectKinematicTree, whose joints are hinges and slides about an axis of their frames.

A ball is three hinges about x, y and z, and a free body three slides and a ball. Their angles are counted
from the attitude in which the state was set or, in a motion, from that of the last sample: so they stay
small, far from the right angle at which they are singular.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from bodycheck.adapters.contract import TreeReadBack
from bodycheck.adapters.optional.between_steps import array
from bodycheck.adapters.optional.exudyn_solvers import ROUND_OFF, SOLVERS, fixed_steps
from bodycheck.adapters.tree_contract import (
    JointedLink,
    RateMap,
    TreeModel,
    UnreportedError,
    frame_about,
    joint_forces,
    jointed_links,
    link_momenta,
    link_poses,
)
from bodycheck.adapters.workers.tree_readings import without_loads
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_matrix, matrix_to_quaternion, quaternion_to_matrix
from bodycheck.reference_impl.trees.tree_scene import TreeLoad, TreeScene

_BALL = ("RevoluteX", "RevoluteY", "RevoluteZ")
_JOINTS: Mapping[str, tuple[str, ...]] = {
    "hinge": ("RevoluteX",),
    "slide": ("PrismaticX",),
    "ball": _BALL,
    "free": ("PrismaticX", "PrismaticY", "PrismaticZ", *_BALL),
}
_INSTANT_S = 1e-10


class ExudynTree(TreeModel):
    """A system with one kinematic tree."""

    native: ClassVar[Mapping[str, str]] = {
        "mass_matrix": "GetSystemMassMatrix; balls and free bodies as hinges about x, y, z, and slides",
        "bias": "ComputeODE2RHS, with the other sign",
        "gravity_bias": "ComputeODE2RHS at rest, with the other sign",
        "accelerations": f"ODE2Coordinates_tt after a step of {_INSTANT_S:g} s",
        "momenta": "of the velocities and omegas that SensorKinematicTree gives of each link",
        "poses": "SensorKinematicTree: Position, RotationMatrix",
    }
    resolution: ClassVar[Mapping[str, float]] = {"accelerations": 1e-8}

    def __init__(self, scene: TreeScene, masses_were: float = 1.0) -> None:
        import exudyn

        self._exu: Any = exudyn
        self._scene, self._links = scene, jointed_links(scene)
        self._bare = without_loads(scene)
        self._loads: tuple[tuple[TreeLoad, float], ...] = ()
        self._frames = [
            frame_about(link.axis) if link.kind in ("hinge", "slide") else np.eye(3) for link in self._links
        ]
        starts = np.cumsum([0, *(len(_JOINTS[link.kind]) for link in self._links)])
        self._starts, self._last = starts[:-1], starts[1:] - 1
        self._map = RateMap(scene, [int(start) for start in self._starts])
        self._container = exudyn.SystemContainer()
        self._system = self._container.AddSystem()
        self._add_tree(jointed_links(scene, masses_were))
        self._add_sensors()
        self._system.Assemble()
        if masses_were != 1.0:
            masses, inertias, _ = self._solids(self._links)
            self._system.SetObjectParameter(self._tree, "linkMasses", masses)
            self._system.SetObjectParameter(self._tree, "linkInertiasCOM", inertias)
        self._settings = fixed_steps()
        self._counted_from = [np.eye(3) for _ in self._links]

    def _add_tree(self, links: Sequence[JointedLink]) -> None:
        from exudyn.itemInterface import NodeGenericODE2, ObjectKinematicTree

        number = int(self._last[-1]) + 1
        kinds, parents = [kind for link in links for kind in _JOINTS[link.kind]], []
        places, turns = np.zeros((number, 3)), np.tile(np.eye(3), (number, 1, 1))
        stiffness, damping, rest = np.zeros((3, number))
        for link, body, frame, first, last in zip(
            links, self._scene.bodies, self._frames, self._starts, self._last, strict=True
        ):
            before = self._before(link)
            parents += [-1 if link.parent < 0 else int(self._last[link.parent]), *range(first, last)]
            places[first] = before.T @ link.place
            turns[first] = before.T @ quaternion_to_matrix(link.zero) @ frame
            if link.kind in ("hinge", "slide"):
                joint = body.joint
                stiffness[last], damping[last], rest[last] = joint.stiffness, joint.damping, joint.rest
        self._turns = turns
        masses, inertias, centres = self._solids(links)
        self._node = self._system.AddNode(
            NodeGenericODE2(
                referenceCoordinates=[0.0] * number,
                initialCoordinates=[0.0] * number,
                initialCoordinates_t=[0.0] * number,
                numberOfODE2Coordinates=number,
            )
        )
        self._tree = self._system.AddObject(
            ObjectKinematicTree(
                nodeNumber=self._node,
                gravity=self._scene.gravity.tolist(),
                jointTypes=[getattr(self._exu.JointType, kind) for kind in kinds],
                linkParents=parents,
                jointTransformations=self._exu.Matrix3DList(list(turns)),
                jointOffsets=self._exu.Vector3DList(list(places)),
                linkMasses=masses,
                linkInertiasCOM=inertias,
                linkCOMs=centres,
                jointPControlVector=stiffness,
                jointDControlVector=damping,
                jointPositionOffsetVector=rest,
                jointVelocityOffsetVector=np.zeros(number),
                forceUserFunction=self._applied if self._scene.loads else 0,
            )
        )

    def _before(self, link: JointedLink) -> Array:
        """Return Exudyn's axes of the parent, as columns in ours."""
        return np.eye(3) if link.parent < 0 else self._frames[link.parent]

    def _solids(self, links: Sequence[JointedLink]) -> tuple[Array, Any, Any]:
        """Return masses, inertias and centres of all links in their frames; 0 but in the last of a joint."""
        number = int(self._last[-1]) + 1
        masses, inertias, centres = np.zeros(number), np.zeros((number, 3, 3)), np.zeros((number, 3))
        for link, frame, last in zip(links, self._frames, self._last, strict=True):
            masses[last] = link.mass
            inertias[last], centres[last] = frame.T @ link.inertia @ frame, frame.T @ link.centre
        return masses, self._exu.Matrix3DList(list(inertias)), self._exu.Vector3DList(list(centres))

    def _add_sensors(self) -> None:
        """Add sensors at the centre of mass of each link."""
        from exudyn.itemInterface import SensorKinematicTree

        self._sensors = {
            output: [
                self._system.AddSensor(
                    SensorKinematicTree(
                        objectNumber=self._tree,
                        linkNumber=int(last),
                        localPosition=(frame.T @ link.centre).tolist(),
                        outputVariableType=getattr(self._exu.OutputVariableType, output),
                        writeToFile=False,
                    )
                )
                for link, frame, last in zip(self._links, self._frames, self._last, strict=True)
            ]
            for output in ("Position", "RotationMatrix", "Velocity", "AngularVelocity")
        }

    def _sensed(self, output: str) -> Array:
        return array([self._system.GetSensorValues(sensor) for sensor in self._sensors[output]])

    def _rotations(self) -> list[Array]:
        """Return the rotations of the bodies, from those of Exudyn's links."""
        found = self._sensed("RotationMatrix").reshape(-1, 3, 3)
        return [rotation @ frame.T for rotation, frame in zip(found, self._frames, strict=True)]

    def set_state(self, q: Array, u: Array) -> None:
        """Set the coordinates and their rates, initial and current."""
        own, turns = np.empty(len(u)), self._turns.copy()
        for k, (link, part) in enumerate(zip(self._links, self._scene.coordinate_slices, strict=True)):
            values, first, last = q[part], self._starts[k], self._last[k]
            if link.kind in ("ball", "free"):
                self._counted_from[k] = quaternion_to_matrix(values[-4:])
                turns[last - 2] = turns[last - 2] @ self._counted_from[k]
                values = np.concatenate([values[:-4], np.zeros(3)])
            own[first : last + 1] = values
        self._system.SetObjectParameter(
            self._tree, "jointTransformations", self._exu.Matrix3DList(list(turns))
        )
        self._turn(own, np.zeros(len(u)))
        rates = self._map.rates(u)
        self._turn(own, rates)
        self._put(own, rates)
        self._has_stepped = False

    def _put(self, own: Array, rates: Array) -> None:
        data, kinds = self._system.systemData, self._exu.ConfigurationType
        for configuration in (kinds.Initial, kinds.Current):
            data.SetODE2Coordinates(own, configuration)
            data.SetODE2Coordinates_t(rates, configuration)

    def _turn(self, own: Array, rates: Array) -> None:
        """Set the map of rates at these coordinates, and its drift at these rates."""
        for k, (link, last) in enumerate(zip(self._links, self._last, strict=True)):
            if link.kind not in ("ball", "free"):
                continue
            angles = slice(last - 2, last + 1)
            to_omega, change = _omega_of_rates(own[angles], rates[angles])
            size = len(_JOINTS[link.kind])
            inverse, drift = np.eye(size), np.zeros(size)
            inverse[-3:, -3:] = to_omega
            block = np.asarray(np.linalg.inv(inverse), dtype=np.float64)
            drift[-3:] = -block[-3:, -3:] @ change @ rates[angles]
            self._map.turn(k, block, drift, inverse)

    def _evaluated(self) -> Any:
        solver = self._exu.MainSolverImplicitSecondOrder()
        solver.InitializeSolver(self._system, self._settings)
        return solver

    def mass_matrix(self) -> Array:
        """ComputeMassMatrix of a solver."""
        return self._map.mass_matrix(self._mass_matrix())

    def _mass_matrix(self) -> Array:
        solver = self._evaluated()
        solver.ComputeMassMatrix(self._system)
        return array(solver.GetSystemMassMatrix())

    def _forces(self) -> Array:
        solver = self._evaluated()
        solver.ComputeODE2RHS(self._system)
        return array(solver.GetSystemResidual())[: len(self._map.matrix)]

    def bias(self) -> Array:
        """Return the opposite of ComputeODE2RHS."""
        return self._map.bias(-self._forces(), self._mass_matrix())

    def gravity_bias(self) -> Array:
        """Return the opposite of ComputeODE2RHS at rest."""
        own, rates = self._stored()
        self._put(own, np.zeros_like(rates))
        found = self._map.bias(-self._forces())
        self._put(own, rates)
        return found

    def accelerations(self) -> Array:
        """Return ODE2Coordinates_tt, after a step of an instant, which is undone."""
        own, rates = self._stored()
        if not self._has_stepped:
            self._solve(0.0, 1, _INSTANT_S, SOLVERS["explicit-euler"].called)
        found = array(self._system.systemData.GetODE2Coordinates_tt())
        self._put(own, rates)
        return self._map.accelerations(found)

    def wrenches(self) -> Array:
        """Nothing."""
        raise UnreportedError("an ObjectKinematicTree has no outputs of joint forces")

    def energy(self) -> Array:
        """Nothing."""
        raise UnreportedError("an ObjectKinematicTree has no output of its energy")

    def momenta(self) -> Array:
        """Return the sums over the links, from their velocities."""
        found = (self._sensed(name) for name in ("Position", "Velocity", "AngularVelocity"))
        return link_momenta(self._links, self._rotations(), *found)

    def poses(self) -> Array:
        """Return what the sensors give."""
        rotations = self._rotations()
        centres = zip(self._sensed("Position"), rotations, self._links, strict=True)
        return link_poses(self._links, [x - R @ link.centre for x, R, link in centres], rotations)

    def step(self, dt_s: float) -> tuple[Array, Array]:
        """Make one step by the explicit Euler method."""
        self._solve(0.0, 1, dt_s, SOLVERS["explicit-euler"].called)
        self._has_stepped = True
        return self.state()

    # --------------------------------------------------------------------------------------------- motion

    @classmethod
    def unmoved(cls, scene: TreeScene, method: str) -> str | None:  # noqa: ARG003
        """Refuse armatures, and dampers of balls."""
        joints = [body.joint for body in scene.bodies]
        if any(joint.armature for joint in joints):
            return "the adapter gives joints no armature"
        damped = any(joint.damping and joint.kind == "ball" for joint in joints)
        return "the adapter gives balls no dampers: they are three hinges" if damped else None

    def start(self, method: str, dt_s: float) -> None:
        """Choose the solver, and set the start."""
        self._solver, self._dt_s, self._steps = SOLVERS[method].called, dt_s, 0
        self.stepping = "python" if self._scene.loads else "native"
        self.push(())
        self.set_state(self._scene.q0, self._scene.u0)

    def push(self, loads: Sequence[tuple[TreeLoad, float]]) -> None:
        """Keep the loads, which act at every stage."""
        self._loads = tuple(loads)

    def _applied(self, _: Any, t_s: float, __: int, own: Array, rates: Array) -> Array:
        """Return the forces of the loads at the rates of Exudyn's joints."""
        q, u = self._in_our_coordinates(array(own), array(rates))
        return np.asarray(joint_forces(self._bare, self._loads, t_s, q, u) @ self._map.inverse)

    def advance(self, steps: int) -> None:
        """Make the steps by one call of the solver, from the end of the last."""
        if any(link.kind in ("ball", "free") for link in self._links):
            self.set_state(*self.state())
        self._solve(self._steps * self._dt_s, steps, self._dt_s, self._solver)
        self._steps += steps

    def _solve(self, start_s: float, steps: int, dt_s: float, solver: str) -> None:
        times = self._settings.timeIntegration
        times.startTime, times.numberOfSteps, times.endTime = start_s, steps, start_s + steps * dt_s
        weights = [link.mass * np.linalg.norm(self._scene.gravity) for link in self._links]
        size = float(np.sum(np.abs(self._forces())) + np.sum(weights))
        if np.isfinite(size):  # otherwise the motion has diverged
            times.newton.absoluteTolerance = ROUND_OFF * size
        kind = getattr(self._exu.DynamicSolverType, solver)
        self._system.SolveDynamic(self._settings, solverType=kind, updateInitialValues=True)

    def _stored(self) -> tuple[Array, Array]:
        data = self._system.systemData
        return array(data.GetODE2Coordinates()), array(data.GetODE2Coordinates_t())

    def state(self) -> tuple[Array, Array]:
        """Return the coordinates and rates of the system."""
        return self._in_our_coordinates(*self._stored())

    def _in_our_coordinates(self, own: Array, rates: Array) -> tuple[Array, Array]:
        self._turn(own, rates)
        parts = []
        for link, origin, first, last in zip(
            self._links, self._counted_from, self._starts, self._last, strict=True
        ):
            values = own[first : last + 1]
            if link.kind in ("ball", "free"):
                turn = matrix_to_quaternion(origin @ _rotation(values[-3:]))
                values = np.concatenate([values[:-3], turn])
            parts.append(values)
        return np.concatenate(parts), self._map.own_rates(rates)

    def held(self) -> TreeReadBack:
        """Read the tree from the system; the step is this adapter's."""
        tree, numbers = self._system.GetObject(self._tree), dict[str, list[Any]]()
        stiffness, damping, rest = (
            array(tree[f"joint{name}Vector"]) for name in ("PControl", "DControl", "PositionOffset")
        )
        for k, (link, frame) in enumerate(zip(self._links, self._frames, strict=True)):
            before, first, last = self._before(link), self._starts[k], self._last[k]
            turn = array(tree["jointTransformations"][first])
            one = {
                "mass": tree["linkMasses"][last],
                "inertia": frame @ array(tree["linkInertiasCOM"][last]) @ frame.T,
                "centre": frame @ array(tree["linkCOMs"][last]),
                "place": before @ array(tree["jointOffsets"][first]),
                "zero": matrix_to_quaternion(
                    before @ turn @ (self._counted_from[k] if link.kind == "ball" else frame).T
                ),
                "axis": frame[:, 0],
                "stiffness": stiffness[last],
                "damping": damping[last],
                "rest": rest[last],
            }
            for name, value in one.items():
                numbers.setdefault(name, []).append(value)
        q, u = self.state()
        stored = {name: np.array(values, dtype=np.float64) for name, values in numbers.items()}
        return TreeReadBack(self._dt_s, stored | {"gravity": array(tree["gravity"]), "q": q, "u": u})


def _rotation(angles: Array) -> Array:
    """R_x(a) R_y(b) R_z(c), child to zero frame, of three angles."""
    x, y, z = (exp_matrix(angle * axis) for angle, axis in zip(angles, np.eye(3), strict=True))
    return np.asarray(x @ y @ z)


def _omega_of_rates(angles: Array, rates: Array) -> tuple[Array, Array]:
    """Return E (3, 3) of omega = E rates, in child axes, and its derivative in time."""
    (_, sb, sc), (_, cb, cc), (_, b, c) = np.sin(angles), np.cos(angles), rates
    matrix = np.array([[cb * cc, sc, 0.0], [-cb * sc, cc, 0.0], [sb, 0.0, 1.0]])
    change = np.array(
        [
            [-sb * cc * b - cb * sc * c, cc * c, 0.0],
            [sb * sc * b - cb * cc * c, -sc * c, 0.0],
            [cb * b, 0.0, 0.0],
        ]
    )
    return matrix, change
