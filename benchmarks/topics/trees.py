"""Trees at equal error: the Taylor series, MuJoCo's RK4, DOP853 and heyoka, with set-up apart; the truth.

The error is the largest of all coordinates and rates at the end, in SI units. Each contender is tried at
settings 9 % apart, and its time at 1e-9 is interpolated between the two that enclose this error.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import Any

import numba
import numpy as np

from benchmarks.figures import TREE_RATIOS, Measured, key
from benchmarks.solver import Task
from benchmarks.timing import Effort, Spread, interleaved
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.integrators.dop853 import TABLEAU
from bodycheck.reference_impl.taylor.solution import SeriesAccuracy
from bodycheck.reference_impl.trees.tree_motion import TreeSeries
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.trees.tree_stepper import TreeStepper, put_rates
from bodycheck.reference_impl.trees.tree_truth import certified_tree
from bodycheck.scenarios.library import load_trees

_TREES = ("double-pendulum", "free-chain", "quadruped")
_TARGET = 1e-9
_EVALUATIONS = len(TABLEAU.b)
_A, _B, _C = TABLEAU

Motion = Callable[[], tuple[Array, Array]]
"""Goes from the start to the end, and returns q (nq,) and u (nu,)."""


def _series(order: int, scene: TreeScene, k: int) -> Motion:
    series, end = (
        TreeSeries(scene, SeriesAccuracy(order, 10.0 ** (-6.0 - k / 4))),
        np.array([scene.duration_s]),
    )
    q, u = (scene.q0, np.zeros_like(scene.q0)), (scene.u0, np.zeros_like(scene.u0))

    def motion() -> tuple[Array, Array]:
        found = series.solve(q, u, end)
        return found.q[0][0], found.u[0][0]

    return motion


def _mujoco(scene: TreeScene, k: int) -> Motion:
    import mujoco

    from bodycheck.adapters.mujoco.mj_model import OFF
    from bodycheck.adapters.mujoco.tree import MuJoCoTree

    steps = round(20 * scene.duration_s * 2 ** (k / 2))
    tree = MuJoCoTree(scene)
    model, data = tree.model, tree.data
    model.opt.disableflags = sum(map(int, OFF))
    model.opt.enableflags = 0
    model.opt.integrator = int(mujoco.mjtIntegrator.mjINT_RK4)
    model.opt.timestep = scene.duration_s / steps
    for body in scene.bodies:
        if body.joint.damping:
            model.dof_damping[model.joint(model.body(body.name).jntadr[0]).dofadr] = body.joint.damping
    tree.set_state(scene.q0, scene.u0)
    start = data.qpos.copy(), data.qvel.copy()

    def motion() -> tuple[Array, Array]:
        data.qpos, data.qvel = start
        mujoco.mj_step(model, data, steps)
        return tree.state()

    return motion


@numba.njit(fastmath={"contract"}, error_model="numpy")  # type: ignore[untyped-decorator]
def _dop853_steps(
    tree: Any, space: Any, passive: Array, rate_rows: Any, q: Array, u: Array, h: float, steps: int
) -> None:
    rates, places = len(u), len(q)
    dq, du = np.zeros((_EVALUATIONS, places)), np.zeros((_EVALUATIONS, rates))
    at_q, at_u, rate, added = q.copy(), u.copy(), u.copy(), np.zeros((rates, rates))
    for step in range(steps):
        for s in range(_EVALUATIONS):
            for i in range(places):
                at_q[i, 0] = q[i, 0]
                for r in range(s):
                    at_q[i, 0] += h * _A[s, r] * dq[r, i]
            for i in range(rates):
                at_u[i, 0] = u[i, 0]
                for r in range(s):
                    at_u[i, 0] += h * _A[s, r] * du[r, i]
            put_rates(tree, space, passive, rate_rows, 0, at_q, at_u, (step + _C[s]) * h, h, added, rate)
            for i in range(rates):
                du[s, i] = rate[i, 0]
            place = row = 0
            for joint in range(len(tree.joints)):
                for _ in range(tree.joints[joint, 0] + tree.joints[joint, 1] % 2):
                    dq[s, place] = at_u[row, 0]
                    place, row = place + 1, row + 1
                if tree.joints[joint, 1] == 2:
                    w, x, y, z = at_q[place, 0], at_q[place + 1, 0], at_q[place + 2, 0], at_q[place + 3, 0]
                    a, b, c = at_u[row, 0], at_u[row + 1, 0], at_u[row + 2, 0]
                    dq[s, place] = 0.5 * (-x * a - y * b - z * c)
                    dq[s, place + 1] = 0.5 * (w * a + y * c - z * b)
                    dq[s, place + 2] = 0.5 * (w * b + z * a - x * c)
                    dq[s, place + 3] = 0.5 * (w * c + x * b - y * a)
                    place, row = place + 4, row + 3
        for s in range(_EVALUATIONS):
            for i in range(places):
                q[i, 0] += h * _B[s] * dq[s, i]
            for i in range(rates):
                u[i, 0] += h * _B[s] * du[s, i]


def _dop853(scene: TreeScene, k: int) -> Motion:
    steps = round(4 * scene.duration_s * 2 ** (k / 4))
    stepper = TreeStepper(scene, "M1")
    numbers, h = stepper.numbers, scene.duration_s / steps

    def motion() -> tuple[Array, Array]:
        q, u = scene.q0[:, None].copy(), scene.u0[:, None].copy()
        _dop853_steps(*numbers, q, u, h, steps)
        return q[:, 0], u[:, 0]

    return motion


def _heyoka(scene: TreeScene, k: int) -> Motion:
    from benchmarks.heyoka_trees import HeyokaTree

    return HeyokaTree(scene, 10.0 ** (-8.0 - k))


_ORDERS = (10, 12, 14, 16, 18)
_CONTENDERS: dict[str, Callable[[TreeScene, int], Motion]] = {
    **{f"series of order {order}": partial(_series, order) for order in _ORDERS},
    "MuJoCo rk4": _mujoco,
    "DOP853": _dop853,
}
_COMPILED_BY_HEYOKA = ("double-pendulum", "free-chain")  # a quadruped takes minutes
_MOST = 40  # settings of a contender


def _around(contender: Callable[[TreeScene, int], Motion], scene: TreeScene, end: Array) -> Any:
    """Return the motions of the two settings that enclose the target, with their errors; None if none do."""
    before = None
    for k in range(_MOST):
        motion = contender(scene, k)
        error = float(np.max(np.abs(np.concatenate(motion()) - end)))
        if error <= _TARGET:
            return (before or (motion, error)), (motion, error)
        before = motion, error
    return None


def trees(effort: Effort) -> list[Measured]:
    """Time all contenders in turn on each tree, and the truth of the quadruped."""
    found: list[Measured] = []
    for name in _TREES:
        ((_, scenario),) = load_trees(name)
        scene = scenario.scene
        true = certified_tree(scene, np.array([scene.duration_s])).motion
        end = np.concatenate([true.q[0], true.u[0]])
        rivals = dict(_CONTENDERS)
        if name in _COMPILED_BY_HEYOKA and find_spec("heyoka"):
            rivals["heyoka Taylor"] = _heyoka
        around = {who: _around(make, scene, end) for who, make in rivals.items()}
        tasks = [(who, pair) for who, pair in around.items() if pair is not None]
        seconds = interleaved([Task(motion) for _, pair in tasks for motion, _ in pair], effort)
        times: dict[str, Array] = {}
        for i, (who, ((_, loose), (_, tight))) in enumerate(tasks):
            share = math.log(loose / _TARGET) / math.log(loose / tight) if loose > tight else 1.0
            times[who] = seconds[2 * i] ** (1.0 - share) * seconds[2 * i + 1] ** share
        best = min((who for who in times if who.startswith("series")), key=lambda who: np.median(times[who]))
        note = f"{best}, {1e6 * np.median(times[best]):.0f} us"
        for tree, who, _ in TREE_RATIOS:
            if tree == name:
                figure = f"trees.{key(name)}.{key(who)}"
                if who in times:
                    found.append(Measured.of(figure, Spread.of(times[who] / times[best]), note))
                else:
                    why = "no setting meets the target" if who in rivals else "not installed"
                    found.append(Measured(figure, None, note=why))
    ((_, scenario),) = load_trees("quadruped")
    truth = Task(partial(certified_tree, scenario.scene, scenario.scene.sample_times))
    return [*found, Measured.of("trees.truth", Spread.of(interleaved([truth], effort)[0]), "quadruped, 1 s")]
