"""Check that truths lie within their bounds of fifty digits, over random motions of every kind.

    python tools/truth_trials.py --free 400 --forced 300
    python tools/truth_trials.py --enclosed --free 200 --forced 100
    python tools/truth_trials.py --trees 100
    python tools/truth_trials.py --aba

Free bodies have any shape: three in four move over about twenty radians, one in four to a time up to 1e9 s.
Forced ones move under each kind of load, as tests/helpers/random_motions.py makes them. All starts have a
quaternion whose norm is not exactly 1, half of them omega in world axes. The independent solutions are a
Taylor series in integers, Gauss's method of order 24 in decimals, and the period of omega; none shares code
with bodycheck. With --enclosed, motions over up to 3 rad or 1 s are compared with rigorous enclosures in ball
arithmetic instead. With --trees, random trees of up to 12 bodies are compared for 0.3 s with a series in
integers of bodies held together by forces, and q and u also in double-doubles. With --aba, the free chain is
compared with DOP853 at 1e-13 through the accelerations of Pinocchio, which must be importable. Prints the
worst error over its bound of each kind and quantity. Exit status 1 if a ratio exceeds 1.
"""

from __future__ import annotations

import itertools
import sys
import time
from collections.abc import Iterator

import numpy as np
from trials import command

from bodycheck.reference_impl.rotations import quaternion_product
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trees.tree_truth import certified_tree
from bodycheck.reference_impl.truth.certification import solve_truth
from bodycheck.scenarios.library import load_trees
from tests.helpers.ball_arithmetic import ENCLOSED, enclosures, largest_ratios, short_times
from tests.helpers.random_motions import (
    FORCED,
    QUANTITIES,
    exact_motion,
    far_scene,
    free_scene,
    ratios,
    truth_scene,
)
from tests.helpers.random_tree_motions import random_motion, tree_ratios

_TIMES = [0.0, 0.3, 1.0]
_LARGEST_RATIO = 12.0  # of the moments of a body whose motion is enclosed


def _trials(free: int, forced: int) -> Iterator[tuple[str, int, Scene, list[float]]]:
    """Yield kind, seed, scene and times."""
    far = free // 4
    yield from (("free", seed, *free_scene(seed)) for seed in range(free - far))
    yield from (("far", seed, *far_scene(seed)) for seed in range(far))
    whole = sum(count for count, _ in FORCED.values())
    for kind, (count, make) in FORCED.items():
        for seed in range(round(count * forced / whole)):
            yield kind, seed, make(seed), _TIMES


def _enclosed_trials(free: int, forced: int) -> Iterator[tuple[str, int, Scene, list[float]]]:
    """Yield the same for motions that can be enclosed, as many of each kind.

    Needles are left out: boxes of their states grow with the ratio of their moments.
    """
    tried = ((seed, *free_scene(seed)) for seed in itertools.count())
    round_enough = (one for one in tried if np.linalg.cond(one[1].body.inertia) < _LARGEST_RATIO)
    for seed, scene, times in itertools.islice(round_enough, free):
        yield "free", seed, scene, short_times(scene, times)
    for number in range(forced):
        kind = ENCLOSED[number % len(ENCLOSED)]
        yield kind, number, FORCED[kind][1](number), _TIMES


def _tree_trials(trees: int) -> int:
    """Compare random trees; print the worst ratio of each quantity, return how many are outside a bound."""
    worst: dict[str, float] = {}
    wrong = 0
    for seed in range(trees):
        found = tree_ratios(random_motion(seed))
        wrong += max(found.values()) > 1.0
        worst = {name: max(ratio, worst.get(name, 0.0)) for name, ratio in found.items()}
        print(seed, {name: float(f"{ratio:.2g}") for name, ratio in found.items()}, flush=True)
    print("worst", {name: float(f"{ratio:.3g}") for name, ratio in worst.items()})
    print(f"{trees} trees, {wrong} outside a bound")
    return wrong


def _aba_trial() -> int:
    """Print how far the free chain by ABA and DOP853 is from the truth; return the exit status."""
    from scipy.integrate import solve_ivp

    from bodycheck.adapters.optional.pinocchio_tree import PinocchioTree

    ((_, tree),) = load_trees("free-chain")
    scene, t_s = tree.scene, tree.scene.sample_times
    model, nq = PinocchioTree(scene), len(scene.q0)

    def derivative(_: float, state: np.ndarray) -> np.ndarray:
        q, u = state[:nq].copy(), state[nq:]
        q[3:7] /= np.linalg.norm(q[3:7])
        model.set_state(q, u)
        turn = 0.5 * quaternion_product(q[3:7], np.array([0.0, *u[3:6]]))
        return np.concatenate([u[:3], turn, u[6:], model.accelerations()])

    start = np.concatenate([scene.q0, scene.u0])
    found = solve_ivp(
        derivative, (0.0, scene.duration_s), start, method="DOP853", rtol=1e-13, atol=1e-14, t_eval=t_s
    )
    truth = certified_tree(scene, t_s).motion
    angles = float(np.max(np.abs(found.y[7:nq].T - truth.q[:, 7:])))
    rates = float(np.max(np.abs(found.y[nq:].T - truth.u)))
    print(f"free-chain, ABA and DOP853 at 1e-13: angles {angles:.2g} rad, rates {rates:.2g} rad/s or m/s")
    return int(max(angles, rates) > 1e-11)


def main(
    free: int = 400, forced: int = 300, enclosed: bool = False, trees: int = 0, aba: bool = False
) -> int:
    """Run the trials of these numbers, or those of enclosures, trees or ABA; return what is wrong."""
    if aba:
        return _aba_trial()
    if trees:
        return _tree_trials(trees)
    begin, worst, counts, wrong = time.perf_counter(), {}, {}, []
    trials = _enclosed_trials if enclosed else _trials
    for kind, seed, scene, times in trials(free, forced):
        truth = solve_truth(truth_scene(kind, scene), np.array(times))
        if enclosed:
            found = errors = largest_ratios(truth, enclosures(scene, times))
        else:
            found, errors = ratios(truth, exact_motion(kind, scene, times))
        largest = found.max(axis=1)
        worst[kind] = np.maximum(worst.get(kind, np.zeros(4)), largest)
        counts[kind] = counts.get(kind, 0) + 1
        if not np.all(largest <= 1.0):
            wrong.append((kind, seed))
            print(f"{kind} {seed}: error over bound {largest}, errors {errors.max(axis=1)}", flush=True)
        if counts[kind] % 10 == 0:
            so_far = f"{time.perf_counter() - begin:.0f} s, worst so far {np.round(worst[kind], 3)}"
            print(f"{kind}: {counts[kind]} done, {so_far}", file=sys.stderr, flush=True)
    print(f"{'kind':20} {'motions':>8} " + " ".join(f"{quantity:>10}" for quantity in QUANTITIES))
    for kind, largest in worst.items():
        print(f"{kind:20} {counts[kind]:8d} " + " ".join(f"{ratio:10.3f}" for ratio in largest))
    print(f"{sum(counts.values())} motions, {len(wrong)} outside a bound")
    return len(wrong)


if __name__ == "__main__":
    command(main)
