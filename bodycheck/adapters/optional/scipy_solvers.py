"""SciPy's ODE solvers by tolerance, applied to the equations of motion without an engine.

y = (x, v, q, omega_body), x' = v, v' = F / m, q' = q omega / 2, I omega' = tau - omega x I omega.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from bodycheck.adapters.contract import Method, SceneSolver, Simulation, Solver
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.adapters.optional.between_steps import OnRequest
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import wrench_between

_FORMULAS = {
    "dop853": (
        "DOP853",
        "explicit Runge-Kutta of order 8 with error control",
        "Hairer, Norsett and Wanner (1993)",
    ),
    "radau": ("Radau", "implicit Radau IIA of order 5 with error control", "Hairer and Wanner (1996)"),
    "lsoda": ("LSODA", "Adams and BDF methods, order and step chosen by ODEPACK", "Petzold (1983)"),
}
TOLERANCES = (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)


def by_tolerance(name: str, formula: str, source: str, snippet: str, tolerances: tuple[float, ...]) -> Method:
    """Return the facts of a solver of ordinary differential equations with error control."""
    return Method(
        name=name,
        formula=formula,
        order=None,
        evaluations=None,
        torque="every stage",
        continuous_loads="every stage",
        conserves="everything, to the tolerance per step",
        source=source,
        control="tolerance",
        tolerances=tolerances,
        snippet=snippet,
    )


class SciPy(OnRequest):
    """scipy.integrate."""

    name = "scipy"
    distribution = "scipy"
    requires = ("scipy>=1.13",)
    modules = ("scipy.integrate",)
    methods: Mapping[str, Method] = {
        name: by_tolerance(name, formula, source, f"solve_ivp(f, t_span, y0, method='{called}')", TOLERANCES)
        for name, (called, formula, source) in _FORMULAS.items()
    }

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse pivots; a link frame means nothing where no engine is between."""
        return "the equations are those of a free body" if scene.pivot is not None else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Raise: every method is controlled by a tolerance."""
        raise NotImplementedError("these solvers have no fixed steps")

    def solver(self, scene: Scene, method: str, tolerance: float | None) -> Solver:
        """Return a solver of the equations of motion."""
        assert tolerance is not None
        return _SciPySolver(scene, _FORMULAS[method][0], tolerance)


class _SciPySolver(SceneSolver):
    """The motion from sample to sample, restarted wherever a load switches."""

    def __init__(self, scene: Scene, solver: str, tolerance: float) -> None:
        import scipy.integrate

        super().__init__(scene)
        self._tolerance = tolerance
        self._make = getattr(scipy.integrate, solver)
        self._loads = StageLoads(scene)
        self._inverse = np.linalg.inv(scene.body.inertia)

    def solve(self) -> Trajectory:
        """Solve from switch to switch, and evaluate the dense output at the samples."""
        scene, t = self._scene, self._scene.sample_times
        y, samples, self.steps = start_of(scene), np.empty((scene.samples, 13)), 0
        samples[0] = y
        for begin, end in segments(scene):
            self._loads.wrench = wrench_between(scene, begin, end)
            solver = self._make(self._rate, begin, y, end, rtol=self._tolerance, atol=self._tolerance)
            while solver.status == "running":
                if message := solver.step():
                    raise RuntimeError(message)
                self.steps += 1
                inside = (solver.t_old < t) & (t <= solver.t)
                if inside.any():
                    samples[inside] = solver.dense_output()(t[inside]).T
            if solver.status == "failed":
                raise RuntimeError("the solver cannot meet its tolerance")
            y = solver.y
        return trajectory_of_states(t, samples)

    def _rate(self, t: float, y: Array) -> Array:
        velocity, q, omega = y[3:6], y[6:10], y[10:]
        rotation = quaternion_to_matrix(q)
        force, torque = self._loads.at(t, y[:3], rotation, velocity, rotation @ omega)
        spin = self._inverse @ (torque - np.cross(omega, self._scene.body.inertia @ omega))
        quaternion_rate = 0.5 * quaternion_product(q, np.concatenate([[0.0], omega]))
        return np.concatenate([velocity, force / self._scene.body.mass, quaternion_rate, spin])


def segments(scene: Scene) -> list[tuple[float, float]]:
    """Return (begin, end) in s of the intervals within which no load switches."""
    return list(pairwise([0.0, *scene.switches_before(scene.duration_s), scene.duration_s]))


def start_of(scene: Scene) -> Array:
    """Return (x, v, q, omega_body) (13,) at t = 0."""
    start = scene.initial
    return np.concatenate([start.position, start.velocity, start.quaternion, start.omega_body])


def trajectory_of_states(t_s: Array, states: Array) -> Trajectory:
    """Return the trajectory of the states (n, 13) at the times (n,)."""
    return Trajectory(
        t_s=t_s,
        position_m=states[:, :3],
        velocity_m_s=states[:, 3:6],
        quaternion=states[:, 6:10],
        omega_body_rad_s=states[:, 10:],
    )
