"""Engines that accept a force and a torque between steps: all loads are held constant over each step."""

from __future__ import annotations

from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np

from bodycheck.adapters.contract import ReadBack, Reading, Stepping
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.imu import has_imu
from bodycheck.reference_impl.rotations import quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene, State
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

NO_PIVOT = "the adapter has no joint for a pivot"
_ZERO = np.zeros(3)


class OnRequest:
    """The base of an adapter without pivots; modules: imported before any case, as that may take seconds."""

    distribution: str
    modules: tuple[str, ...]

    def __init__(self) -> None:
        for module in self.modules:
            import_module(module)
        self.version = version(self.distribution)

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse pivots."""
        return NO_PIVOT if scene.pivot is not None else None


class FreeBodiesOnly(OnRequest):
    """The base of an adapter without pivots and link frames."""

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse pivots and link frames."""
        if scene.pivot is None and scene.link is not None:
            return "the engine's own frame of the body is at the centre of mass"
        return super().unsupported(scene, method)


class SteppedBody(Protocol):
    """One free body in an engine under gravity."""

    stepping: Stepping

    def model(self) -> tuple[float, Array, float, Array]:
        """Return mass, inertia (3, 3) in body axes, step in s and gravity (3,), as the engine holds them."""

    def set_state(self, state: State) -> None:
        """Set pose and velocity, as in a body that is freshly built."""

    def step(self, steps: int, force: Array, torque: Array) -> None:
        """Make steps under a force (3,) at the centre of mass and a torque (3,), both in world axes."""

    def read(self) -> Reading:
        """Return copies of the engine's state."""


class BetweenSteps:
    """A simulation of a body to which loads are passed between steps (zero-order hold).

    Without loads all steps are made by one call of the body. A body whose engine has sensors has
    `imu(force, torque)`, which returns what they read under these loads, in body axes.
    """

    def __init__(self, scene: Scene, dt_s: float, body: SteppedBody) -> None:
        self._scene, self._dt_s, self._body = scene, dt_s, body
        self.stepping = body.stepping
        self._loads = StageLoads(replace(scene, gravity=_ZERO))  # the engine applies the weight
        if has_imu(scene) and (sensors := getattr(body, "imu", None)) is not None:
            self.imu = lambda: sensors(*self._present_loads())
        self.reset()

    def read_back(self) -> ReadBack:
        """Return the model and the state as the engine holds them."""
        mass, inertia, dt_s, gravity = self._body.model()
        return ReadBack(mass, inertia, dt_s, gravity, self.read())

    def reset(self) -> None:
        """Restore the initial state at t = 0, without a wrench."""
        self._body.set_state(self._scene.initial)
        self._steps_made = 0
        self.apply(NO_WRENCH)

    def apply(self, wrench: Wrench) -> None:
        """Replace the constant loads."""
        self._loads.wrench = wrench
        self._is_loaded = not wrench.is_zero or bool(self._scene.continuous_loads)

    def advance(self, steps: int) -> None:
        """Make the steps; each evaluates the loads at its start."""
        if not self._is_loaded:
            self._body.step(steps, _ZERO, _ZERO)
            self._steps_made += steps
            return
        for _ in range(steps):
            self._body.step(1, *self._present_loads())
            self._steps_made += 1

    def _present_loads(self) -> tuple[Array, Array]:
        """Return force and torque (3,), both in world axes, at the present state."""
        state = self._body.read()
        rotation = rotation_of(state)
        omega = state.omega_world if state.omega_body is None else rotation @ state.omega_body
        t_s = self._steps_made * self._dt_s
        force, torque = self._loads.at(t_s, state.position, rotation, state.velocity, omega)  # type: ignore[arg-type]
        return force, rotation @ torque

    def read(self) -> Reading:
        """Return the engine's state."""
        return self._body.read()

    def close(self) -> None:
        """Do nothing: the body is freed with this object."""


def rotation_of(state: Reading) -> Array:
    """Return R (3, 3), body to world, of a reading; of q / |q|."""
    return quaternion_to_matrix(state.quaternion) if state.rotation is None else state.rotation  # type: ignore[arg-type]


def array(values: Any) -> Array:
    """Return an engine's numbers in float64, copied."""
    return np.array(values, dtype=np.float64)


def scalar_first(quaternion: Any) -> Array:
    """(x, y, z, w) -> (w, x, y, z)."""
    return np.roll(array(quaternion), 1)


def scalar_last(quaternion: Array) -> Array:
    """(w, x, y, z) -> (x, y, z, w)."""
    return np.roll(quaternion, -1)
