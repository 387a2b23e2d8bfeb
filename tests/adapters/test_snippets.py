"""The statements that select a method in a user's own program do what the adapter does."""

from __future__ import annotations

import math
from typing import Any

import pytest

from bodycheck.adapters.contract import Adapter, Method
from bodycheck.adapters.registry import get_adapter

DT_S = 0.0125


def methods(engine: str) -> list[Method]:
    """Return the methods of an engine; skip if it is not installed."""
    pytest.importorskip({"dart": "dartpy"}.get(engine, engine))
    adapter: Adapter = get_adapter(engine)
    return list(adapter.methods.values())


def run(method: Method, **names: Any) -> dict[str, Any]:
    """Execute the snippet with these names, and return all names."""
    exec(method.snippet.replace("{dt_s}", repr(DT_S)), names)
    return names


def test_mujoco() -> None:
    """The options of the model are the step and the integrator of the adapter's own model."""
    from bodycheck.adapters.mujoco import _INTEGRATORS

    mujoco = pytest.importorskip("mujoco")
    for method in methods("mujoco"):
        model = mujoco.MjSpec().compile()
        run(method, model=model, mujoco=mujoco)
        assert model.opt.timestep == DT_S
        assert model.opt.integrator == _INTEGRATORS[method.name.partition("@")[0]]


def test_pybullet() -> None:
    """Step, substeps, damping, kind of body and inertia equal those of the adapter."""
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        for method in methods("pybullet"):
            pybullet.resetSimulation()
            pybullet.setPhysicsEngineParameter(numSubSteps=0)
            moments = (1.0, 2.0, 2.5)
            given = {"mass": 1.0, "inertia": moments, "body": pybullet.createMultiBody(1.0)}
            names = run(method, p=pybullet, math=math, **given)
            world = pybullet.getPhysicsEngineParameters()
            assert world["fixedTimeStep"] == DT_S
            assert max(world["numSubSteps"], 1) == (4 if "substeps" in method.name else 1)
            assert ("useMaximalCoordinates=True" in method.snippet) == method.name.startswith("maximal")
            if method.name.startswith("maximal"):
                assert pybullet.getDynamicsInfo(names["body"], -1)[2] == moments
            if method.name.startswith("multibody"):
                pybullet.changeDynamics(names["body"], -1, localInertiaDiagonal=(1.0, 1.0, 1.0))
                pybullet.resetBaseVelocity(names["body"], angularVelocity=(0.0, 0.0, 1.0))
                pybullet.stepSimulation()
                is_undamped = pybullet.getBaseVelocity(names["body"])[1] == (0.0, 0.0, 1.0)
                assert is_undamped == ("damping 0" in method.changed_defaults)
    finally:
        pybullet.disconnect(client)


def test_dart() -> None:
    """The world makes steps of this length."""
    dartpy = pytest.importorskip("dartpy")
    for method in methods("dart"):
        world = dartpy.simulation.World()
        run(method, world=world)
        assert world.getTimeStep() == DT_S
