"""Compiling all kernels ahead of use, so that no measurement and no user waits for a compiler midway."""

from __future__ import annotations

import subprocess
import sys

import numpy as np

from bodycheck.reference_impl.equations import packed_body
from bodycheck.reference_impl.integrators import INTEGRATORS
from bodycheck.reference_impl.jit import cache_directory
from bodycheck.reference_impl.scene import RigidBody, Scene, State, Timed, Torque
from bodycheck.reference_impl.truth import solve_truth

_BODY = RigidBody(1.0, np.diag([1.0, 2.0, 2.5]))
_START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 1.0, 0.1]))


def compile_kernels() -> None:
    """Call every kernel once on a short motion; where they lie compiled on disk this takes an instant.

    For the first time on a machine, one half is compiled by a process beside this one, which then finds
    it on disk. Should that process fail, the half is compiled here after all.
    """
    done = cache_directory() / "complete"
    if not done.exists():
        beside = subprocess.Popen([sys.executable, "-m", __name__], stdout=subprocess.DEVNULL)
        _call_integrators()
        beside.wait()
    _call_integrators()
    _call_truths()
    done.parent.mkdir(parents=True, exist_ok=True)
    done.touch()


def _call_truths() -> None:
    loads: tuple[Timed, ...] = (Torque("world", np.ones(3)),)
    for acting in ((), loads):
        scene = Scene(_BODY, _START, acting, np.zeros(3), duration_s=0.1, samples=2)
        solve_truth(scene, scene.sample_times)


def _call_integrators() -> None:
    for integrator in INTEGRATORS.values():
        attitude = _START.quaternion if integrator.attitude == "quaternion" else np.eye(3).ravel()
        state = np.concatenate([np.zeros(6), _START.omega_body, attitude])
        integrator.advance(state, packed_body(_BODY), np.zeros(21), 1e-3, 1)


if __name__ == "__main__":
    _call_truths()
