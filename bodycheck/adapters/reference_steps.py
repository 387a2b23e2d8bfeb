"""A scene stepped by one of the reference's integrators: a pivoted body as one that turns about its pivot."""

from __future__ import annotations

import math

import numpy as np

from bodycheck.adapters.contract import ReadBack, Reading, Stepping
from bodycheck.reference_impl.equations import packed_body
from bodycheck.reference_impl.halving import PivotPlace
from bodycheck.reference_impl.integrators.asking import advance_asking, omega_world, rotation_held
from bodycheck.reference_impl.integrators.facts import Integrator
from bodycheck.reference_impl.lasting import packed_lasting
from bodycheck.reference_impl.loads_at import lasting_wrench_of
from bodycheck.reference_impl.pivoted import about_pivot, load_about
from bodycheck.reference_impl.scene import Scene, Wrenching
from bodycheck.reference_impl.wrench import NO_WRENCH, Wrench

_POSITION, _VELOCITY, _SPIN = slice(0, 3), slice(3, 6), slice(6, 9)


class FixedStep:
    """A scene stepped by one of the reference's integrators."""

    stepping: Stepping

    def __init__(self, scene: Scene, integrator: Integrator, dt_s: float) -> None:
        self._scene, self._integrator, self._dt_s = scene, integrator, dt_s
        # A pivoted body is stepped as one that turns about the pivot, which no force moves.
        self._stepped = about_pivot(scene)
        self._body = packed_body(self._stepped.body)
        if scene.pivot is not None:
            self._body[0] = math.inf
        self.stepping = "python" if scene.has_black_box else "native"
        self._asked = _asked_about_pivot(scene) if scene.has_black_box else None
        self._lasting = np.zeros(0) if scene.has_black_box else packed_lasting(self._stepped)
        self.reset()

    def reset(self) -> None:
        """Go back to the initial state at t = 0, nothing but gravity acting."""
        initial, inertia = self._stepped.initial, self._stepped.body.inertia
        spin = {
            "omega_body": initial.omega_body,
            "omega_world": initial.omega_world,
            "angular_momentum": initial.rotation @ (inertia @ initial.omega_body),
        }[self._integrator.spin]
        attitude = (
            initial.quaternion if self._integrator.attitude == "quaternion" else initial.rotation.ravel()
        )
        self._state = np.concatenate([initial.position, initial.velocity, spin, attitude])
        self._steps_made = 0
        self.apply(NO_WRENCH)

    def read_back(self) -> ReadBack:
        """Unpack what the kernels are given, which about a pivot is another inertia."""
        scene, held = self._scene, self._body[1:10].reshape(3, 3)
        about = np.zeros((3, 3)) if scene.pivot is None else self._stepped.body.inertia - scene.body.inertia
        return ReadBack(
            mass=self._stepped.body.mass,
            inertia=held - about,
            dt_s=self._dt_s,
            gravity=self._scene.gravity,
            state=self.read(),
        )

    def apply(self, wrench: Wrench) -> None:
        """Let this wrench act from now on."""
        scene = self._scene
        load = wrench.packed(scene.body, scene.gravity)
        self._load = load if scene.pivot is None else load_about(scene.pivot, load)

    def advance(self, steps: int) -> None:
        """Make the steps in one compiled call; in Python where a function is to be asked."""
        method, state, dt_s = self._integrator, self._state, self._dt_s
        begin = self._steps_made * dt_s
        if self._asked is not None:
            advance_asking(method, self._asked, state, self._body, self._load, begin, dt_s, steps)
        elif len(self._lasting):
            method.advance_under(state, self._body, self._load, self._lasting, begin, dt_s, steps)
        else:
            method.advance(state, self._body, self._load, dt_s, steps)
        self._steps_made += steps

    def read(self) -> Reading:
        """Return copies of the state."""
        method, pivot, state = self._integrator, self._scene.pivot, self._state.copy()
        position, velocity, spin = state[_POSITION], state[_VELOCITY], state[_SPIN].copy()
        in_body = method.spin == "omega_body"
        rotation = state[9:].reshape(3, 3) if method.attitude == "matrix" else None
        turning = None
        if pivot is not None or not in_body:
            turned = rotation_held(method, state)
            turning = omega_world(method, state, self._body, turned)
            if pivot is not None:
                arm = turned @ -pivot
                position, velocity = position + arm, np.cross(turning, arm)
        return Reading(
            position,
            velocity,
            quaternion=state[9:] if rotation is None else None,
            rotation=rotation,
            omega_world=None if in_body else turning,
            omega_body=spin if in_body else None,
        )

    def close(self) -> None:
        """Nothing to free."""


def _asked_about_pivot(scene: Scene) -> Wrenching:
    """Return what the lasting loads do to the body that is stepped: about the pivot, if there is one."""
    wrench = lasting_wrench_of(scene)
    return wrench if scene.pivot is None else PivotPlace.of(scene).about_pivot(wrench)
