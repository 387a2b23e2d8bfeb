"""MJX: MuJoCo in JAX, in float32 and, by the methods @float64, in float64."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from importlib.metadata import version
from typing import Any

from bodycheck.adapters.contract import VARIANT, Method, Simulation
from bodycheck.adapters.optional.between_steps import array, only_free
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene

_FLOAT64 = f"{VARIANT}float64"
_M1 = "omega += h I^-1 (tau - omega x I omega); q = q exp(h omega)"
_EULER = Method(
    name="euler",
    formula=_M1,
    order=1,
    evaluations=1,
    torque="held over the step",
    keeps="|q| = 1; linear momentum",
    source="MJX, mjx.step",
    snippet="model = mjx.put_model(m) with m.opt.timestep = {dt_s}; m.opt.integrator = mjINT_EULER",
    precision="float32",
)
_RK4 = replace(
    _EULER,
    name="rk4",
    formula="classical Runge-Kutta 4 on the rotation group, without a correction for the group",
    order=2,
    evaluations=4,
    torque="every stage",
    snippet="model = mjx.put_model(m) with m.opt.timestep = {dt_s}; m.opt.integrator = mjINT_RK4",
)
_IMPLICITFAST = replace(
    _EULER,
    name="implicitfast",
    formula=f"{_M1}; without MuJoCo's gyroscopic derivatives",
    snippet="model = mjx.put_model(m) with m.opt.timestep = {dt_s}; m.opt.integrator = mjINT_IMPLICITFAST",
)
_SINGLE = (_EULER, _RK4, _IMPLICITFAST)


def _double(method: Method) -> Method:
    return replace(
        method,
        name=f"{method.name}{_FLOAT64}",
        precision="float64",
        changed_defaults=("jax_enable_x64",),
        snippet=f"jax.config.update('jax_enable_x64', True); {method.snippet}",
    )


class Mjx:
    """MuJoCo XLA (Google DeepMind)."""

    name = "mjx"
    distribution = "mujoco-mjx"
    requires = ("mujoco-mjx>=3.17", "jax")
    methods: Mapping[str, Method] = {method.name: method for method in (*_SINGLE, *map(_double, _SINGLE))}

    def __init__(self) -> None:
        from mujoco import mjx  # noqa: F401 - before any case, as it takes seconds

        self.version = version(self.distribution)

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract's signature
        """Refuse pivots and link frames."""
        return only_free(scene)

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Put MuJoCo's model of one body into JAX."""
        from bodycheck.adapters.optional.mujoco_ports import PortSimulation

        integrator, _, variant = method.partition(VARIANT)
        return PortSimulation(scene, dt_s, _Port(scene, integrator, dt_s, double=bool(variant)), "native")


class _Port:
    """A model in JAX, stepped by one compiled loop."""

    def __init__(self, scene: Scene, integrator: str, dt_s: float, *, double: bool) -> None:
        import jax
        from mujoco import mjx

        from bodycheck.adapters.optional.mujoco_ports import mj_model

        if jax.config.jax_enable_x64 != double:  # of the process; a case is built before it is stepped
            jax.config.update("jax_enable_x64", double)
            jax.clear_caches()  # they hold functions of the other precision, which fail to compile in rk4
        self._jax: Any = jax
        self._model = mjx.put_model(mj_model(scene, integrator, dt_s))
        self._data = mjx.make_data(self._model)
        self._stepped = _stepper()

    def model(self) -> Any:
        return self._model

    def put(self, **state: Array) -> None:
        real = self._data.qpos.dtype
        held = {name: self._jax.numpy.asarray(value, dtype=real) for name, value in state.items()}
        self._data = self._data.replace(**held)

    def put_gear(self, gear: Array) -> None:
        real = self._data.qpos.dtype
        self._model = self._model.replace(actuator_gear=self._jax.numpy.asarray(gear, dtype=real))

    def step(self, steps: int) -> None:
        self._data = self._stepped(self._model, self._data, steps)
        self._data.qpos.block_until_ready()

    def get(self) -> tuple[Array, Array]:
        return array(self._data.qpos), array(self._data.qvel)


@cache
def _stepper() -> Any:
    """Return (model, data, steps) -> data, which is compiled once per integrator and precision."""
    import jax
    from mujoco import mjx

    def stepped(model: Any, data: Any, steps: Any) -> Any:
        return jax.lax.fori_loop(0, steps, lambda _, held: mjx.step(model, held), data)

    return jax.jit(stepped)
