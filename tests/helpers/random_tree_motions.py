"""Random trees, and the error of their truth over its bound, by the independent series in integers."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from mpmath import mp, mpf

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.trees.random_trees import random_tree
from bodycheck.reference_impl.trees.tree_motion import TreeSolution
from bodycheck.reference_impl.trees.tree_scene import JointTorque, TreeScene
from bodycheck.reference_impl.trees.tree_truth import TREE_QUANTITIES, certified_series, certified_tree
from tests.helpers.integer_tree_series import TreeSample, tree_samples
from tests.helpers.maximal_coordinates import _exact, _unit

_TIMES = [0.1, 0.3]
_SWITCHED_S = 0.15


def random_motion(seed: int, bodies: int = 12) -> TreeScene:
    """Return a random tree of up to some bodies; half of its joint torques end at 0.15 s."""
    rng = np.random.default_rng([51, seed])
    scene = random_tree(rng, int(rng.integers(1, bodies + 1)), loads=True)
    until = _SWITCHED_S if rng.random() < 0.5 else np.inf
    loads = (replace(one, until_s=until) if isinstance(one, JointTorque) else one for one in scene.loads)
    return replace(scene, loads=tuple(loads))


def tree_ratios(scene: TreeScene) -> dict[str, float]:
    """Return the largest error over its bound of each quantity, and of q and u in double-doubles."""
    times = np.array(_TIMES)
    truth, certified = certified_tree(scene, times), certified_series(scene, times)
    worst = dict.fromkeys(("rad", "m", "omega_rad_s", "m_s", "q", "u"), 0.0)

    def compare(name: str, error: Any, bound: float) -> None:
        worst[name] = max(worst[name], float(error / mpf(bound)))

    with mp.workdps(50):
        for k, sample in enumerate(tree_samples(scene, _TIMES)):
            motion = truth.motion
            for name, found, exact in (
                ("m", motion.position[k], sample.position),
                ("m_s", motion.velocity[k], sample.velocity),
                ("omega_rad_s", motion.omega_body[k], sample.omega),
            ):
                for row, true in zip(found, exact, strict=True):
                    error = mp.sqrt(sum((mpf(float(x)) - y) ** 2 for x, y in zip(row, true, strict=True)))
                    compare(name, error, truth.bounds[name][k])
            for q, rotation in zip(motion.quaternion[k], sample.rotation, strict=True):
                compare("rad", _angle(q, rotation), truth.bounds["rad"][k])
            bounds = dict(zip(TREE_QUANTITIES, certified.errors[:, k], strict=True))
            for i in range(len(scene.bodies)):
                for name, error, quantity in _paired_errors(scene, sample, k, certified.solution, i):
                    compare(name, error, bounds[quantity])
    return worst


def _angle(q: Array, rotation: Any) -> Any:
    """The angle between a quaternion of doubles and a rotation matrix (9,) in mpf."""
    w, x, y, z = (mpf(float(c)) for c in q)
    norm = w * w + x * x + y * y + z * z
    own = [
        *(1 - 2 * (y * y + z * z) / norm, 2 * (x * y - w * z) / norm, 2 * (x * z + w * y) / norm),
        *(2 * (x * y + w * z) / norm, 1 - 2 * (x * x + z * z) / norm, 2 * (y * z - w * x) / norm),
        *(2 * (x * z - w * y) / norm, 2 * (y * z + w * x) / norm, 1 - 2 * (x * x + y * y) / norm),
    ]
    return mp.sqrt(sum((a - b) ** 2 for a, b in zip(own, rotation, strict=True)) / 2)


def _paired_errors(
    scene: TreeScene, sample: TreeSample, k: int, solution: TreeSolution, i: int
) -> Iterator[tuple[str, Any, str]]:
    """Yield the errors of a body's coordinates and rates in double-doubles, and the names of their bounds."""

    def exact(parts: tuple[Array, Array], place: slice) -> list[Any]:
        return [
            mpf(float(a)) + mpf(float(b)) for a, b in zip(parts[0][k][place], parts[1][k][place], strict=True)
        ]

    def largest(found: list[Any], true: Any) -> Any:
        return max(abs(x - y) for x, y in zip(found, true, strict=True))

    joint = scene.bodies[i].joint
    q, u = exact(solution.q, scene.coordinate_slices[i]), exact(solution.u, scene.rate_slices[i])
    spin = sample.omega[i]
    if joint.parent >= 0:
        turned = sample.rotation[joint.parent].reshape(3, 3) @ sample.omega[joint.parent]
        spin = spin - sample.rotation[i].reshape(3, 3).T @ turned
    if joint.kind == "free":
        yield "q", largest(q[:3], sample.position[i]), "m"
        yield "u", largest(u[:3], sample.velocity[i]), "m_s"
        yield "u", largest(u[3:], spin), "omega_rad_s"
    elif joint.kind == "ball":
        yield "u", largest(u, spin), "joint_rad_s"
    else:
        yield "q", abs(q[0] - sample.q[i]), "joint_m" if joint.kind == "slide" else "joint_rad"
        if joint.kind == "hinge":
            yield "u", abs(u[0] - _unit(_exact(joint.axis)) @ spin), "joint_rad_s"
