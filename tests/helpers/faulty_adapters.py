"""Adapters of the example engine, each with one mistake that an author of an adapter may make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from bodycheck.adapters.contract import Method, ReadBack, Reading
from bodycheck.adapters.example import Example, ExampleSimulation
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.rotations import (
    conjugate,
    exp_quaternion,
    quaternion_product,
    quaternion_to_matrix,
)
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import Wrench


def _quaternion(reading: Reading) -> Array:
    assert reading.quaternion is not None
    return reading.quaternion


def _omega(reading: Reading) -> Array:
    assert reading.omega_body is not None
    return reading.omega_body


def reads(change: Callable[[Reading, Scene], Reading]) -> type[ExampleSimulation]:
    """Return a simulation that reports its state in another form."""

    class Misreading(ExampleSimulation):
        def read(self) -> Reading:
            return change(super().read(), self.scene)

    return Misreading


def applies(change: Callable[[Wrench], Wrench]) -> type[ExampleSimulation]:
    """Return a simulation that interprets its constant loads in another form."""

    class Misloaded(ExampleSimulation):
        def apply(self, wrench: Wrench) -> None:
            super().apply(change(wrench))

    return Misloaded


class Echo(ExampleSimulation):
    """Reads back the scene."""

    def read_back(self) -> ReadBack:
        """Return the scene's numbers."""
        body, start = self.scene.body, self.scene.initial
        state = Reading(start.position, start.velocity, start.quaternion, omega_body=start.omega_body)
        return ReadBack(body.mass, body.inertia, self.dt_s, self.scene.gravity, state)


class KeepsTime(ExampleSimulation):
    """Continues to count its steps after a reset."""

    def reset(self) -> None:
        """Restore all but the time."""
        before = getattr(self, "steps", 0)
        super().reset()
        self.steps = before


class OneLongStep(ExampleSimulation):
    """Makes one step of n h instead of n steps."""

    def advance(self, steps: int) -> None:
        """Make one long step."""
        h, self.dt_s = self.dt_s, self.dt_s * steps
        super().advance(1)
        self.dt_s = h


class IgnoresContinuousLoads(ExampleSimulation):
    """Applies the constant loads only."""

    def __init__(self, scene: Scene, dt_s: float) -> None:
        super().__init__(replace(scene, loads=scene.piecewise_constant_loads), dt_s)


class ReversesGravity(ExampleSimulation):
    """Falls upwards."""

    def __init__(self, scene: Scene, dt_s: float) -> None:
        super().__init__(replace(scene, gravity=-scene.gravity), dt_s)
        self.scene = scene


class Damped(ExampleSimulation):
    """Loses 0.4 % of its spin per second, as with a default damping of an engine."""

    def advance(self, steps: int) -> None:
        """Make the steps one by one, with the loss after each."""
        for _ in range(steps):
            super().advance(1)
            self.omega = self.omega * (1.0 - 0.004 * self.dt_s)


class Clamped(ExampleSimulation):
    """Moves no faster than 100 m/s."""

    def advance(self, steps: int) -> None:
        """Make the steps one by one, with the limit after each."""
        for _ in range(steps):
            super().advance(1)
            self.v = self.v * min(1.0, 100.0 / max(float(np.linalg.norm(self.v)), 1e-9))


class HalfTheStep(ExampleSimulation):
    """Integrates over half of each step, as an engine with its own fixed step does."""

    def advance(self, steps: int) -> None:
        """Make steps of half the length."""
        self.dt_s *= 0.5
        super().advance(steps)
        self.dt_s *= 2.0


class SinglePrecision(ExampleSimulation):
    """Holds its state and its body in float32."""

    def reset(self) -> None:
        """Round the initial state."""
        super().reset()
        self._round()

    def advance(self, steps: int) -> None:
        """Round the state after each step."""
        for _ in range(steps):
            super().advance(1)
            self._round()

    def read_back(self) -> ReadBack:
        """Return the rounded body, too."""
        held = super().read_back()
        inertia = held.inertia.astype(np.float32).astype(np.float64)
        return replace(held, mass=float(np.float32(held.mass)), inertia=inertia)

    def _round(self) -> None:
        for name in ("x", "v", "q", "omega"):
            setattr(self, name, getattr(self, name).astype(np.float32).astype(np.float64))


class HoldsLoads(ExampleSimulation):
    """The midpoint rule with the loads of the start of the step."""

    def advance(self, steps: int) -> None:
        """Evaluate the loads once per step."""
        h = self.dt_s
        for _ in range(steps):
            turn = quaternion_to_matrix(self.q)
            force, torque = self.loads.at(self.steps * h, self.x, turn, self.v, turn @ self.omega)
            if self.loads.wrench.torque_world.any():
                torque = turn.T @ self.loads.wrench.torque_world

            def rate(omega: Array, torque: Array = torque) -> Array:
                return np.linalg.solve(self.inertia, torque - np.cross(omega, self.inertia @ omega))

            middle = self.omega + 0.5 * h * rate(self.omega)
            self.q = quaternion_product(self.q, exp_quaternion(h * middle))
            self.x += h * (self.v + 0.5 * h * force / self.mass)
            self.v += h * force / self.mass
            self.omega += h * rate(middle)
            self.steps += 1


def _link_origin(reading: Reading, scene: Scene) -> Reading:
    if scene.link is None:
        return reading
    arm = quaternion_to_matrix(_quaternion(reading)) @ scene.link.offset
    return replace(reading, position=reading.position + arm)


def _omega_in_world_axes(reading: Reading, _: Scene) -> Reading:
    turn = quaternion_to_matrix(_quaternion(reading))
    return replace(reading, omega_body=np.asarray(turn @ _omega(reading)))


@dataclass(frozen=True)
class AdapterFault:
    """A mistake: its simulation, the check that reports it, and the words.

    pivot: whether a pivot is accepted.
    """

    simulation: type[ExampleSimulation]
    check: str
    words: str
    order: int = 1
    pivot: bool = False


FAULTS: Mapping[str, AdapterFault] = {
    "omega in world axes": AdapterFault(
        reads(_omega_in_world_axes),
        "readings",
        "omega_body is read in the other axes, world for body or body for world",
    ),
    "omega in degrees": AdapterFault(
        reads(lambda r, _: replace(r, omega_body=np.degrees(_omega(r)))),
        "readings",
        "omega_body is read in degrees per second, not rad/s",
    ),
    "scalar last": AdapterFault(
        reads(lambda r, _: replace(r, quaternion=np.roll(_quaternion(r), -1))),
        "readings",
        "the quaternion that is read is scalar last, (x, y, z, w)",
    ),
    "world to body": AdapterFault(
        reads(lambda r, _: replace(r, quaternion=conjugate(_quaternion(r)))),
        "readings",
        "the quaternion that is read is world to body",
    ),
    "velocity in body axes": AdapterFault(
        reads(
            lambda r, _: replace(r, velocity=np.asarray(quaternion_to_matrix(_quaternion(r)).T @ r.velocity))
        ),
        "readings",
        "the velocity is read in body axes",
    ),
    "echo": AdapterFault(Echo, "read-back", "read_back returns what the adapter was given"),
    "body torque as world torque": AdapterFault(
        applies(lambda w: replace(w, torque_body=np.zeros(3), torque_world=w.torque_world + w.torque_body)),
        "loads",
        "a torque in body axes acts in world axes",
    ),
    "force at the centre": AdapterFault(
        applies(
            lambda w: replace(w, point_forces=tuple((np.zeros(3), force) for _, force in w.point_forces))
        ),
        "loads",
        "forces act at the centre of mass, not at their points",
    ),
    "force off its point": AdapterFault(
        applies(
            lambda w: replace(
                w,
                point_forces=tuple(
                    (point + np.array([0.0, 0.1, 0.0]), force) for point, force in w.point_forces
                ),
            )
        ),
        "loads",
        "the world force acts 0.0",
    ),
    "damping": AdapterFault(Damped, "free motion", "as under a damping of 0.004 1/s"),
    "speed clamp": AdapterFault(
        Clamped, "free motion", "without a force the linear momentum becomes 0.267261 times as large"
    ),
    "half the step": AdapterFault(
        HalfTheStep, "readings", "the engine's step is 0.5 times the requested one"
    ),
    "float32 stated as float64": AdapterFault(
        SinglePrecision, "model", 'the engine holds float32: state precision="float32" in its Method'
    ),
    "gravity reversed": AdapterFault(ReversesGravity, "loads", "gravity is reversed"),
    "link origin": AdapterFault(
        reads(_link_origin), "link", "the position is that of the link's origin, not of the centre of mass"
    ),
    "continuous loads ignored": AdapterFault(
        IgnoresContinuousLoads, "continuous loads", "the drag has no effect: apply it, or refuse it"
    ),
    "pivot ignored": AdapterFault(
        ExampleSimulation, "pivot", "hold it, or refuse it in `unsupported`", pivot=True
    ),
    "order overstated": AdapterFault(ExampleSimulation, "stages", "not 4", order=4),
    "loads held": AdapterFault(
        HoldsLoads,
        "stages",
        "torque and force are evaluated at every stage, but they are held constant over the step",
        order=2,
    ),
    "time kept": AdapterFault(KeepsTime, "reset", "reset keeps a time, a load or a cache"),
    "one long step": AdapterFault(
        OneLongStep, "advance", "advance(2) differs from 2 times advance(1) in the"
    ),
}


class FaultyExample(Example):
    """The example engine with one mistake."""

    def __init__(self, fault: AdapterFault) -> None:
        self._fault = fault
        torque = "every stage" if fault.order > 1 else "zero-order hold"
        facts: Method = replace(Example.facts, order=fault.order, torque=torque)
        self.methods = {facts.name: facts}

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse a pivot, except where ignoring it is the mistake."""
        return None if self._fault.pivot else super().unsupported(scene, method)

    def build(self, scene: Scene, method: str, dt_s: float) -> ExampleSimulation:
        """Return the simulation with the mistake."""
        del method
        return self._fault.simulation(scene, dt_s)
