"""Callback loads in engines: an error in a user's function fails its case with the reason, and no other."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from bodycheck.adapters.contract import Adapter, Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.stable_step import invalid_state
from bodycheck.adapters.workers.case_messages import case_message
from bodycheck.adapters.workers.worker import RequestHandler
from bodycheck.reference_impl.scene import CallbackLoad, RigidBody, Scene, State
from bodycheck.scenarios.user_functions import UserWrench, user_function

LOADS = """
def valid(t, x, r, v, omega):
    return -0.5 * v, -0.2 * omega


def raises(t, x, r, v, omega):
    return v if t < 0.27 else 1 // 0, omega


def ends(t, x, r, v, omega):
    raise SystemExit("enough")


def nan(t, x, r, v, omega):
    return v, [0.0, float("nan"), 0.0]


def infinite(t, x, r, v, omega):
    return [float("inf"), 0.0, 0.0], omega


def short(t, x, r, v, omega):
    return v[:2], omega


def nothing(t, x, r, v, omega):
    pass


def explosive(t, x, r, v, omega):
    return 1e60 * v, 1e60 * omega
"""
_THREE = "must return force and torque, three finite numbers each, not "
FAULTS = {
    "raises": "failed at t = 0.3",
    "ends": "failed at t = 0.0 s: SystemExit: enough",
    "nan": _THREE,
    "infinite": _THREE,
    "short": _THREE,
    "nothing": f"{_THREE}None (t = 0.0 s)",
}
METHODS = [
    ("mujoco", "MuJoCo", "euler"),
    ("mujoco", "MuJoCo", "rk4"),
    ("pybullet", "PyBullet", "multibody"),
    ("dart", "Dart", "semi-implicit"),
    ("reference", "Reference", "m1"),
    ("reference", "Reference", "rk4"),
]


@pytest.fixture
def functions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write the module loads_to_ask to the working directory."""
    (tmp_path / "loads_to_ask.py").write_text(LOADS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)


def case_with(function: str, method: str) -> Case:
    """Return a case of one second, in steps of 0.1 s, with a function of loads_to_ask as its load."""
    name = f"loads_to_ask:{function}"
    load = CallbackLoad(name, UserWrench(name, user_function(name, allow_code=True)))
    start = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.ones(3), np.array([0.3, 1.0, -0.2]))
    scene = Scene(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), start, (load,), np.zeros(3), 1.0, 2)
    return Case(scene, method, Setting(dt_s=0.1))


def adapter_of(engine: str, class_name: str) -> Adapter:
    """Return the engine, or skip the test."""
    pytest.importorskip({"dart": "dartpy", "reference": "numpy"}.get(engine, engine))
    adapter: Adapter = getattr(importlib.import_module(f"bodycheck.adapters.{engine}"), class_name)()
    return adapter


@pytest.mark.usefixtures("functions")
@pytest.mark.parametrize(("engine", "class_name", "method"), METHODS)
def test_failing_function_fails_only_its_case(engine: str, class_name: str, method: str) -> None:
    """The message names the function, its error and the time; the worker's next case is correct."""
    desk = RequestHandler(adapter_of(engine, class_name))
    valid = {"do": "record", "case": case_message(case_with("valid", method))}
    first = desk.answer(valid)
    assert (first["outcome"], first["stepping"]) == ("ok", "python")
    for function, text in FAULTS.items():
        answer = desk.answer({"do": "record", "case": case_message(case_with(function, method))})
        assert answer["outcome"] == "failed"
        assert f"loads_to_ask:{function}: {text}" in answer["message"]
        assert desk.answer(valid) == first


@pytest.mark.usefixtures("functions")
@pytest.mark.parametrize(("engine", "class_name", "method"), METHODS)
def test_diverging_body_is_unstable_and_not_a_function_error(
    engine: str, class_name: str, method: str
) -> None:
    """A function is not evaluated at a state that is not finite, so the case is unstable."""
    with np.errstate(over="ignore", invalid="ignore"):
        answer = record(adapter_of(engine, class_name), case_with("explosive", method))
    assert answer.outcome == "ok"
    assert answer.trajectory is not None
    assert "is not finite" in (invalid_state(answer.trajectory) or "")
