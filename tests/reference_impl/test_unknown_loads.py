"""A load of an unknown kind is refused by name and never ignored."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np
import pytest

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.engine_loads import ZeroOrderHold
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.workers.case_messages import scene_message
from bodycheck.reference_impl.closed_forms.exact_motion import closed_form_of
from bodycheck.reference_impl.continuous_loads import packed_continuous_loads
from bodycheck.reference_impl.pivot import about_pivot
from bodycheck.reference_impl.scene import Load, RigidBody, Scene, State, Torque
from bodycheck.reference_impl.taylor.forcing import forcing_between
from bodycheck.reference_impl.taylor.prepared_motion import TaylorMotion
from bodycheck.reference_impl.taylor.principal_frame import PrincipalFrame, packed_rotation
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.truth.certification import certified_truth, solve_truth
from bodycheck.reference_impl.truth.motion_distance import potential_energy
from bodycheck.reference_impl.truth.step_halving import solve_by_halving
from bodycheck.reference_impl.wrench import continuous_wrench_of, sum_of_wrenches, wrench_of
from bodycheck.reports.cache.truths import known_truth
from bodycheck.reports.measurement.compared_motion import EnergyAndMomentum
from bodycheck.reports.measurement.work import working_loads
from tests.helpers.expected_messages import ExpectedMessage


@dataclass(frozen=True, eq=False)
class Magnet:
    """A load of an unknown kind, with the fields of a constant and of a continuous load."""

    strength: float = 1.0
    from_s: float = 0.0
    until_s: float = 9.0
    value: Any = None


MAGNET = cast("Load", Magnet(value=np.ones(3)))
START = State(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3), np.array([0.1, 2.0, 0.1]))
SCENE = Scene(RigidBody(1.0, np.diag([1.0, 2.0, 2.5])), START, (MAGNET,), np.zeros(3), 1.0, 3)
MOTION = Trajectory(
    t_s=SCENE.sample_times,
    position_m=np.zeros((3, 3)),
    velocity_m_s=np.zeros((3, 3)),
    quaternion=np.tile(START.quaternion, (3, 1)),
    omega_body_rad_s=np.tile(START.omega_body, (3, 1)),
)
AT = (0.0, np.zeros(3), np.eye(3), np.zeros(3), np.ones(3))

CONSUMERS: dict[str, Callable[[], object]] = {
    "truth": lambda: solve_truth(SCENE, SCENE.sample_times),
    "certified truth": lambda: certified_truth(SCENE, SCENE.sample_times),
    "cached truth": lambda: known_truth(SCENE, SCENE.sample_times, None),
    "halved steps": lambda: solve_by_halving(SCENE, SCENE.sample_times),
    "Taylor constants": lambda: forcing_between(SCENE, 0.0, 1.0),
    "Taylor series": lambda: TaylorMotion.of(SCENE, 1e-12),
    "principal axes": lambda: packed_rotation(SCENE, PrincipalFrame.of(SCENE.body), 0.0, 1.0),
    "continuous constants": lambda: packed_continuous_loads(SCENE),
    "continuous wrench": lambda: continuous_wrench_of(SCENE)(*AT),
    "sum of wrenches": lambda: sum_of_wrenches(SCENE.loads, SCENE)(*AT),
    "held between steps": lambda: ZeroOrderHold(SCENE, 0.1),
    "timed wrench": lambda: wrench_of(((cast("Torque", MAGNET), 1.0),)),
    "pivot": lambda: about_pivot(replace(SCENE, pivot=np.ones(3))),
    "potential energy": lambda: potential_energy(SCENE, MOTION),
    "energy and momentum": lambda: EnergyAndMomentum.of(SCENE, MOTION),
    "work": lambda: working_loads(SCENE, 0.0, 1.0),
    "message to a worker": lambda: scene_message(SCENE),
}


@pytest.mark.parametrize("name", CONSUMERS)
def test_unknown_load_is_refused_by_name(name: str, expected_message: ExpectedMessage) -> None:
    """Each consumer raises an error with the load's kind and computes nothing."""
    with expected_message.raises(ValueError):
        CONSUMERS[name]()


@pytest.mark.parametrize(
    ("engine", "module", "method"),
    [
        ("reference", "bodycheck", "rk4"),
        ("reference", "bodycheck", "taylor"),
        ("mujoco", "mujoco", "rk4"),
        ("pybullet", "pybullet", "multibody"),
        ("dart", "dartpy", "semi-implicit"),
    ],
)
def test_no_engine_steps_an_unknown_load(
    engine: str, module: str, method: str, expected_message: ExpectedMessage
) -> None:
    """An adapter refuses the load when it builds its model or makes its first step."""
    pytest.importorskip(module)
    setting = Setting(tolerance=1e-12) if method == "taylor" else Setting(dt_s=0.05)
    with expected_message.raises(ValueError):
        record(get_adapter(engine), Case(SCENE, method, setting))


def test_unknown_load_has_no_closed_form() -> None:
    """A scene with such a load has no closed form."""
    assert closed_form_of(SCENE) is None
