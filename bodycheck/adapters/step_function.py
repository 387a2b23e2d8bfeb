"""state(t + dt) = step(state(t), dt): users' functions as the methods of an engine."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NoReturn, TypeAlias

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading, Simulation, Stepping
from bodycheck.adapters.engine_loads import StageLoads
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import RigidBody, Scene, State
from bodycheck.reference_impl.wrench import Wrench
from bodycheck.scenarios.user_functions import user_function

_SHAPES = {"position": (3,), "quaternion": (4,), "velocity": (3,), "omega_body": (3,)}

_REAL = "fiu"
"""The kinds of NumPy's types of real numbers."""


@dataclass(frozen=True, eq=False)
class StepState(State):
    """The argument of a step function; return a new one by `dataclasses.replace(state, omega_body=...)`.

    position (3,) and velocity (3,) of the centre of mass in world axes, m and m/s; quaternion (4,)
    (w, x, y, z), body to world; omega_body (3,) in body axes, rad/s. t_s: the time in s at which the step
    begins. body: mass in kg, inertia (3, 3) in kg m^2 about the centre of mass in body axes. rotation and
    omega_world are derived.
    """

    t_s: float
    body: RigidBody
    acting: Acting

    def loads(self) -> tuple[Array, Array]:
        """Return force (3,) in world axes, N, with the weight, and torque (3,) in body axes, N m.

        For a stage of a step call it on `dataclasses.replace(state, t_s=..., position=..., ...)`.
        """
        return self.acting(self)


Acting: TypeAlias = Callable[[StepState], tuple[Array, Array]]
Step: TypeAlias = Callable[[StepState, float], State]
"""step(state, dt) -> the state dt seconds later, under `state.loads()`."""


class StepFunction:
    """The engine `step`, whose only method is the function; it runs in the caller's process.

    fault: the last exception of the function, if any.
    """

    name = "step"
    version = "of the caller"

    def __init__(self, function: Step) -> None:
        called = getattr(function, "__name__", type(function).__name__)
        self._function = function
        self.fault: Exception | None = None
        self.methods: Mapping[str, Method] = {called: _method(called)}

    def __reduce__(self) -> NoReturn:
        """Refuse pickling: in a worker neither a debugger nor a traceback would reach the function."""
        raise TypeError("a step function cannot leave the process of its caller")

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Return the reason if the body is pivoted: a step function does not get a pivot."""
        del method
        return None if scene.pivot is None else "step functions have no pivot"

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Return a simulation that steps the scene by the function."""
        del method
        return _Stepped(scene, self, dt_s)

    def stepped(self, state: StepState, dt_s: float) -> State:
        """Return the function's next state; raises TypeError or ValueError if that is not a valid state."""
        try:
            found = self._function(state, dt_s)
            if not isinstance(found, State):
                raise TypeError(
                    f"step must return a state, as dataclasses.replace does, not {type(found).__name__}"
                )
            for name, shape in _SHAPES.items():
                value = np.asarray(getattr(found, name))
                if value.shape != shape:
                    raise ValueError(f"step must return {name} of shape {shape}, not {value.shape}")
                if value.dtype.kind not in _REAL:
                    raise TypeError(f"step must return real numbers as {name}, not {value.dtype}")
        except Exception as error:
            self.fault = error
            raise
        return found


def _method(name: str) -> Method:
    return Method(
        name=name,
        formula="state = step(state, dt)",
        order=None,
        evaluations=None,
        torque="zero-order hold",
        conserves="what the function conserves",
        source="the caller",
    )


class StepModule:
    """A user's module as an engine of that name; its methods are step functions of the module.

    Raises InputError with one line if the module cannot be imported or lacks one of the functions.
    """

    version = "user code"

    def __init__(self, name: str, functions: tuple[str, ...]) -> None:
        self.name = name
        self._functions = {one: user_function(f"{name}:{one}", allow_code=True) for one in functions}
        self.methods: Mapping[str, Method] = {one: _method(one) for one in functions}

    def __reduce__(self) -> tuple[type[StepModule], tuple[str, tuple[str, ...]]]:
        """Let a worker import the module itself."""
        return StepModule, (self.name, tuple(self._functions))

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Return the reason if a step function cannot represent the scene."""
        return StepFunction(self._functions[method]).unsupported(scene, method)

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Return a simulation that steps the scene by the function."""
        return StepFunction(self._functions[method]).build(scene, method, dt_s)


class _Stepped:
    """A simulation stepped by the function."""

    stepping: Stepping = "python"

    def __init__(self, scene: Scene, engine: StepFunction, dt_s: float) -> None:
        self._scene, self._engine, self._dt_s = scene, engine, dt_s
        self._loads = StageLoads(scene)
        self.reset()

    def reset(self) -> None:
        """Restore the initial state at t = 0."""
        self._state: State = self._scene.initial
        self._steps = 0

    def apply(self, wrench: Wrench) -> None:
        """Set the loads that are constant until the next call."""
        self._loads.wrench = wrench

    def advance(self, steps: int) -> None:
        """Make this many steps."""
        for _ in range(steps):
            now = self._steps * self._dt_s
            state = StepState(**self._state_fields(), t_s=now, body=self._scene.body, acting=self._acting)
            self._state = self._engine.stepped(state, self._dt_s)
            self._steps += 1

    def read(self) -> Reading:
        """Return copies of the state that the function returned."""
        return Reading(**self._state_fields())

    def _acting(self, state: StepState) -> tuple[Array, Array]:
        """Return the sum of the constant loads, the weight and the continuous loads."""
        return self._loads.at(state.t_s, state.position, state.rotation, state.velocity, state.omega_world)

    def _state_fields(self) -> dict[str, Array]:
        return {name: np.array(getattr(self._state, name), dtype=np.float64) for name in _SHAPES}

    def read_back(self) -> ReadBack:
        """Return the scene's own numbers, because a function stores no model."""
        body = self._scene.body
        return ReadBack(body.mass, body.inertia, self._dt_s, self._scene.gravity, self.read())

    def close(self) -> None:
        """Do nothing; there is nothing to free."""
