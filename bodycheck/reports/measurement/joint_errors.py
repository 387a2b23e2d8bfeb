"""The errors of the joints of a tree: from coordinates where the engine stores them, else from poses."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import geodesic_angle
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.trees.joint_kind import Rotation, Translation
from bodycheck.reference_impl.trees.tree_bodies import joints_of
from bodycheck.reference_impl.trees.tree_scene import TreeScene

PREFIX = "joint."
"""Of the errors of joints among the measures over time: joint.NAME.q_rad, q_m, rate_rad_s or rate_m_s."""


@dataclass(frozen=True, eq=False)
class JointErrors:
    """Errors over time: by name, (n,) each; the departures (n, k) of angles and lengths, None without any.

    gap_m, gap_rad (n,): how far joints come apart, of an engine that stores poses.
    """

    series: dict[str, Array]
    angles: Array | None
    lengths: Array | None
    gap_m: Array | None
    gap_rad: Array | None

    def largest(self, unit: str) -> Array | None:
        """Return the largest error (n,) of any coordinate in a unit, rad or m."""
        found = [values for name, values in self.series.items() if name.endswith(f".q_{unit}")]
        return np.max(found, axis=0) if found else None


def joint_errors(scene: TreeScene, truth: Trajectory, motion: Trajectory) -> JointErrors:
    """Return the errors of all joints but free ones; angles are compared modulo 2 pi."""
    assert truth.q is not None
    assert truth.u is not None
    q, u = motion.q, motion.u
    gaps: tuple[list[Array], list[Array]] = ([], [])
    if q is None or u is None:
        found = joints_of(scene, motion)
        q, u = np.hstack([one.q for one in found]), np.hstack([one.u for one in found])
        gaps = [one.gap_m for one in found], [one.gap_rad for one in found]
    series: dict[str, Array] = {}
    angles: list[Array] = []
    lengths: list[Array] = []
    for body, places, rates in zip(scene.bodies, scene.coordinate_slices, scene.rate_slices, strict=True):
        kind, name = body.joint.of_kind, f"{PREFIX}{body.name}"
        own, right = q[:, places], truth.q[:, places]
        faster = u[:, rates] - truth.u[:, rates]
        if kind.translation is Translation.SPACE:
            continue
        if kind.translation is Translation.AXIS:
            lengths.append(own[:, :1] - right[:, :1])
            series[f"{name}.q_m"] = np.abs(lengths[-1][:, 0])
            series[f"{name}.rate_m_s"] = np.abs(faster[:, 0])
        if kind.rotation is Rotation.AXIS:
            angles.append(own[:, -1:] - right[:, -1:])
            angles[-1] -= 2.0 * math.pi * np.round(angles[-1] / (2.0 * math.pi))
            series[f"{name}.q_rad"] = np.abs(angles[-1][:, 0])
        elif kind.rotation is Rotation.BALL:
            signs = np.where(np.sum(own[:, -4:] * right[:, -4:], axis=1, keepdims=True) < 0.0, -1.0, 1.0)
            angles.append(2.0 * (signs * own[:, -4:] - right[:, -4:]))
            series[f"{name}.q_rad"] = geodesic_angle(own[:, -4:], right[:, -4:])
        if kind.rotation:
            series[f"{name}.rate_rad_s"] = np.linalg.norm(faster[:, int(kind.translation) :], axis=1)
    return JointErrors(
        series,
        *(np.hstack(parts) if parts else None for parts in (angles, lengths)),
        *(np.max(parts, axis=0) if parts else None for parts in gaps),
    )


def joint_heading(name: str) -> str:
    """Return the heading of the error of a joint's coordinate over time; "" for anything else."""
    body, _, unit = name.removeprefix(PREFIX).rpartition(".q_")
    return f"error of the joint of {body}, {unit}" if name.startswith(PREFIX) and body else ""


def worst_body(series: Mapping[str, Array]) -> str | None:
    """Return the body whose joint errs most: in rad, or in m where no joint turns; None without joints."""
    for unit in ("rad", "m"):
        end = f".q_{unit}"
        largest = {name: float(np.max(values)) for name, values in series.items() if name.endswith(end)}
        if largest:
            return max(largest, key=lambda name: largest[name]).removeprefix(PREFIX).removesuffix(end)
    return None


def joint_rows(series: Any, shared: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the rows of joints.csv of one case: the largest and the final errors of each joint."""
    names = [name for name in series if name.startswith(PREFIX) and ".q_" in name]
    for name in names:
        body, _, unit = name.removeprefix(PREFIX).rpartition(".q_")
        errors, rates = series[name], series[f"{PREFIX}{body}.rate_{unit}_s"]
        yield {
            **shared,
            "body": body,
            "unit": unit,
            "joint_error": float(np.max(errors)),
            "joint_error_final": float(errors[-1]),
            "joint_rate_error": float(np.max(rates)),
        }
