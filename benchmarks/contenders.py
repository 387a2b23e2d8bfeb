"""The solvers of a body that are measured side by side, each with its settings from cheap to expensive."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numba
import numpy as np
import scipy
from scipy.integrate import solve_ivp

from benchmarks.problems import End, Problem
from benchmarks.solver import Contender, Solver, step_counts, tolerances
from bodycheck.adapters.contract import Adapter, Reading
from bodycheck.adapters.mujoco import MuJoCo
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.free_rotation import FreeRotation
from bodycheck.reference_impl.scene import Scene, Torque
from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion
from bodycheck.reference_impl.wrench import wrench_between

MUJOCO, SCIPY, HEYOKA = "MuJoCo rk4", "scipy DOP853", "heyoka Taylor"


def _evaluation(problem: Problem, _: float) -> Solver:
    """Jacobi's closed form of a free body, set up before; a run solves for the end."""
    motion, t_s = _free_rotation(problem.scene), np.array([problem.scene.duration_s])
    motion.at(t_s)
    return Solver(lambda: motion.at(t_s), end_of=_only_row)


def _with_set_up(problem: Problem, _: float) -> Solver:
    scene, t_s = problem.scene, np.array([problem.scene.duration_s])
    _free_rotation(scene).at(t_s)
    return Solver(lambda: _free_rotation(scene).at(t_s), end_of=_only_row)


def _free_rotation(scene: Scene) -> FreeRotation:
    return FreeRotation.from_state(scene.body.inertia, scene.initial.quaternion, scene.initial.omega_body)


def _only_row(solved: tuple[Array, Array]) -> End:
    return solved[0][0], solved[1][0]


CLOSED_FORM = Contender("closed form", "", "none", (0.0,), _with_set_up)
CLOSED_FORM_SET_UP_BEFORE = Contender("closed form, set up before", "", "none", (0.0,), _evaluation)


def _taylor(problem: Problem, tolerance: float) -> Solver:
    """Ours for any load: the adaptive Taylor integrator in doubles."""
    motion, t_s = TaylorMotion.of(problem.scene, tolerance), np.array([problem.scene.duration_s])
    motion.solve(t_s)
    return Solver(lambda: motion.solve(t_s), end_of=lambda solved: _parts(solved.states[0]))


def _parts(state: Array) -> End:
    """Return the quaternion and omega of a state that begins with both."""
    return state[:4], state[4:7]


# With steps that err by 1e-2 a body gains energy without end over 1000 s, and its steps shrink without end.
STEPPED_TAYLOR = Contender("Taylor", "", "tolerance", tolerances(1e-3, 1e-17), _taylor)


def _engine(name: str, adapter: Adapter, method: str) -> Contender:
    """A method of an engine through bodycheck's own adapter, so that what is timed here is what a run times.

    A run makes all the steps in one call of the engine.
    """

    def prepare(problem: Problem, steps: float) -> Solver:
        scene = problem.scene
        simulation = adapter.build(scene, method, scene.duration_s / steps)
        wrench = wrench_between(scene, 0.0, scene.duration_s)

        def reset() -> None:
            simulation.reset()
            simulation.apply(wrench)

        return Solver(
            lambda: simulation.advance(int(steps)), reset, end_of=lambda _: _reported(simulation.read())
        )

    return Contender(name, adapter.version, "steps", step_counts(8, 1 << 15), prepare)


def _reported(reading: Reading) -> End:
    assert reading.quaternion is not None
    assert reading.omega_body is not None
    return reading.quaternion, reading.omega_body


def _equations(scene: Scene) -> Callable[..., tuple[Any, ...]]:
    """q' = q omega / 2, I omega' = R^T tau - omega x I omega, of seven numbers or expressions.

    The constants are principal moments and a constant world torque. Raises ValueError for a body whose axes
    are not principal axes, and for any other load.
    """
    moments, torque = np.diagonal(scene.body.inertia), np.zeros(3)
    if not np.array_equal(scene.body.inertia, np.diag(moments)):
        raise ValueError(f"inertia must be diagonal, got {scene.body.inertia.tolist()}")
    for load in scene.loads:
        if not isinstance(load, Torque) or load.axes != "world" or load.from_s > 0.0:
            raise ValueError(f"only a constant world torque is supported, got {load!r}")
        torque += load.value
    (i1, i2, i3), (tx, ty, tz), is_forced = moments.tolist(), torque.tolist(), bool(torque.any())

    def rates(w: Any, x: Any, y: Any, z: Any, a: Any, b: Any, c: Any) -> tuple[Any, ...]:
        spins = ((i2 - i3) / i1) * b * c, ((i3 - i1) / i2) * c * a, ((i1 - i2) / i3) * a * b
        if is_forced:
            # |q| = 1 holds to the tolerance: the quotient by |q|^2 would cost another series
            k1 = (1.0 - 2.0 * (y * y + z * z)) * tx + 2.0 * ((x * y + w * z) * ty + (x * z - w * y) * tz)
            k2 = (1.0 - 2.0 * (x * x + z * z)) * ty + 2.0 * ((x * y - w * z) * tx + (y * z + w * x) * tz)
            k3 = (1.0 - 2.0 * (x * x + y * y)) * tz + 2.0 * ((x * z + w * y) * tx + (y * z - w * x) * ty)
            spins = spins[0] + k1 / i1, spins[1] + k2 / i2, spins[2] + k3 / i3
        return (
            -0.5 * (x * a + y * b + z * c),
            0.5 * (w * a + y * c - z * b),
            0.5 * (w * b + z * a - x * c),
            0.5 * (w * c + x * b - y * a),
            *spins,
        )

    return rates


def _start(scene: Scene) -> Array:
    """(7,): the quaternion and omega_body at the start."""
    return np.concatenate([scene.initial.quaternion, scene.initial.omega_body])


def _scipy() -> Contender:
    """scipy's DOP853 with rtol = atol, on a right-hand side compiled by numba with its constants in it."""

    @cache
    def compiled(problem: Problem) -> Callable[[float, Array], Array]:
        options: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy"}
        equations = numba.njit(**options)(_equations(problem.scene))
        rates = numba.njit(**options)(
            lambda _, y: np.array(equations(y[0], y[1], y[2], y[3], y[4], y[5], y[6]))
        )
        rates(0.0, _start(problem.scene))
        found: Callable[[float, Array], Array] = rates
        return found

    def prepare(problem: Problem, tolerance: float) -> Solver:
        rates, start, span = compiled(problem), _start(problem.scene), (0.0, problem.scene.duration_s)
        return Solver(
            lambda: solve_ivp(rates, span, start, method="DOP853", rtol=tolerance, atol=tolerance),
            end_of=lambda solution: _parts(solution.y[:, -1]),
        )

    tightest = 2.3e-14  # solve_ivp raises a relative tolerance to 100 eps
    return Contender(SCIPY, scipy.__version__, "tolerance", tolerances(1e-1, tightest), prepare)


def _heyoka() -> Contender:
    """heyoka's adaptive Taylor method, scalar, compiled for the body and the load (Biscani and Izzo 2021).

    Its tolerance chooses the order of the series, ceil(1 - ln(tolerance) / 2), and nothing else: one for each
    order is every setting that there is. eps is the tightest that it is made for.
    """
    import heyoka

    def prepare(problem: Problem, tolerance: float) -> Solver:
        start, until = _start(problem.scene), problem.scene.duration_s
        variables = heyoka.make_vars("w", "x", "y", "z", "a", "b", "c")
        system = list(zip(variables, _equations(problem.scene)(*variables), strict=True))
        integrator = heyoka.taylor_adaptive(
            system, start, tol=tolerance, high_accuracy=False, compact_mode=False
        )

        def reset() -> None:
            integrator.state[:] = start
            integrator.time = 0.0

        return Solver(
            lambda: integrator.propagate_until(until),
            reset,
            end_of=lambda _: _parts(np.array(integrator.state)),
        )

    settings = tuple(math.exp(-2.0 * (order - 1)) for order in range(3, 20))
    return Contender(HEYOKA, heyoka.__version__, "tolerance", settings, prepare)


def all_contenders() -> tuple[tuple[Contender, ...], dict[str, str]]:
    """Return every contender that can be measured here, and the reasons why others are missing, by name."""
    contenders = (
        *(CLOSED_FORM, CLOSED_FORM_SET_UP_BEFORE, STEPPED_TAYLOR),
        _engine("reference rk4", Reference(), "rk4"),
        _engine("reference dop853", Reference(), "dop853"),
        _engine(MUJOCO, MuJoCo(), "rk4"),
        _scipy(),
    )
    try:
        return (*contenders, _heyoka()), {}
    except ImportError as error:
        return contenders, {HEYOKA: f"heyoka cannot be imported: {error}"}
