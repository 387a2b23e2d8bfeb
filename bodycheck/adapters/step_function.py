"""state(t + dt) = step(state(t), dt): a function of the user's own as an engine with one method."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NoReturn, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Stepping
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.wrench import Wrench

_SHAPES = {"position": (3,), "quaternion": (4,), "velocity": (3,), "omega_body": (3,)}


@dataclass(frozen=True, eq=False)
class StepState(State):
    """What a step function is given, and gives back with `dataclasses.replace(state, omega_body=...)`.

    position (3,) and velocity (3,) of the centre of mass in world axes, m and m/s; quaternion (4,)
    (w, x, y, z), body to world; omega_body (3,) in body axes, rad/s. t_s: the time in s at which the step
    begins. body: mass in kg, inertia (3, 3) in kg m^2 about the centre of mass in body axes. rotation and
    omega_world are derived.
    """

    t_s: float
    body: RigidBody


Step: TypeAlias = Callable[[StepState, float], State]
"""step(state, dt) -> the state dt seconds later. Loads, gravity too, are the function's own business."""


class StepFunction:
    """The engine `step`, whose one method is the function by its name; it stays in the process it is in.

    fault: what the function raised last, if it did.
    """

    name = "step"
    version = "of the caller"

    def __init__(self, function: Step) -> None:
        called = getattr(function, "__name__", type(function).__name__)
        self._function = function
        self.fault: Exception | None = None
        self.methods: Mapping[str, Method] = {
            called: Method(
                name=called,
                formula="state = step(state, dt)",
                order=None,
                evaluations=None,
                torque="held over the step",
                keeps="what the function keeps",
                source="the caller",
            )
        }

    def __reduce__(self) -> NoReturn:
        """Refuse to be pickled: in a worker neither a debugger nor a traceback would reach the function."""
        raise TypeError("a step function stays in the process of its caller")

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse nothing: what acts is the function's own business."""
        del scene, method
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Return a stepper of the scene."""
        del method
        return _Stepped(scene, self, dt_s)

    def stepped(self, state: StepState, dt_s: float) -> State:
        """Return what the function makes of a state; TypeError or ValueError where that is none."""
        try:
            found = self._function(state, dt_s)
            if not isinstance(found, State):
                raise TypeError(
                    f"step must give back a state, as dataclasses.replace does, not {type(found).__name__}"
                )
            for name, shape in _SHAPES.items():
                if np.shape(getattr(found, name)) != shape:
                    raise ValueError(
                        f"step must give {name} the shape {shape}, not {np.shape(getattr(found, name))}"
                    )
        except Exception as error:
            self.fault = error
            raise
        return found


class _Stepped:
    """A scene stepped by the function, state by state."""

    stepping: Stepping = "python"

    def __init__(self, scene: Scene, engine: StepFunction, dt_s: float) -> None:
        self._scene, self._engine, self._dt_s = scene, engine, dt_s
        self.reset()

    def reset(self) -> None:
        """Go back to the initial state at t = 0."""
        self._state: State = self._scene.initial
        self._steps = 0

    def apply(self, wrench: Wrench) -> None:
        """Do nothing: the function answers for the loads."""

    def advance(self, steps: int) -> None:
        """Make this many steps."""
        for _ in range(steps):
            now = self._steps * self._dt_s
            state = StepState(**self._held(), t_s=now, body=self._scene.body)
            self._state = self._engine.stepped(state, self._dt_s)
            self._steps += 1

    def read(self) -> Reading:
        """Return copies of the state as the function gave it back."""
        return Reading(**self._held())

    def _held(self) -> dict[str, Array]:
        return {name: np.array(getattr(self._state, name), dtype=np.float64) for name in _SHAPES}

    def read_back(self) -> ReadBack:
        """Return the scene's own numbers: a function holds none."""
        body = self._scene.body
        return ReadBack(body.mass, body.inertia, self._dt_s, self._scene.gravity, self.read())

    def close(self) -> None:
        """Nothing to free."""
