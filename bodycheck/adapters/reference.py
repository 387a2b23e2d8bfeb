"""The reference implementation as an engine: fixed-step integrators, closed form, Taylor series."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import cast, get_args

import numpy as np

from bodycheck.adapters.batches import Batch, BatchAnswer
from bodycheck.adapters.contract import Method, ReadBack, Reading, SceneSolver, Simulation, Solver, Stepping
from bodycheck.reference_impl.batch import BatchMethod, advance_batch
from bodycheck.reference_impl.closed_forms.exact_motion import closed_form_of
from bodycheck.reference_impl.continuous_loads import packed_continuous_loads
from bodycheck.reference_impl.integrators import SINGLE_PRECISION, STEPPED
from bodycheck.reference_impl.integrators.evaluated_loads import (
    advance_with_callback,
    omega_world,
    rotation_of_state,
    supports_callbacks,
)
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.integrators.right_hand_sides import packed_body
from bodycheck.reference_impl.pivot import about_pivot, load_about
from bodycheck.reference_impl.scene import ContinuousLoad, Drag, GravityGradient, Scene, WrenchFunction
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench, continuous_wrench_of

_POSITION, _VELOCITY, _SPIN = slice(0, 3), slice(3, 6), slice(6, 9)


class FixedStep:
    """A scene stepped by one of the reference's integrators."""

    stepping: Stepping

    def __init__(self, scene: Scene, integrator: Integrator, dt_s: float) -> None:
        self._scene, self._integrator, self._dt_s = scene, integrator, dt_s
        # A pivoted body is stepped as one that rotates about the pivot, which no force moves.
        self._stepped = about_pivot(scene)
        self._body = packed_body(self._stepped.body).astype(integrator.real)
        if scene.pivot is not None:
            self._body[0] = math.inf
        self.stepping = "python" if scene.has_callback_load else "native"
        self._callback = _callback_about_pivot(scene) if scene.has_callback_load else None
        self._continuous = np.zeros(0) if scene.has_callback_load else packed_continuous_loads(self._stepped)
        self.reset()

    def reset(self) -> None:
        """Go back to the initial state at t = 0, nothing but gravity acting."""
        initial, inertia = self._stepped.initial, self._stepped.body.inertia
        spin = {
            "omega_body": initial.omega_body,
            "omega_world": initial.omega_world,
            "angular_momentum": initial.rotation @ (inertia @ initial.omega_body),
        }[self._integrator.spin]
        attitude = (
            initial.quaternion if self._integrator.attitude == "quaternion" else initial.rotation.ravel()
        )
        state = np.concatenate([initial.position, initial.velocity, spin, attitude])
        self._state = state.astype(self._integrator.real)
        self._steps_made = 0
        self.apply(NO_WRENCH)

    def read_back(self) -> ReadBack:
        """Unpack what the kernels are given, which about a pivot is another inertia."""
        scene, stored_inertia = self._scene, self._body[1:10].reshape(3, 3)
        about = np.zeros((3, 3)) if scene.pivot is None else self._stepped.body.inertia - scene.body.inertia
        return ReadBack(
            mass=float(self._integrator.real(scene.body.mass)),
            inertia=stored_inertia - about,
            dt_s=float(self._integrator.real(self._dt_s)),
            gravity=scene.gravity.astype(self._integrator.real),
            state=self.read(),
        )

    def apply(self, wrench: Wrench) -> None:
        """Let this wrench act from now on."""
        scene = self._scene
        load = wrench.packed(scene.body, scene.gravity)
        load = load if scene.pivot is None else load_about(scene.pivot, load)
        self._load = load.astype(self._integrator.real)

    def advance(self, steps: int) -> None:
        """Make the steps in one compiled call; in Python where a user's function is called."""
        method, state, dt_s = self._integrator, self._state, self._dt_s
        begin = self._steps_made * dt_s
        if self._callback is not None:
            advance_with_callback(method, self._callback, state, self._body, self._load, begin, dt_s, steps)
        elif len(self._continuous):
            method.advance_forced(state, self._body, self._load, self._continuous, begin, dt_s, steps)
        else:
            method.advance(state, self._body, self._load, dt_s, steps)
        self._steps_made += steps

    def read(self) -> Reading:
        """Return copies of the state."""
        method, pivot, state = self._integrator, self._scene.pivot, self._state.copy()
        position, velocity, spin = state[_POSITION], state[_VELOCITY], state[_SPIN].copy()
        in_body = method.spin == "omega_body"
        rotation = state[9:].reshape(3, 3) if method.attitude == "matrix" else None
        omega = None
        if pivot is not None or not in_body:
            attitude = rotation_of_state(method, state)
            omega = omega_world(method, state, self._body, attitude)
            if pivot is not None:
                arm = attitude @ -pivot
                position, velocity = position + arm, np.cross(omega, arm)
        return Reading(
            position.astype(method.real),
            velocity.astype(method.real),
            quaternion=state[9:] if rotation is None else None,
            rotation=rotation,
            omega_world=None if in_body else omega,
            omega_body=spin if in_body else None,
        )

    def close(self) -> None:
        """Nothing to free."""


def _callback_about_pivot(scene: Scene) -> WrenchFunction:
    """Return what the continuous loads do to the body that is stepped: about the pivot, if there is one."""
    wrench = continuous_wrench_of(scene)
    if scene.pivot is None:
        return wrench
    from bodycheck.reference_impl.truth.step_halving import PivotPlace  # imported here: needs numba

    return PivotPlace.of(scene).about_pivot(wrench)


_EXACT = Method(
    name="exact",
    formula="q and omega at any t without stepping: Jacobi's elliptic functions, or about a fixed axis",
    order=None,
    evaluations=None,
    torque="in closed form",
    continuous_loads="in closed form",
    conserves="everything, to round-off",
    source="Jacobi (1849); van Zon and Schofield (2007), J. Comput. Phys. 225, 145",
    control="none",
)

_TAYLOR = Method(
    name="taylor",
    formula="q, omega, v and x by their Taylor series, each step as long as its last terms allow",
    order=None,
    evaluations=None,
    torque="every stage",
    continuous_loads="every stage",
    conserves="everything, to the tolerance per step",
    source="Jorba and Zou (2005), Experimental Mathematics 14, 99",
    control="tolerance",
    tolerances=(1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-16),
)

_NO_CLOSED_FORM = "no closed form for this body, this start and these loads"
_NO_SERIES = "a load given only as a function has no Taylor series"


def _method_of(integrator: Integrator) -> Method:
    single = integrator.real is np.float32
    return Method(
        name=integrator.name,
        formula=integrator.formula,
        order=integrator.order,
        evaluations=integrator.evaluations,
        torque=integrator.torque,
        continuous_loads=integrator.continuous,
        conserves=integrator.conserves,
        source=integrator.source,
        precision="float32" if single else "float64",
        only_on_request=single,
    )


class ClosedForm(SceneSolver):
    """A scene by its exact solution: set up once when built, then any sample at the same cost."""

    def __init__(self, scene: Scene) -> None:
        motion = closed_form_of(scene)
        if motion is None:
            raise ValueError(_NO_CLOSED_FORM)
        super().__init__(scene)
        self._motion = motion

    def solve(self) -> Trajectory:
        """Solve for all samples in one call."""
        return self._motion.at(self._scene.sample_times)


class TaylorSeries(SceneSolver):
    """A scene by the Taylor integrator: packed once when built, its samples from the series' dense output."""

    def __init__(self, scene: Scene, tolerance: float) -> None:
        from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion  # imported here: needs numba

        super().__init__(scene)
        self._motion = TaylorMotion.of(scene, tolerance)

    def solve(self) -> Trajectory:
        """Follow the motion through all samples."""
        solved = self._motion.solve(self._scene.sample_times)
        self.steps = solved.steps
        return solved.trajectory


class Reference:
    """The reference as one engine among the others."""

    name = "reference"
    tree_model = "bodycheck.adapters.reference_tree:ReferenceTree"

    def __init__(self) -> None:
        self.version = version("bodycheck")
        self.methods: Mapping[str, Method] = {
            _EXACT.name: _EXACT,
            _TAYLOR.name: _TAYLOR,
            **{name: _method_of(integrator) for name, integrator in STEPPED.items()},
        }

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Say what a method is not for; a link frame means nothing where no engine is between."""
        if method == _EXACT.name:
            return _NO_CLOSED_FORM if scene.has_callback_load or closed_form_of(scene) is None else None
        if method == _TAYLOR.name:
            return _NO_SERIES if scene.has_callback_load else None
        if method in SINGLE_PRECISION and scene.continuous_loads:
            return f"{method} supports only constant loads"
        if scene.has_callback_load and not supports_callbacks(STEPPED[method]):
            return f"{method} evaluates loads at its stages in compiled code, which cannot call a function"
        if scene.pivot is not None and any(isinstance(load, GravityGradient) for load in scene.loads):
            return "a gravity gradient is reduced to no torque about a pivot"
        refused = _refused(STEPPED[method], scene.continuous_loads)
        return f"{method} does not support {', '.join(refused)}: its kicks must be exact" if refused else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Return a stepper of the scene."""
        return FixedStep(scene, STEPPED[method], dt_s)

    def record_batch(self, batch: Batch) -> BatchAnswer | None:
        """Step bodies under constant torques by a batch kernel; None where there is none."""
        template = batch.template
        is_loaded = template.loads or template.gravity.any() or template.pivot is not None
        if is_loaded or batch.method not in get_args(BatchMethod):
            return None
        return _stepped_together(batch, cast("BatchMethod", batch.method))

    def solver(self, scene: Scene | TreeScene, method: str, tolerance: float | None) -> Solver:
        """Return the closed form of the scene, or its Taylor series."""
        if isinstance(scene, TreeScene):
            from bodycheck.adapters.reference_tree import TreeSeriesSolver  # imported here: needs numba

            assert tolerance is not None
            return TreeSeriesSolver(scene, tolerance)
        if method == _EXACT.name:
            return ClosedForm(scene)
        assert tolerance is not None
        return TaylorSeries(scene, tolerance)


def _stepped_together(batch: Batch, method: BatchMethod) -> BatchAnswer:
    bodies, dt_s, stride = batch.bodies, batch.dt_s, batch.steps_per_sample
    assert dt_s is not None
    state = np.zeros((13, len(bodies)))
    state[6:9], state[9:] = bodies.omega_body.T, bodies.quaternion.T
    moments, torque = np.ascontiguousarray(bodies.moments.T), np.ascontiguousarray(bodies.torque_body.T)
    states = [state.copy()]
    for _ in range(batch.template.samples - 1):
        advance_batch(state, moments, torque, dt_s, stride, method)
        states.append(state.copy())
    motion = np.array(states).transpose(2, 0, 1)
    return BatchAnswer.all_ok(np.ascontiguousarray(motion[..., 9:]), np.ascontiguousarray(motion[..., 6:9]))


def _refused(method: Integrator, loads: Sequence[ContinuousLoad]) -> list[str]:
    """Return the kinds that a method cannot take; one that takes no drag takes no other damping either."""
    velocity_too = Drag in method.refused
    return [
        load.kind
        for load in loads
        if isinstance(load, method.refused) or (velocity_too and load.depends_on_velocity)
    ]
