"""Compiling all kernels ahead of use, so that no measurement and no user waits for a compiler midway."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from bodycheck.reference_impl.equations import packed_body
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.scene import RigidBody, Scene, State, Timed, Torque
from bodycheck.reference_impl.truth import solve_truth


def compile_kernels(integrators: Iterable[str]) -> None:
    """Call the truth's kernels, and those of the integrators named, once; compiled before, in an instant."""
    body = RigidBody(1.0, np.diag([1.0, 2.0, 2.5]))
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 1.0, 0.1]))
    loads: tuple[Timed, ...] = (Torque("world", np.ones(3)),)
    for acting in ((), loads):
        scene = Scene(body, start, acting, np.zeros(3), duration_s=0.1, samples=2)
        solve_truth(scene, scene.sample_times)
    for integrator in (INTEGRATORS[name] for name in integrators):
        attitude = start.quaternion if integrator.attitude == "quaternion" else np.eye(3).ravel()
        state = np.concatenate([np.zeros(6), start.omega_body, attitude])
        integrator.advance(state, packed_body(body), np.zeros(21), 1e-3, 1)
