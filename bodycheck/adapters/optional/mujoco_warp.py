"""MuJoCo Warp: MuJoCo's integrators as Warp kernels, in float32 on the CPU."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck.adapters.batches import Batch, BatchAnswer
from bodycheck.adapters.contract import Method, Simulation
from bodycheck.adapters.optional.between_steps import FreeBodiesOnly, array
from bodycheck.adapters.tree_contract import UnreportedError
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene

if TYPE_CHECKING:
    import mujoco

    from bodycheck.adapters.gradients import Gradients

_EULER = Method(
    name="euler",
    formula="M1",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| = 1; linear momentum",
    source="MuJoCo Warp, mujoco_warp.step",
    snippet="m.opt.timestep = {dt_s}; m.opt.integrator = mjINT_EULER; model = mujoco_warp.put_model(m)",
    precision="float32",
)
_IMPLICIT = replace(_EULER, formula="M2")
_RK4 = replace(
    _EULER,
    name="rk4",
    formula="RK4 Munthe-Kaas",
    order=None,  # at usual steps its error is that of float32
    evaluations=4,
    torque="every stage",
)
NO_DERIVATIVES = "MuJoCo Warp compiles its kernels without derivatives (enable_backward=False)"


def _of_integrator(method: Method, name: str) -> Method:
    return replace(method, name=name, snippet=method.snippet.replace("EULER", name.upper()))


class MuJoCoWarp(FreeBodiesOnly):
    """MuJoCo Warp (Google DeepMind and NVIDIA)."""

    name = "mujoco-warp"
    distribution = "mujoco-warp"
    requires = ("mujoco-warp>=4.0",)
    modules = ("mujoco_warp",)
    methods: Mapping[str, Method] = {
        "euler": _EULER,
        "implicit": _of_integrator(_IMPLICIT, "implicit"),
        "implicitfast": _of_integrator(_IMPLICIT, "implicitfast"),
        "rk4": _of_integrator(_RK4, "rk4"),
    }
    tree_model = "bodycheck.adapters.optional.port_trees:WarpTree"

    def __init__(self) -> None:
        super().__init__()
        import warp

        warp.config.quiet = True
        warp.set_device("cpu")  # steps on a GPU would cost no CPU time, and return before they are made

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Put MuJoCo's model of one body into Warp."""
        from bodycheck.adapters.optional.mujoco_ports import PortSimulation, mj_model

        return PortSimulation(scene, dt_s, _Port(mj_model(scene, method, dt_s)), "python")

    def gradients(self, scene: Scene, method: str, dt_s: float) -> Gradients:  # noqa: ARG002 - the contract
        """Raise UnreportedError: there are none."""
        raise UnreportedError(NO_DERIVATIVES)

    def record_batch(self, batch: Batch) -> BatchAnswer | None:
        """Step free bodies as worlds of one data object; None for other batches."""
        from bodycheck.adapters.optional.mujoco_ports import record_worlds

        if not batch.is_free or self.unsupported(batch.template, batch.method):
            return None
        return record_worlds(batch, batch.method, self.methods[batch.method].precision, _Worlds)


class _Worlds:
    """Bodies in Warp, each in a world of its own."""

    def __init__(self, models: Sequence[mujoco.MjModel]) -> None:
        import mujoco
        import mujoco_warp
        import warp

        from bodycheck.adapters.optional.mujoco_ports import OF_BODY

        first = models[0]
        self._warp: Any = mujoco_warp
        self._model = mujoco_warp.put_model(first)
        for name in OF_BODY:
            values = np.array([getattr(model, name) for model in models], dtype=np.float32)
            setattr(self._model, name, warp.array(values, dtype=getattr(self._model, name).dtype))
        self._data = mujoco_warp.put_data(first, mujoco.MjData(first), nworld=len(models))

    def model(self) -> Any:
        model = self._model
        option = SimpleNamespace(timestep=model.opt.timestep.numpy(), gravity=model.opt.gravity.numpy())
        fields = {name: getattr(model, name).numpy() for name in ("body_mass", "body_inertia", "body_iquat")}
        return SimpleNamespace(**fields, opt=option)

    def put(self, **state: Array) -> None:
        for name, value in state.items():
            getattr(self._data, name).assign(value)

    def step(self, steps: int) -> None:
        for _ in range(steps):
            self._warp.step(self._model, self._data)

    def get(self) -> tuple[Array, Array]:
        return array(self._data.qpos.numpy()), array(self._data.qvel.numpy())


class _Port(_Worlds):
    """One body in Warp."""

    def __init__(self, model: mujoco.MjModel) -> None:
        super().__init__([model])

    def put(self, **state: Array) -> None:
        super().put(**{name: value[None] for name, value in state.items()})

    def put_gear(self, gear: Array) -> None:
        self._model.actuator_gear.assign(gear[None])

    def get(self) -> tuple[Array, Array]:
        qpos, qvel = super().get()
        return qpos[0], qvel[0]
