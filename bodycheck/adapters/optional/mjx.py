"""MJX: MuJoCo in JAX, in float32 and, by the methods @float64, in float64."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from bodycheck.adapters.batches import Batch, BatchAnswer
from bodycheck.adapters.contract import VARIANT, Method, Simulation
from bodycheck.adapters.optional.between_steps import FreeBodiesOnly, array
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import plan_steps

if TYPE_CHECKING:
    import mujoco

    from bodycheck.adapters.gradients import Gradients

_FLOAT64 = f"{VARIANT}float64"
_EULER = Method(
    name="euler",
    formula="M1",
    order=1,
    evaluations=1,
    torque="zero-order hold",
    conserves="|q| = 1; linear momentum",
    source="MJX, mjx.step",
    snippet="model = mjx.put_model(m) with m.opt.timestep = {dt_s}; m.opt.integrator = mjINT_EULER",
    precision="float32",
)
_RK4 = replace(
    _EULER,
    name="rk4",
    formula="RK4 on the rotation group, stages averaged",
    order=2,
    evaluations=4,
    torque="every stage",
    snippet="model = mjx.put_model(m) with m.opt.timestep = {dt_s}; m.opt.integrator = mjINT_RK4",
)
_IMPLICITFAST = replace(
    _EULER,
    name="implicitfast",
    formula="M1; without MuJoCo's gyroscopic derivatives",
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


class Mjx(FreeBodiesOnly):
    """MuJoCo XLA (Google DeepMind)."""

    name = "mjx"
    distribution = "mujoco-mjx"
    requires = ("mujoco-mjx>=3.17", "jax")
    modules = ("mujoco.mjx",)
    methods: Mapping[str, Method] = {method.name: method for method in (*_SINGLE, *map(_double, _SINGLE))}
    tree_model = "bodycheck.adapters.optional.port_trees:MjxTree"

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Put MuJoCo's model of one body into JAX."""
        from bodycheck.adapters.optional.mujoco_ports import PortSimulation

        integrator, _, variant = method.partition(VARIANT)
        return PortSimulation(scene, dt_s, _Port(scene, integrator, dt_s, double=bool(variant)), "native")

    def gradients(self, scene: Scene, method: str, dt_s: float) -> Gradients:
        """Differentiate all steps in forward mode, by jax.jacfwd."""
        from bodycheck.adapters.gradients import Gradients
        from bodycheck.adapters.optional.mujoco_ports import PortSimulation

        integrator, _, variant = method.partition(VARIANT)
        port = _Port(scene, integrator, dt_s, double=bool(variant))
        PortSimulation(scene, dt_s, port, "native").apply(next(plan_steps(scene, dt_s).legs()).wrench)
        qpos, d_qpos, d_qvel = port.derivatives(plan_steps(scene, dt_s).steps)
        return Gradients.of(qpos[3:], d_qpos[3:], d_qvel[3:])

    def record_batch(self, batch: Batch) -> BatchAnswer | None:
        """Step free bodies by vmap; None for other batches."""
        from bodycheck.adapters.optional.mujoco_ports import record_worlds

        if not batch.is_free or self.unsupported(batch.template, batch.method):
            return None
        integrator, _, variant = batch.method.partition(VARIANT)
        worlds = partial(_Worlds, double=bool(variant))
        return record_worlds(batch, integrator, self.methods[batch.method].precision, worlds)


def jax_on_cpu(*, double: bool) -> Any:
    """Return JAX in a precision, which is that of the process; a case is built before it is stepped.

    Its results are then those of every machine, and its steps cost CPU time, which is what is measured.
    """
    import jax

    jax.config.update("jax_platforms", "cpu")
    if jax.config.jax_enable_x64 != double:
        jax.config.update("jax_enable_x64", double)
        jax.clear_caches()  # rk4 fails to compile with functions that were traced in the other precision
    return jax


class _Port:
    """A model in JAX, stepped by one compiled loop."""

    def __init__(self, scene: Scene, integrator: str, dt_s: float, *, double: bool) -> None:
        from mujoco import mjx

        from bodycheck.adapters.optional.mujoco_ports import mj_model

        self._jax: Any = jax_on_cpu(double=double)
        self._model = mjx.put_model(mj_model(scene, integrator, dt_s))
        self._data = mjx.make_data(self._model)

    def model(self) -> Any:
        return self._model

    def put(self, **state: Array) -> None:
        real = self._data.qpos.dtype
        arrays = {name: self._jax.numpy.asarray(value, dtype=real) for name, value in state.items()}
        self._data = self._data.replace(**arrays)

    def put_gear(self, gear: Array) -> None:
        real = self._data.qpos.dtype
        self._model = self._model.replace(actuator_gear=self._jax.numpy.asarray(gear, dtype=real))

    def step(self, steps: int) -> None:
        self._data = _stepped(_steps, self._model, self._data, steps)
        self._data.qpos.block_until_ready()

    def get(self) -> tuple[Array, Array]:
        return array(self._data.qpos), array(self._data.qvel)

    def derivatives(self, steps: int) -> tuple[Array, Array, Array]:
        """Return qpos (7,) after the steps, and slopes of it (7, 6) and qvel (6, 6) by moments and omega."""
        jax, moments = self._jax, self._model.body_inertia[1]
        parameters = jax.numpy.concatenate([moments, self._data.qvel[3:]])
        found = _stepped(_with_derivatives, self._model, self._data, steps, parameters)
        return array(found[0]), array(found[1]), array(found[2])


_GROWTH = 4
"""Numbers of bodies that are compiled for: powers of this number; the rest is filled with the last body."""


class _Worlds:
    """Models of one shape in JAX, with an axis for the bodies in all fields that differ."""

    def __init__(self, models: Sequence[mujoco.MjModel], *, double: bool) -> None:
        from mujoco import mjx

        from bodycheck.adapters.optional.mujoco_ports import OF_BODY

        jax = self._jax = jax_on_cpu(double=double)
        self._bodies, filled = len(models), 1
        while filled < self._bodies:
            filled *= _GROWTH
        every = [*models, *[models[-1]] * (filled - self._bodies)]
        first = mjx.put_model(models[0])
        data = mjx.make_data(first)
        self._real = data.qpos.dtype
        own = {
            name: jax.numpy.asarray(np.array([getattr(model, name) for model in every]), dtype=self._real)
            for name in OF_BODY
        }
        self._model = first.replace(**own)
        self._data = jax.tree_util.tree_map(lambda one: jax.numpy.stack([one] * filled), data)

    def model(self) -> Any:
        return self._model

    def put(self, **state: Array) -> None:
        more = len(self._data.qpos) - self._bodies
        arrays = {}
        for name, value in state.items():
            every = np.concatenate([value, value[-1:].repeat(more, axis=0)])
            arrays[name] = self._jax.numpy.asarray(every, dtype=self._real)
        self._data = self._data.replace(**arrays)

    def step(self, steps: int) -> None:
        self._data = _stepped(_worlds_steps, self._model, self._data, steps)
        self._data.qpos.block_until_ready()

    def get(self) -> tuple[Array, Array]:
        return array(self._data.qpos)[: self._bodies], array(self._data.qvel)[: self._bodies]


def _steps(model: Any, data: Any, steps: Any) -> Any:
    """Return the data of one body after the steps."""
    import jax
    from mujoco import mjx

    return jax.lax.fori_loop(0, steps, lambda _, arrays: mjx.step(model, arrays), data)


def _with_derivatives(model: Any, data: Any, steps: Any, parameters: Any) -> Any:
    """Return qpos of one body after the steps, and the slopes of qpos and qvel by its moments and omega."""
    import jax

    def end(values: Any) -> Any:
        moved = data.replace(qvel=data.qvel.at[3:].set(values[3:]))
        turned = model.replace(body_inertia=model.body_inertia.at[1].set(values[:3]))
        after = _steps(turned, moved, steps)
        return (after.qpos, after.qvel), after.qpos

    slopes, at_end = jax.jacfwd(end, has_aux=True)(parameters)
    return at_end, *slopes


def _worlds_steps(model: Any, data: Any, steps: Any) -> Any:
    """Return the data of many bodies after the steps."""
    import jax

    from bodycheck.adapters.optional.mujoco_ports import OF_BODY

    axes = jax.tree_util.tree_map(lambda _: None, model).replace(**dict.fromkeys(OF_BODY, 0))
    return jax.vmap(_steps, in_axes=(axes, 0, None))(model, data, steps)


_compiled: dict[Any, Any] = {}
"""(precision, function, structure and types of its arguments) -> the compiled function."""


def _stepped(function: Callable[..., Any], model: Any, data: Any, steps: int, *more: Any) -> Any:
    """Call a function that is compiled once per integrator, number of loads and bodies, and precision."""
    import jax

    arguments = model, data, jax.numpy.asarray(steps, dtype=np.int32), *more
    leaves, structure = jax.tree_util.tree_flatten(arguments)
    double = bool(jax.config.jax_enable_x64)
    key = (double, function, structure, tuple((leaf.shape, leaf.dtype) for leaf in leaves))
    if key not in _compiled:
        _compiled[key] = jax.jit(function).lower(*arguments).compile()
    return _compiled[key](*arguments)
