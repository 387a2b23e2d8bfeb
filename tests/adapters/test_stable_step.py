"""The largest stable step: its search, linear theory, and comparison with a scan of every step."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.contract import Reading, Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.stable_step import StableStep, StableStepSearch, largest_stable, stable_step
from bodycheck.adapters.workers import case_messages, protocol, received_messages
from bodycheck.adapters.workers.worker import RequestHandler
from bodycheck.reference_impl.scene import Drag, Load, RigidBody, Scene, Spring, State, Torque
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage


def unstable_above(limit: float) -> Callable[[float], str | None]:
    """Return a method that is unstable at every step above a limit."""
    return lambda step: f"broken at {step!r}" if step > limit else None


@pytest.mark.parametrize("limit", [1.01e-3, 3e-3, 0.0333, 0.5, 0.99])
@pytest.mark.parametrize("start", [1e-3, 0.4])
def test_bracket_contains_the_limit_within_one_percent(limit: float, start: float) -> None:
    """The limit lies between the stable and the unstable step, 1 % apart, the latter with its reason."""
    found = largest_stable(unstable_above(limit), start, 1e-4, 1.0)
    assert found.stable_s is not None
    assert found.unstable_s is not None
    assert found.stable_s <= limit < found.unstable_s <= 1.01 * found.stable_s
    assert found.reason == f"broken at {found.unstable_s!r}"


@pytest.mark.parametrize("begin", [0.031, 0.07, 0.1, 0.23, 0.44])
def test_first_unstable_steps_count(begin: float) -> None:
    """A band of unstable steps that is wider than a tenth is never skipped."""
    found = largest_stable(lambda step: "sea" if begin < step < 1.11 * begin else None, 1e-2, 1e-3, 1.0)
    assert found.stable_s == pytest.approx(begin, rel=0.01)


# ------------------------------------------------------------------------------------------- linear theory


def loaded(load: Load, start: State, duration_s: float) -> Scene:
    """Return a body of 2 kg that rotates about a general axis, far slower than its load oscillates."""
    body = RigidBody(2.0, np.diag([1.0, 2.0, 2.5]))
    return Scene(body, start, (load,), np.zeros(3), duration_s, 101)


MOVING = State(np.array([0.0, 0.0, 1.0]), np.array([1.0, 0, 0, 0]), np.zeros(3), np.array([0.1, 0.2, 0.1]))
SPRING = loaded(Spring(np.zeros(3), np.zeros(3), stiffness=2e4, rest_length=0.0), MOVING, 20.0)
DRAG = loaded(Drag(200.0, np.zeros((3, 3))), replace(MOVING, velocity=np.array([1.0, 2.0, 0.5])), 20.0)
THEORY = {
    # Hairer, Lubich and Wanner (2006), Geometric Numerical Integration, I.1: symplectic Euler, omega dt < 2
    "spring, symplectic Euler": (SPRING, "m1", 2.0 / 100.0),
    # Hairer and Wanner (1996), Solving Ordinary Differential Equations II, IV.2: on the axes
    "spring, Runge-Kutta 4": (SPRING, "rk4", 2.0 * math.sqrt(2.0) / 100.0),
    "drag, explicit Euler": (DRAG, "m1", 2.0 / 100.0),
    "drag, Runge-Kutta 4": (DRAG, "rk4", 2.785293563405282 / 100.0),
}


@pytest.mark.parametrize("what", THEORY)
def test_limit_equals_that_of_linear_theory(what: str) -> None:
    """Stiff springs and drag make an explicit method unstable at the theoretical step, within 2 %."""
    scene, method, limit = THEORY[what]
    found = stable_step(
        Reference(), StableStepSearch(Case(scene, method, Setting(dt_s=1e-3)), 1e-4, 0.1, 1e6)
    )
    assert found.outcome == "ok"
    assert found.stable_s == pytest.approx(limit, rel=0.02)
    assert found.unstable_s == pytest.approx(limit, rel=0.02)


# --------------------------------------------------------------------------------------------- brute force


def breaks_down(engine: str, scene: Scene, method: str, dt_s: float, limit_j: float) -> bool:
    """Return whether a recorded case, sampled at every step, is not finite or exceeds the limit of K."""
    steps = math.ceil(scene.duration_s / dt_s - 1e-9)
    status_line = replace(scene, duration_s=steps * dt_s, samples=steps + 1)
    motion = record(get_adapter(engine), Case(status_line, method, Setting(dt_s=dt_s))).trajectory
    assert motion is not None
    with np.errstate(all="ignore"):
        held = (motion.quaternion, motion.rotation, motion.omega_world_rad_s, motion.omega_body_rad_s)
        if not all(np.all(np.isfinite(part)) for part in held if part is not None):
            return True
        omega, velocity = motion.omega_body, motion.velocity_m_s
        kinetic = 0.5 * np.einsum("ni,ij,nj->n", omega, scene.body.inertia, omega)
        kinetic += 0.5 * scene.body.mass * np.sum(velocity * velocity, axis=1)
        return not np.all(kinetic <= limit_j)


# for each scenario: the scanned duration, the steps between which its limits lie, and K's limit in J
SCANNED = {
    "stiff-spring": (0.5, 1.6e-3, 4e-3, 100.0),
    "stiff-drag": (0.5, 1.6e-3, 4e-3, 1000.0),
    "spring-pendulum": (5.0, 0.015, 0.8, 2000.0),
}
SCANNERS = [
    ("reference", "m1"),
    ("reference", "rk4"),
    ("reference", "euler"),
    ("mujoco", "euler"),
    ("dart", "semi-implicit"),
]


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    "scenario",
    ["stiff-spring", "stiff-drag", pytest.param("spring-pendulum", marks=pytest.mark.nightly)],
)
@pytest.mark.parametrize(("engine", "method"), SCANNERS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # an unstable motion overflows
def test_limit_equals_that_of_a_scan(scenario: str, engine: str, method: str) -> None:
    """The first unstable step of a scan in steps of 1 % is within 2 % of the limit."""
    if engine != "reference":
        pytest.importorskip({"mujoco": "mujoco", "dart": "dartpy"}[engine])
    duration, start, highest, limit_j = SCANNED[scenario]
    scene = replace(load_scenario(scenario).scene, duration_s=duration, samples=51)
    case = Case(scene, method, Setting(dt_s=start))
    found = stable_step(get_adapter(engine), StableStepSearch(case, start / 5.0, highest, limit_j))
    if found.stable_s is None:
        assert breaks_down(engine, scene, method, start / 5.0, limit_j)
        return
    scanned = np.geomspace(start, highest, 1 + math.ceil(math.log(highest / start, 1.01)))
    first = next((dt for dt in scanned if breaks_down(engine, scene, method, float(dt), limit_j)), None)
    assert first == pytest.approx(found.unstable_s, rel=0.02)


# ------------------------------------------------------------------------------------------------ messages

SEARCH = StableStepSearch(Case(SPRING, "m1", Setting(dt_s=1e-3)), 1e-4, 0.1, 1e6)


@pytest.mark.parametrize("limit", [1e6, math.inf])
def test_search_survives_its_message(limit: float) -> None:
    """A request that is written and read again is unchanged, even with an infinite limit of K."""
    message = case_messages.search_message(replace(SEARCH, kinetic_limit_j=limit))
    assert case_messages.search_message(case_messages.search_of(message)) == message
    assert case_messages.search_of(message).kinetic_limit_j == limit


def test_worker_answers_a_search() -> None:
    """A worker's answer equals the result of the search."""
    answer = RequestHandler(Reference()).answer(
        {"id": 1, "do": "stable-step", **case_messages.search_message(SEARCH)}
    )
    assert received_messages.stable_step_of(answer) == stable_step(Reference(), SEARCH)


def test_unsupported_scene_is_reported() -> None:
    """No step is tried for a scene that the method does not support."""
    found = stable_step(Reference(), replace(SEARCH, case=Case(DRAG, "splitting6", Setting(dt_s=1e-3))))
    assert (found.outcome, found.stable_s) == ("unsupported", None)
    assert found.message


@pytest.mark.parametrize(
    "wrong",
    [
        {},
        {"stable_s": None, "unstable_s": None},
        {"stable_s": "much", "unstable_s": None},
        {"stable_s": True, "unstable_s": None},
        {"stable_s": 0.2, "unstable_s": 0.1},
        {"stable_s": -0.2, "unstable_s": 0.1},
        {"stable_s": math.nan, "unstable_s": 0.1},
        {"stable_s": 0.1, "unstable_s": math.inf},
    ],
)
def test_answer_without_a_valid_step_is_refused(wrong: dict[str, object]) -> None:
    """An answer without a step, or with one that is not a positive number, is refused."""
    with pytest.raises(protocol.ProtocolError):
        received_messages.stable_step_of({"outcome": "ok", "message": "", "reason": "", **wrong})


# -------------------------------------------------------------------------------------- trials of the search


def trials(limit: float, start: float, lowest: float, highest: float) -> tuple[list[float], StableStep]:
    """Return the steps tried with a method that is unstable above a limit, and the result of the search."""
    tried: list[float] = []

    def broken(step: float) -> str | None:
        tried.append(step)
        return "broken" if step > limit else None

    return tried, largest_stable(broken, start, lowest, highest)


def test_scan_goes_up_by_a_tenth_and_then_bisects() -> None:
    """On a log scale the bracket is halved until it is at most 1 % wide."""
    tried, found = trials(1.5, 1.0, 0.1, 2.0)
    scan = [1.1**k for k in range(6)]
    assert tried[:6] == pytest.approx(scan)
    assert tried[6] == pytest.approx(math.sqrt(scan[4] * scan[5]))
    assert len(tried) == 6 + 4  # log 1.1 / 2^4 is the first width below log 1.01
    assert found.stable_s is not None
    assert found.unstable_s is not None
    assert found.stable_s <= 1.5 < found.unstable_s <= 1.01 * found.stable_s
    assert found.reason == "broken"


def test_scan_ends_with_the_highest_step() -> None:
    """The highest step is the last one tried."""
    tried, found = trials(9.0, 1.0, 0.1, 1.15)
    assert tried == pytest.approx([1.0, 1.1, 1.15])
    assert found == StableStep("ok", stable_s=1.15)
    assert trials(9.0, 1.0, 0.1, 1.0) == ([1.0], StableStep("ok", stable_s=1.0))


def test_unstable_start_is_halved_down_to_the_lowest_step() -> None:
    """The lowest step is tried, and from the first stable step the scan goes up."""
    tried, found = trials(0.0, 1.0, 0.3, 2.0)
    assert tried == [1.0, 0.5, 0.3]
    assert found == StableStep("ok", unstable_s=0.3, reason="broken")
    tried, found = trials(0.3, 1.0, 0.3, 2.0)
    assert tried[:4] == pytest.approx([1.0, 0.5, 0.3, 0.33])
    assert found.stable_s is not None
    assert found.stable_s == pytest.approx(0.3, rel=0.01)


# ------------------------------------------------------------------------------ the search in an engine


@dataclass
class Runner:
    """A body of 2 kg at 1 m/s whose speed changes at given steps; it records its calls."""

    scene: Scene
    dt_s: float
    speeds: dict[int, float]
    advanced: list[int] = field(default_factory=list)
    closed: int = 0

    def apply(self, wrench: Any) -> None:
        """Ignore all loads."""

    def advance(self, steps: int) -> None:
        """Count the steps."""
        self.advanced.append(steps)

    def read(self) -> Reading:
        """Return a reading with the speed of the last change."""
        made = sum(self.advanced)
        speed = [1.0, *(speed for begin, speed in self.speeds.items() if made >= begin)][-1]
        velocity = np.array([speed, 0.0, 0.0])
        return Reading(np.zeros(3), velocity, np.array([1.0, 0, 0, 0]), omega_body=np.zeros(3))

    def imu(self) -> Any:
        """Raise an error: a search has no use for the sensors, which cost time."""
        raise RuntimeError("sensors are read")

    def close(self) -> None:
        """Count the calls."""
        self.closed += 1


class Running:
    """An engine whose method is stable if its speeds are; it records its simulations."""

    def __init__(self, speeds: dict[int, float], above_s: float = 0.0) -> None:
        self.speeds, self.above_s, self.made = speeds, above_s, list[Runner]()

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Support all methods but one."""
        del scene
        return "no" if method == "none" else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Runner:
        """Build a simulation whose speed changes only at steps above the limit."""
        del method
        self.made.append(Runner(scene, dt_s, self.speeds if dt_s > self.above_s else {}))
        return self.made[-1]


def searched(
    engine: Any, dt_s: float, *loads: Torque, duration_s: float = 1.0, samples: int = 11, **cells: Any
) -> StableStep:
    """Return the result of a search, by default of one step only, for a body of 2 kg; K's limit is 100 J."""
    start = State(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    scene = Scene(RigidBody(2.0, np.eye(3)), start, loads, np.zeros(3), duration_s, samples)
    case = Case(scene, cells.pop("method", "rk4"), Setting(dt_s=dt_s))
    bounds = {"lowest_s": dt_s, "highest_s": dt_s, "kinetic_limit_j": 100.0, **cells}
    return stable_step(engine, StableStepSearch(case, **bounds))


@pytest.mark.parametrize(
    ("duration_s", "dt_s", "samples", "advanced"),
    [
        (1.0, 0.25, 11, [1, 1, 1, 1]),
        (1.0, 0.3, 3, [2, 2]),  # the last step ends after the scene
        (1.0, 0.2, 3, [2, 2, 1]),
        (1.1, 0.1, 2, [11]),  # 1.1 / 0.1 rounds to a number above 11
        (1.0, 3.0, 11, [1]),
        (1.0, 0.001, 1001, 20 * [50]),
        (1.0, 0.001, 11, 10 * [100]),
    ],
)
def test_trial_covers_the_scene_and_its_samples(
    duration_s: float, dt_s: float, samples: int, advanced: list[int]
) -> None:
    """A trial ends with its last step and reads at each sample, at most fifty times."""
    engine = Running({})
    found = searched(engine, dt_s, duration_s=duration_s, samples=samples)
    assert found == StableStep("ok", stable_s=dt_s)
    (made,) = engine.made
    assert (made.advanced, made.closed) == (advanced, 1)
    assert made.scene.duration_s == sum(advanced) * dt_s
    assert made.scene.samples == 2
    assert made.dt_s == pytest.approx(dt_s)


def test_trial_stops_at_every_switching_time() -> None:
    """Each segment between switching times is advanced separately."""
    engine = Running({})
    push = Torque("world", np.array([1.0, 0.0, 0.0]), from_s=0.3, until_s=0.8)
    searched(engine, 0.1, push, samples=6)
    assert engine.made[0].advanced == [2, 1, 2, 2, 1, 2]


@pytest.mark.parametrize(
    ("speeds", "reason"),
    [
        ({3: 10.0}, ""),  # K = 100 J, which is still allowed
        ({3: 10.1}, "kinetic energy above 100 times the true maximum from t = 0.3 s on"),
        ({3: 10.1, 4: 1.0}, "kinetic energy above 100 times the true maximum from t = 0.3 s on"),
        ({5: math.nan}, "velocity_m_s is not finite from t = 0.5 s on"),
        ({5: 1e200}, "kinetic energy above 100 times the true maximum from t = 0.5 s on"),
    ],
)
def test_method_is_unstable_at_an_invalid_reading(speeds: dict[int, float], reason: str) -> None:
    """Kinetic energy above its limit, or a value that is not finite, is reported with its time."""
    found = searched(Running(speeds), 0.1)
    expected = {"unstable_s": 0.1, "reason": reason} if reason else {"stable_s": 0.1}
    assert found == StableStep("ok", **expected)


def test_search_stays_within_its_bounds() -> None:
    """The search goes from the case's step down to the lowest and up to the highest step."""
    engine = Running({1: 1e3}, above_s=0.06)
    found = searched(engine, 0.2, lowest_s=0.05, highest_s=0.4)
    assert [made.dt_s for made in engine.made[:4]] == pytest.approx([0.2, 0.1, 0.05, 0.055])
    assert found.stable_s == pytest.approx(0.06, rel=0.01)
    assert all(made.closed == 1 for made in engine.made)
    assert searched(engine, 0.1, method="none") == StableStep("unsupported", "no")


def test_simulation_is_closed_when_the_engine_raises(
    monkeypatch: pytest.MonkeyPatch, expected_message: ExpectedMessage
) -> None:
    """The engine's error is passed on."""

    def give_up(runner: Runner, steps: int) -> None:
        raise RuntimeError(f"{runner.dt_s}: no solution after {steps} step")

    monkeypatch.setattr(Runner, "advance", give_up)
    engine = Running({})
    with expected_message.raises(RuntimeError):
        searched(engine, 0.1)
    assert engine.made[0].closed == 1
