"""heyoka's adaptive Taylor method by tolerance, applied to the equations of motion without an engine."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bodycheck.adapters.contract import Method, SceneSolver, Simulation, Solver
from bodycheck.adapters.optional.between_steps import OnRequest
from bodycheck.adapters.optional.scipy_solvers import (
    by_tolerance,
    segments,
    start_of,
    trajectory_of_states,
)
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import wrench_between

_TAYLOR = by_tolerance(
    "taylor",
    "Taylor series of order ceil(1 - ln(tolerance) / 2), each step as long as its last terms allow",
    "Biscani and Izzo (2021), Mon. Not. R. Astron. Soc. 504, 2614",
    "heyoka.taylor_adaptive(equations, state, tol=tolerance)",
    (1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14, 1e-16),
)
_NO_SERIES = "loads that vary with time or motion are not available as heyoka expressions"


class Heyoka(OnRequest):
    """heyoka (Biscani and Izzo 2021) through heyoka.py."""

    name = "heyoka"
    distribution = "heyoka"
    requires = ("heyoka>=7.10.1",)
    modules = ("heyoka",)
    methods: Mapping[str, Method] = {_TAYLOR.name: _TAYLOR}

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse pivots and continuous loads."""
        if scene.pivot is not None:
            return "the equations are those of a free body"
        return _NO_SERIES if scene.continuous_loads else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Raise: the method is controlled by a tolerance."""
        raise NotImplementedError("heyoka has no fixed steps")

    def solver(self, scene: Scene, method: str, tolerance: float | None) -> Solver:  # noqa: ARG002
        """Return a solver of the equations of motion."""
        assert tolerance is not None
        return _HeyokaSolver(scene, tolerance)


class _HeyokaSolver(SceneSolver):
    def __init__(self, scene: Scene, tolerance: float) -> None:
        import heyoka

        super().__init__(scene)
        self._integrator = heyoka.taylor_adaptive(
            _equations(scene), start_of(scene), tol=tolerance, pars=[0.0] * 21
        )

    def solve(self) -> Trajectory:
        """Propagate from switch to switch through the samples."""
        scene, integrator, t = self._scene, self._integrator, self._scene.sample_times
        samples, self.steps = np.empty((scene.samples, 13)), 0
        integrator.time, integrator.state[:] = 0.0, start_of(scene)
        for begin, end in segments(scene):
            integrator.pars[:] = wrench_between(scene, begin, end).packed(scene.body, scene.gravity)
            inside = (begin <= t) & (t <= end)
            grid = np.unique([begin, *t[inside], end])
            outcome = integrator.propagate_grid(grid)
            self.steps += outcome[3]
            samples[inside] = outcome[-1][np.searchsorted(grid, t[inside])]
        return trajectory_of_states(t, samples)


def _equations(scene: Scene) -> list[tuple[Any, Any]]:
    """x' = v, v' = F / m, q' = q omega / 2, I omega' = tau - omega x I omega; par: `Wrench.packed`."""
    import heyoka

    par, body = [heyoka.par[i] for i in range(21)], scene.body
    x, v = heyoka.make_vars("x0", "x1", "x2"), heyoka.make_vars("v0", "v1", "v2")
    q, omega = heyoka.make_vars("qw", "qx", "qy", "qz"), heyoka.make_vars("w0", "w1", "w2")
    w, i, j, k = q
    a, b, c = omega
    rotation = np.array(
        [
            [1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j - w * k), 2.0 * (i * k + w * j)],
            [2.0 * (i * j + w * k), 1.0 - 2.0 * (i * i + k * k), 2.0 * (j * k - w * i)],
            [2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)],
        ]
    )
    force_body, force_world, torque_body, torque_world = np.array(par[:12]).reshape(4, 3)
    moment = np.array(par[12:]).reshape(3, 3) @ rotation  # sum of at (R^T force)^T
    force = rotation @ force_body + force_world
    momentum = body.inertia @ np.array(omega)
    torque = torque_body + rotation.T @ torque_world - np.array(_cross(omega, momentum))
    torque = torque + np.array([moment[m, n] - moment[n, m] for m, n in ((1, 2), (2, 0), (0, 1))])
    quaternion_rate = [
        -0.5 * (i * a + j * b + k * c),
        0.5 * (w * a + j * c - k * b),
        0.5 * (w * b + k * a - i * c),
        0.5 * (w * c + i * b - j * a),
    ]
    rates = [*v, *(force / body.mass), *quaternion_rate, *(np.linalg.inv(body.inertia) @ torque)]
    return list(zip([*x, *v, *q, *omega], rates, strict=True))


def _cross(a: Any, b: Any) -> list[Any]:
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
