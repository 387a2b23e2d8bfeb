"""Drake: a MultibodyPlant with one floating body, discrete or by a fixed-step integrator.

q = (qw, qx, qy, qz, x, y, z) of the body frame, v = (omega, velocity of the body's origin) in world axes. The
quaternion is never normalised. Loads come from a system whose output is evaluated at every stage.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Stepping
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.adapters.frames import link_frame
from bodycheck.adapters.optional.between_steps import OnRequest, array
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.imu import has_imu, imu_point
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench


@dataclass(frozen=True)
class _Scheme:
    """An integration scheme of Drake: its order and its formula."""

    order: int
    evaluations: int | None
    formula: str


_OF_STATE = ", omega in world axes, additive quaternion"
_SCHEMES = {
    "semi-explicit-euler": _Scheme(1, 1, "M1, additive quaternion"),
    "explicit-euler": _Scheme(1, 1, "M1, pose from the old omega, omega in world axes, additive quaternion"),
    "implicit-euler": _Scheme(1, None, "y+ = y + h f(t + h, y+)"),
    "velocity-implicit-euler": _Scheme(
        1, None, "implicit Euler for the velocities alone, q by the new velocity"
    ),
    "radau1": _Scheme(1, None, "Radau IIA with one stage"),
    "radau3": _Scheme(3, None, "Radau IIA with two stages"),
    "runge-kutta2": _Scheme(2, 2, f"Heun 2{_OF_STATE}"),
    "runge-kutta3": _Scheme(3, 3, f"RK3 (Kutta){_OF_STATE}"),
    "bogacki-shampine3": _Scheme(3, 4, f"RK3 (Ralston){_OF_STATE}; Bogacki and Shampine's pair 3(2)"),
    "runge-kutta5": _Scheme(5, 7, f"RK5 (Dormand-Prince){_OF_STATE}"),
}
_CONSERVES = "nothing: the quaternion is not normalised"
_DISCRETE = Method(
    name="discrete",
    formula="M1, additive quaternion",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves=_CONSERVES,
    source="Drake, MultibodyPlant with a time step",
    snippet="plant = MultibodyPlant(time_step={dt_s})",
)


def _method_of(name: str, scheme: _Scheme) -> Method:
    drake_name = name.replace("-", "_")
    return Method(
        name=name,
        formula=scheme.formula,
        order=scheme.order,
        evaluations=scheme.evaluations,
        torque="every stage",
        continuous_loads="every stage",
        conserves=_CONSERVES,
        source=f"Drake, ResetIntegratorFromFlags('{drake_name}')",
        changed_defaults=("fixed steps in place of error control",),
        snippet=f"ResetIntegratorFromFlags(simulator, '{drake_name}', {{dt_s}}).set_fixed_step_mode(True)",
    )


class Drake(OnRequest):
    """Drake (Tedrake et al.) through pydrake.

    Pivots are refused: its ball joint has angles with a singularity.
    """

    name = "drake"
    distribution = "drake"
    requires = ("drake>=1.51",)
    modules = ("pydrake.all",)
    methods: Mapping[str, Method] = {
        _DISCRETE.name: _DISCRETE,
        **{name: _method_of(name, scheme) for name, scheme in _SCHEMES.items()},
    }
    tree_model = "bodycheck.adapters.optional.drake_tree:DrakeTree"

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a plant with one body."""
        return DrakeSimulation(scene, method, dt_s)


class DrakeSimulation:
    """A simulator of a plant, and of the loads where the scene has any."""

    def __init__(self, scene: Scene, method: str, dt_s: float) -> None:
        import pydrake.all
        from pydrake.all import DiagramBuilder, MultibodyPlant, ResetIntegratorFromFlags, Simulator

        self._scene, self._dt_s, self._link = scene, dt_s, link_frame(scene)
        self._loads = StageLoads(replace(scene, gravity=np.zeros(3)))  # the plant applies the weight
        self.stepping: Stepping = "python" if scene.loads else "native"
        discrete = method == _DISCRETE.name
        builder = DiagramBuilder()
        self._plant = builder.AddSystem(MultibodyPlant(dt_s if discrete else 0.0))
        self._body = self._plant.AddRigidBody("body", self._inertia())
        self._plant.mutable_gravity_field().set_gravity_vector(scene.gravity)
        if discrete:  # else its accelerations are those of the last step
            self._plant.SetUseSampledOutputPorts(False)
        self._plant.Finalize()
        if scene.loads:
            loads = builder.AddSystem(_load_system(self._plant, self._body, self._force_on_link))
            builder.Connect(self._plant.get_state_output_port(), loads.get_input_port())
            builder.Connect(loads.get_output_port(), self._plant.get_applied_spatial_force_input_port())
        can_measure = has_imu(scene) and hasattr(pydrake.all, "Accelerometer")  # older releases have none
        sensors = self._sensors(builder) if can_measure else ()
        self._simulator = Simulator(builder.Build())
        self._root = self._simulator.get_mutable_context()
        if sensors:
            self.imu = partial(_measured, sensors, self._root)
        self._context = self._plant.GetMyMutableContextFromRoot(self._root)
        self._integrator: Any = None
        if not discrete:
            self._integrator = ResetIntegratorFromFlags(self._simulator, method.replace("-", "_"), dt_s)
            self._integrator.set_fixed_step_mode(True)
        self.reset()

    def _sensors(self, builder: Any) -> tuple[Any, Any]:
        """Add an accelerometer and a gyroscope with the axes of the body."""
        from pydrake.all import Accelerometer, Gyroscope, RigidTransform, RotationMatrix

        plant, at = self._plant, self._link.point(imu_point(self._scene))
        pose = RigidTransform(RotationMatrix(self._link.rotation.T), at)
        accelerometer = builder.AddSystem(Accelerometer(self._body, pose, self._scene.gravity))
        gyro = builder.AddSystem(Gyroscope(self._body, pose))
        for sensor in (accelerometer, gyro):
            builder.Connect(plant.get_body_poses_output_port(), sensor.get_body_poses_input_port())
            builder.Connect(
                plant.get_body_spatial_velocities_output_port(), sensor.get_body_velocities_input_port()
            )
        builder.Connect(
            plant.get_body_spatial_accelerations_output_port(),
            accelerometer.get_body_accelerations_input_port(),
        )
        return accelerometer, gyro

    def _inertia(self) -> Any:
        from pydrake.all import RotationalInertia, SpatialInertia

        rotation = self._link.rotation
        inertia = rotation.T @ self._scene.body.inertia @ rotation
        moments = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
        centre = self._link.point(np.zeros(3))
        return SpatialInertia.MakeFromCentralInertia(
            self._scene.body.mass, centre, RotationalInertia(*moments)
        )

    def reset(self) -> None:
        """Restore the initial state at t = 0, without a wrench."""
        position, quaternion, velocity = self._link.of_origin(self._scene.initial)
        self._root.SetTime(0.0)
        self._plant.SetPositions(self._context, np.concatenate([quaternion, position]))
        self._plant.SetVelocities(self._context, np.concatenate([self._scene.initial.omega_world, velocity]))
        self._steps_made = 0
        self.apply(NO_WRENCH)
        self._simulator.Initialize()

    def apply(self, wrench: Wrench) -> None:
        """Replace the constant loads; setting the time drops what was computed from the former ones."""
        self._loads.wrench = wrench
        self._root.SetTime(self._root.get_time())

    def advance(self, steps: int) -> None:
        """Make the steps in one call; where an end is off by round-off, Drake adds a step of that size."""
        self._steps_made += steps
        self._simulator.AdvanceTo(self._steps_made * self._dt_s)

    def _force_on_link(self, t_s: float, state: Array) -> tuple[Array, Array]:
        """Return force and torque (3,) about the centre of mass in world axes, of a state (q, v)."""
        position, quaternion, velocity = self._link.of_body(state[4:7], state[:4], state[10:], state[7:10])
        rotation = quaternion_to_matrix(quaternion)
        force, torque = self._loads.at(t_s, position, rotation, velocity, state[7:10])
        return force, rotation @ torque

    def read(self) -> Reading:
        """Return copies of the plant's positions and velocities, the quaternion as it is."""
        q, v = self._plant.GetPositions(self._context), self._plant.GetVelocities(self._context)
        position, quaternion, velocity = self._link.of_body(q[4:], q[:4], v[3:], v[:3])
        return Reading(position, velocity, quaternion=quaternion, omega_world=v[:3].copy())

    def read_back(self) -> ReadBack:
        """Return the model as read from the plant and the integrator."""
        inertia = self._body.CalcSpatialInertiaInBodyFrame(self._context)
        central = inertia.Shift(inertia.get_com()).CalcRotationalInertia().CopyToFullMatrix3()
        rotation = self._link.rotation
        step = (
            self._plant.time_step() if self._integrator is None else self._integrator.get_maximum_step_size()
        )
        gravity = np.array(self._plant.gravity_field().gravity_vector())
        return ReadBack(inertia.get_mass(), rotation @ central @ rotation.T, step, gravity, self.read())

    def close(self) -> None:
        """Do nothing; the simulator is freed with this object."""


def _measured(sensors: tuple[Any, Any], root: Any) -> tuple[Array, Array]:
    """Return specific force and rate (3,), as the sensors read them in the present state."""
    force, rate = (
        array(one.get_measurement_output_port().Eval(one.GetMyContextFromRoot(root))) for one in sensors
    )
    return force, rate


def _load_system(plant: Any, body: Any, force_and_torque: Any) -> Any:
    """Return a system: the plant's state -> the force on its body, at any stage."""
    from pydrake.all import ExternallyAppliedSpatialForce, LeafSystem, SpatialForce, Value

    class Loads(LeafSystem):  # type: ignore[misc]
        def __init__(self) -> None:
            LeafSystem.__init__(self)
            self.DeclareVectorInputPort("state", plant.num_multibody_states())
            self.DeclareAbstractOutputPort(
                "forces", lambda: Value[list[ExternallyAppliedSpatialForce]](), self.calculate
            )

        def calculate(self, context: Any, output: Any) -> None:
            state = self.get_input_port().Eval(context)
            force, torque = force_and_torque(context.get_time(), state)
            acting = ExternallyAppliedSpatialForce()
            acting.body_index = body.index()
            acting.p_BoBq_B = body.default_com()
            acting.F_Bq_W = SpatialForce(tau=torque, f=force)
            output.set_value([acting])

    return Loads()
