"""Newton: one free body by each of its solvers that accepts one, in float32 on the CPU.

body_q = (x, y, z, qx, qy, qz, qw), body_qd = (velocity of the centre of mass, omega) and body_f = (force,
torque), in world axes. A solver steps from one state into another, whose forces it ignores.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck.adapters.contract import DEFAULTS, Method, Reading, Simulation, Stepping
from bodycheck.adapters.optional.between_steps import (
    BetweenSteps,
    FreeBodiesOnly,
    array,
    scalar_first,
    scalar_last,
)
from bodycheck.adapters.optional.newton_solvers import SOLVERS
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene, State

if TYPE_CHECKING:
    from bodycheck.adapters.tree_contract import TreeModel


def _methods() -> dict[str, Method]:
    found = {}
    for name, solver in SOLVERS.items():
        method = Method(
            name=name,
            formula=solver.formula,
            order=solver.order,
            evaluations=4 if name.endswith("rk4") else 1,
            torque="zero-order hold",
            conserves="|q| = 1; linear momentum",
            source=f"Newton, newton.solvers.{solver.name}",
            changed_defaults=solver.changed,
            snippet=f"newton.solvers.{solver.name}(model{_words(solver.options)})"
            ".step(s0, s1, None, None, {dt_s})",
            precision="float32",
            rounding_bias=solver.bias,
        )
        found[name] = method
        if solver.changed:
            found[f"{name}{DEFAULTS}"] = replace(
                method, name=f"{name}{DEFAULTS}", conserves="|q| = 1", changed_defaults=(),
                formula=f"omega damped by 1 - 0.05 dt, then {method.formula}",
                snippet=f"newton.solvers.{solver.name}(model).step(s0, s1, None, None, {{dt_s}})",
            )  # fmt: skip
    return found


def _words(options: Mapping[str, Any]) -> str:
    return "".join(f", {name}={value!r}" for name, value in options.items())


class Newton(FreeBodiesOnly):
    """Newton (Linux Foundation) on Warp."""

    name = "newton"
    distribution = "newton"
    requires = ("newton[sim]>=1.8",)
    methods: Mapping[str, Method] = _methods()

    def __init__(self) -> None:
        import newton
        import warp

        warp.config.quiet = True
        self._newton: Any = newton
        self.version = version(self.distribution)

    @property
    def tree_model(self) -> type[TreeModel]:
        """What builds trees."""
        from bodycheck.adapters.optional.newton_tree import NewtonTree

        return NewtonTree

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Build a model of one body."""
        return BetweenSteps(scene, dt_s, _Body(self._newton, scene, method, dt_s))


class _Body:
    stepping: Stepping = "python"

    def __init__(self, newton: Any, scene: Scene, method: str, dt_s: float) -> None:
        self._newton, self._dt_s = newton, dt_s
        builder = newton.ModelBuilder(gravity=tuple(scene.gravity))
        inertia = [float(value) for value in scene.body.inertia.ravel()]
        builder.add_body(mass=scene.body.mass, inertia=inertia, lock_inertia=True)
        self._model = builder.finalize(device="cpu", skip_validation_inertia=True)
        solver = SOLVERS[method.removesuffix(DEFAULTS)]
        options = {} if method.endswith(DEFAULTS) else solver.options
        self._solver = getattr(newton.solvers, solver.name)(self._model, **options)
        self._now, self._next = self._model.state(), self._model.state()

    def model(self) -> tuple[float, Array, float, Array]:
        model = self._model
        inertia = array(model.body_inertia.numpy()).reshape(3, 3)
        return float(model.body_mass.numpy()[0]), inertia, self._dt_s, array(model.gravity.numpy()[0])

    def set_state(self, state: State) -> None:
        pose = np.concatenate([state.position, scalar_last(state.quaternion)])
        rates = np.concatenate([state.velocity, state.omega_world])
        for one in (self._now, self._next):
            one.body_q.assign(pose[np.newaxis])
            one.body_qd.assign(rates[np.newaxis])
            one.body_f.zero_()
            self._newton.eval_ik(self._model, one, one.joint_q, one.joint_qd)

    def step(self, steps: int, force: Array, torque: Array) -> None:
        pushed = bool(np.any(force) or np.any(torque))
        for _ in range(steps):
            if pushed:
                self._now.body_f.assign(np.concatenate([force, torque])[np.newaxis])
            self._solver.step(self._now, self._next, None, None, self._dt_s)
            if pushed:
                self._now.body_f.zero_()
            self._now, self._next = self._next, self._now

    def read(self) -> Reading:
        pose, rates = array(self._now.body_q.numpy()[0]), array(self._now.body_qd.numpy()[0])
        return Reading(pose[:3], rates[:3], quaternion=scalar_first(pose[3:]), omega_world=rates[3:])
