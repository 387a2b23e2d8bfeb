"""M1, M2 and Runge-Kutta 4 with any number of planted faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bodycheck.adapters.contract import Method
from bodycheck.adapters.reference import Reference
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import exp_quaternion, quaternion_product, quaternion_to_matrix
from bodycheck.reference_impl.scene import Scene
from tests.helpers.first_order_maps import implicit_step
from tests.helpers.planted_faults import BASES, Fault, FaultySimulation, Model


class FaultyMap:
    """An engine with one method, "planted", that has the given faults."""

    version = "1"

    def __init__(self, base: str, faults: Sequence[Fault]) -> None:
        self.name, self._base, self._faults = f"planted-{base}", base, faults
        known = replace(Reference().methods[base], continuous_loads="zero-order hold", changed_defaults=())
        self.methods: dict[str, Method] = {"planted": replace(known, name="planted")}

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse what the maps do not support."""
        del method
        return "no continuous loads" if scene.continuous_loads or scene.pivot is not None else None

    def build(self, scene: Scene, method: str, dt_s: float) -> FaultySimulation:
        """Return a simulation with the faults."""
        del method
        model = Model.of(scene)
        for fault in self._faults:
            fault.plant(model)
        if self._base == "m2":
            return _LinearlyImplicit(model, 1, dt_s)
        return FaultySimulation(model, BASES[self._base], dt_s)


class _LinearlyImplicit(FaultySimulation):
    """M2 in numpy; damping, energy drag and limits act as in the other maps."""

    def _make(self, steps: int) -> None:
        if not steps:
            return
        self._before, self._begun = self._state.copy(), True
        model = self._model
        for _ in range(steps * model.steps_factor):
            self._state = _step(model, self._state, self._load, self._dt_s * model.step_factor)


def _step(model: Model, state: Array, load: Array, h: float) -> Array:
    from tests.helpers import faulty_steps as at

    s = model.switches
    x, v, w, q = state[0:3], state[3:6], state[6:9], state[9:13]
    rotation = quaternion_to_matrix(q)
    moment = load[12:].reshape(3, 3) @ rotation
    gyroscopic_torque = np.array(
        [moment[1, 2] - moment[2, 1], moment[2, 0] - moment[0, 2], moment[0, 1] - moment[1, 0]]
    )
    torque = load[6:9] + rotation.T @ load[9:12] + gyroscopic_torque
    asleep = s[at.ASLEEP]
    if v @ v < asleep**2 and w @ w < asleep**2:
        return state
    seen = w.astype(np.float32).astype(np.float64) if s[at.SINGLE] else w
    spun = _spun(model, seen, torque, h) - h * model.angular_damping * seen
    if s[at.DRAG_ENERGY]:
        spin = model.inertia @ seen
        middle = np.sort(np.linalg.eigvalsh(model.inertia))[1]
        size, energy = spin @ spin, 0.5 * seen @ spin
        across = np.linalg.solve(model.inertia, np.cross(spin, np.cross(spin, seen)))
        spun = (
            spun + h * s[at.DRAG_ENERGY] * middle * (energy - 0.5 * size / middle) / (energy * size) * across
        )
    force = (rotation @ load[0:3] + load[3:6]) / model.mass
    force = force - (model.linear_damping + s[at.QUADRATIC] * np.linalg.norm(v)) * v
    if s[at.BODY_VELOCITY]:
        force = force + np.cross(rotation @ seen, v)
    new_v, new_w = v + h * force, w + spun
    new_x = x + h * (v if s[at.OLD_VELOCITY] else new_v)
    angle = h * np.linalg.norm(new_w)
    share = min(1.0, s[at.ANGLE] / angle) if s[at.ANGLE] and angle > 0.0 else 1.0
    if s[at.ADDITIVE]:
        new_q = q + 0.5 * h * quaternion_product(q, np.concatenate([[0.0], new_w]))
    elif s[at.WORLD_OMEGA]:
        new_q = quaternion_product(exp_quaternion(h * share * new_w), q)
    else:
        new_q = quaternion_product(q, exp_quaternion(h * share * new_w))
    new_q = new_q / np.linalg.norm(new_q) if s[at.NORMALISED] else new_q
    if s[at.CLAMP]:
        new_w = np.clip(new_w, -s[at.CLAMP], s[at.CLAMP])
    if s[at.SPEED_CLAMP]:
        new_v = np.clip(new_v, -s[at.SPEED_CLAMP], s[at.SPEED_CLAMP])
    return np.concatenate([new_x, new_v, new_w, new_q])


def _spun(model: Model, w: Array, torque: Array, h: float) -> Array:
    """Return the change of omega by M2, with its gyroscopic terms multiplied by the model's factor."""
    if model.gyro == 1.0:
        return implicit_step(model.inertia, w, torque, h)
    spin = model.inertia @ w
    skew = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    lean = np.array([[0.0, -spin[2], spin[1]], [spin[2], 0.0, -spin[0]], [-spin[1], spin[0], 0.0]])
    derivative = model.gyro * (skew @ model.inertia - lean)
    return np.asarray(
        h * np.linalg.solve(model.inertia + h * derivative, torque - model.gyro * np.cross(w, spin))
    )
