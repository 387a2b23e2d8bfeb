"""The cache of solve_truth."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from bodycheck._util.file_digests import digest_of
from bodycheck._util.platform_identity import numeric_parts
from bodycheck.adapters.registry import own_code
from bodycheck.adapters.workers import case_messages
from bodycheck.adapters.workers.protocol import Message, packed, unpacked
from bodycheck.reference_impl.arrays import Array, largest_norm
from bodycheck.reference_impl.precompile import (
    closed_forms_compiled,
    compile_kernels,
    interpreting,
    interprets_closed_forms,
)
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.tree_scene import TreeScene
from bodycheck.reference_impl.truth.truth import Kind, Truth
from bodycheck.reports.cache.disk_cache import Cache, key_of

if TYPE_CHECKING:
    from bodycheck.reference_impl.trees.tree_truth import TreeTruth


def known_truth(scene: Scene | TreeScene, t_s: Array, cache: Cache | None) -> Truth:
    """Return solve_truth(scene, t_s) from the cache; on a miss, solve and store it.

    t_s (n,) in s. A truth that depends on a user's function is never stored, because its code may change.

    Raises ValueError as solve_truth does.
    """
    if cache is None or scene.has_callback_load:
        return _solved(scene, t_s)
    key = _key(scene, t_s)
    if (message := cache.get(key)) is not None:
        return _truth_of(message)
    truth = _solved(scene, t_s)
    cache.put(key, _message(truth))
    return truth


def _solved(scene: Scene | TreeScene, t_s: Array) -> Truth:
    if isinstance(scene, TreeScene):
        from bodycheck.reference_impl.trees.tree_truth import certified_tree  # imports numba

        return _of_tree(certified_tree(scene, t_s))
    from bodycheck.reference_impl.truth.certification import (
        solve_truth,  # imported here: numba takes a second to start
    )

    if scene.is_free_rotation and not closed_forms_compiled():
        if interprets_closed_forms([len(t_s)]):
            with suppress(ArithmeticError, ValueError), interpreting():  # compiled code has inf and NaN
                return solve_truth(scene, t_s)
        compile_kernels([scene])
    return solve_truth(scene, t_s)


def _of_tree(truth: TreeTruth) -> Truth:
    """Return the truth of a tree by the quantities of one body: the largest bounds of any body or joint."""
    motion = truth.motion
    kinetic = float(np.max(motion.kinetic)) or 1.0
    momentum = largest_norm(motion.angular_momentum) or 1.0
    parts: dict[str, Array] = {}
    for prefix, bounds in (("bound", truth.bounds), ("round_off", truth.round_offs)):
        for name in ("rad", "omega_rad_s", "m", "m_s"):
            joint = f"joint_{'rad_s' if name == 'omega_rad_s' else name}"
            parts[f"{prefix}_{name}"] = np.maximum(bounds[name], bounds[joint])
        parts[f"{prefix}_energy"] = bounds["energy_j"] / kinetic
        parts[f"{prefix}_momentum"] = bounds["angular_momentum_n_m_s"] / momentum
    return Truth(
        Trajectory(
            motion.t_s,
            motion.position,
            motion.velocity,
            motion.quaternion,
            omega_body_rad_s=motion.omega_body,
            q=motion.q,
            u=motion.u,
        ),
        cast("Kind", truth.kind),
        trusted_until_s=truth.trusted_until_s,
        **parts,
    )


def is_known(scene: Scene | TreeScene, t_s: Array, cache: Cache) -> bool:
    """Whether the cache has a file for this truth; the file may be damaged."""
    return not scene.has_callback_load and cache.has(_key(scene, t_s))


def _key(scene: Scene | TreeScene, t_s: Array) -> str:
    # includes the numerical libraries, because another build may round or order operations differently
    scene_message = case_messages.scene_message(scene)
    code = [own_code(), digest_of(Path(__file__).parent)]  # the bounds of trees are combined here
    return key_of(truth=scene_message, t_s=packed(t_s), code=code, evaluated_by=numeric_parts())


def _message(truth: Truth) -> Message:
    message: Message = {}
    for field in fields(truth):
        value: Any = getattr(truth, field.name)
        match value:
            case np.ndarray():
                message[field.name] = packed(value)
            case Trajectory():
                arrays = {part.name: getattr(value, part.name) for part in fields(value)}
                message[field.name] = {name: packed(a) for name, a in arrays.items() if a is not None}
            case _:
                message[field.name] = value
    return message


def _truth_of(message: Message) -> Truth:
    values: dict[str, Any] = {}
    for name, value in message.items():
        if name == "trajectory":
            values[name] = Trajectory(**{part: unpacked(array) for part, array in value.items()})
        else:
            values[name] = unpacked(value) if isinstance(value, dict) else value
    return Truth(**values)
