"""Newton: one free body by each of its solvers that accepts one, in float32 on the CPU.

body_q = (x, y, z, qx, qy, qz, qw), body_qd = (velocity of the centre of mass, omega) and body_f = (force,
torque), in world axes. A solver steps from one state into another, whose forces it ignores.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import (
    BetweenSteps,
    FreeBodiesOnly,
    array,
    scalar_first,
    scalar_last,
)
from bodycheck.adapters.optional.mujoco_warp import NO_DERIVATIVES
from bodycheck.adapters.optional.newton_solvers import SOLVERS, NewtonSolver, finalized
from bodycheck.adapters.tree_contract import UnreportedError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.imu import has_imu, imu_point
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.wrench import plan_steps

if TYPE_CHECKING:
    from bodycheck.adapters.gradients import Gradients


def _methods() -> dict[str, Method]:
    found = {}
    for name, solver in SOLVERS.items():
        method = Method(
            name=name,
            formula=solver.formula,
            order=solver.order,
            evaluations=4 if name.endswith("rk4") else 1,
            torque="zero-order hold",
            conserves="|q| = 1; linear momentum",
            source=f"Newton, newton.solvers.{solver.name}",
            changed_defaults=solver.changed,
            snippet=f"newton.solvers.{solver.name}(model{_words(solver.options)})"
            ".step(s0, s1, None, None, {dt_s})",
            precision="float32",
            rounding_bias=solver.bias,
        )
        found[name] = method
        if solver.changed:
            found[f"{name}{DEFAULTS}"] = replace(
                method, name=f"{name}{DEFAULTS}", conserves="|q| = 1", changed_defaults=(),
                formula=f"omega damped by 1 - 0.05 dt, then {method.formula}",
                snippet=f"newton.solvers.{solver.name}(model).step(s0, s1, None, None, {{dt_s}})",
            )  # fmt: skip
    return found


def _words(options: Mapping[str, Any]) -> str:
    return "".join(f", {name}={value!r}" for name, value in options.items())


class Newton(FreeBodiesOnly):
    """Newton (Linux Foundation) on Warp."""

    name = "newton"
    distribution = "newton"
    requires = ("newton[sim]>=1.8",)
    modules = ("newton",)
    methods: Mapping[str, Method] = _methods()
    tree_model = "bodycheck.adapters.optional.newton_tree:NewtonTree"

    def __init__(self) -> None:
        import newton
        import warp

        warp.config.quiet = True
        self._newton: Any = newton
        super().__init__()

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a model of one body."""
        return BetweenSteps(scene, dt_s, _Body(self._newton, scene, method, dt_s))

    def gradients(self, scene: Scene, method: str, dt_s: float) -> Gradients:
        """Differentiate all steps in reverse mode, by wp.Tape."""
        if method.startswith("mujoco"):
            raise UnreportedError(NO_DERIVATIVES)
        solver = SOLVERS[method.removesuffix(DEFAULTS)]
        options = {} if method.endswith(DEFAULTS) else solver.options
        return _taped_gradients(self._newton, scene, solver, options, dt_s)


_SHORT_S = 1e-6


def _model(newton: Any, scene: Scene, site: Array | None = None, **options: bool) -> Any:
    builder = newton.ModelBuilder()
    inertia = [float(value) for value in scene.body.inertia.ravel()]
    body = builder.add_body(mass=scene.body.mass, inertia=inertia, lock_inertia=True)
    if site is not None:
        import warp

        builder.add_site(body, xform=warp.transform(site.tolist(), warp.quat_identity()))
    return finalized(builder, scene.gravity, **options)


class _Body:
    stepping: Stepping = "python"

    def __init__(self, newton: Any, scene: Scene, method: str, dt_s: float) -> None:
        self._newton, self._dt_s = newton, dt_s
        solver = SOLVERS[method.removesuffix(DEFAULTS)]
        # only this solver stores accelerations, and not in releases without observables
        stores = solver.name == "SolverMuJoCo" and hasattr(newton.solvers.SolverMuJoCo, "observables")
        has_sensors = stores and has_imu(scene)
        self._model = _model(newton, scene, site=imu_point(scene) if has_sensors else None)
        options = {} if method.endswith(DEFAULTS) else solver.options
        self._solver = getattr(newton.solvers, solver.name)(self._model, **options)
        self._now, self._next = self._model.state(), self._model.state()
        if has_sensors:
            self._sensor = newton.sensors.SensorIMU(self._model, sites="*", request_state_attributes=False)
            self._observed = self._solver.observables(kinds=self._sensor.solver_observable_kinds)
            self.imu = self._read_imu

    def model(self) -> tuple[float, Array, float, Array]:
        model = self._model
        inertia = array(model.body_inertia.numpy()).reshape(3, 3)
        return float(model.body_mass.numpy()[0]), inertia, self._dt_s, array(model.gravity.numpy()[0])

    def set_state(self, state: State) -> None:
        for one in (self._now, self._next):
            _put(self._newton, self._model, one, state)

    def step(self, steps: int, force: Array, torque: Array) -> None:
        pushed = bool(np.any(force) or np.any(torque))
        for _ in range(steps):
            if pushed:
                self._now.body_f.assign(np.concatenate([force, torque])[np.newaxis])
            self._solver.step(self._now, self._next, None, None, self._dt_s)
            if pushed:
                self._now.body_f.zero_()
            self._now, self._next = self._next, self._now

    def _read_imu(self, force: Array, torque: Array) -> tuple[Array, Array]:
        """Read the sensors in the present state, for which a short step gives the accelerations."""
        now = self._now
        now.body_f.assign(np.concatenate([force, torque])[np.newaxis])
        self._solver.step(now, self._next, None, None, _SHORT_S, observables=self._observed)
        now.body_f.zero_()
        self._sensor.update(now, observables=self._observed)
        return array(self._sensor.accelerometer.numpy()[0]), array(self._sensor.gyroscope.numpy()[0])

    def read(self) -> Reading:
        pose, rates = array(self._now.body_q.numpy()[0]), array(self._now.body_qd.numpy()[0])
        return Reading(pose[:3], rates[:3], quaternion=scalar_first(pose[3:]), omega_world=rates[3:])


def _put(newton: Any, model: Any, held: Any, state: State) -> None:
    pose = np.concatenate([state.position, scalar_last(state.quaternion)])
    rates = np.concatenate([state.velocity, state.omega_world])
    held.body_q.assign(pose[np.newaxis])
    held.body_qd.assign(rates[np.newaxis])
    held.body_f.zero_()
    newton.eval_ik(model, held, held.joint_q, held.joint_qd)


def _taped_gradients(
    newton: Any, scene: Scene, solver: NewtonSolver, options: Mapping[str, Any], dt_s: float
) -> Gradients:
    """Return the derivatives of all steps under loads that are constant in world axes.

    The tape is run back once per component of the attitude and of omega at the end. The inertia and its
    inverse are two arrays of a model; omega at the start is one of the body and one of its joint.
    """
    import warp

    from bodycheck.adapters.gradients import Gradients

    model, plan = _model(newton, scene, requires_grad=True), plan_steps(scene, dt_s)
    wrench = next(plan.legs()).wrench
    states = [model.state(requires_grad=True) for _ in range(plan.steps + 1)]
    _put(newton, model, states[0], scene.initial)
    for state in states:
        state.body_f.assign(np.concatenate([wrench.force_world, wrench.torque_world])[np.newaxis])
    with warp.Tape() as tape:
        stepper = getattr(newton.solvers, solver.name)(model, **options)
        for one, following in pairwise(states):
            stepper.step(one, following, None, None, dt_s)
    start, end, rotation = states[0], states[-1], scene.initial.rotation
    squared = np.diag(scene.body.inertia) ** 2
    slopes = []
    for held, component in [
        (end.body_q, 6),
        *((end.body_q, i) for i in (3, 4, 5)),
        *((end.body_qd, i) for i in (3, 4, 5)),
    ]:
        seed = np.zeros(held.numpy().shape, dtype=np.float32)
        seed[0, component] = 1.0
        tape.backward(grads={held: warp.array(seed, dtype=held.dtype, device="cpu")})
        by_inertia, by_inverse = (
            np.diag(array(of.grad.numpy()[0])) for of in (model.body_inertia, model.body_inv_inertia)
        )
        by_omega = array(start.body_qd.grad.numpy()[0, 3:]) + array(start.joint_qd.grad.numpy()[3:])
        slopes.append(np.concatenate([by_inertia - by_inverse / squared, rotation.T @ by_omega]))
        tape.zero()
    rows, pose, rates = np.array(slopes), array(end.body_q.numpy()[0]), array(end.body_qd.numpy()[0])
    return Gradients.of_world(scalar_first(pose[3:]), rows[:4], rates[3:], rows[4:])
