"""The largest stable step: of made-up methods, of linear theory, and beside a scan without any cleverness."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bodycheck.adapters.contract import Setting
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import get_adapter
from bodycheck.adapters.stable_step import Search, StableStep, largest_stable, stable_step
from bodycheck.adapters.workers import case_messages, protocol
from bodycheck.adapters.workers.worker import RequestHandler
from bodycheck.reference_impl.scene import Drag, Load, RigidBody, Scene, Spring, State
from bodycheck.scenarios.library import load_scenario


def unstable_above(limit: float) -> Callable[[float], str | None]:
    """Return a method that breaks down at every step above a limit."""
    return lambda step: f"broken at {step!r}" if step > limit else None


@pytest.mark.parametrize("limit", [1.01e-3, 3e-3, 0.0333, 0.5, 0.99])
@pytest.mark.parametrize("start", [1e-3, 0.4])
def test_the_bracket_holds_the_limit_to_one_percent(limit: float, start: float) -> None:
    """The largest stable step is below the limit, the next unstable one above, 1 % apart, with its reason."""
    found = largest_stable(unstable_above(limit), start, 1e-4, 1.0)
    assert found.stable_s is not None
    assert found.unstable_s is not None
    assert found.stable_s <= limit < found.unstable_s <= 1.01 * found.stable_s
    assert found.reason == f"broken at {found.unstable_s!r}"


def test_a_method_that_never_breaks_down_is_stable_up_to_the_highest_step() -> None:
    """There is no unstable step then, and no reason."""
    assert largest_stable(unstable_above(2.0), 1e-3, 1e-4, 1.0) == StableStep("ok", stable_s=1.0)


def test_a_method_that_always_breaks_down_has_no_stable_step() -> None:
    """The lowest step is the one that was found unstable."""
    found = largest_stable(unstable_above(0.0), 1e-3, 1e-4, 1.0)
    assert (found.stable_s, found.unstable_s, found.reason) == (None, 1e-4, "broken at 0.0001")


@pytest.mark.parametrize("begin", [0.031, 0.07, 0.1, 0.23, 0.44])
def test_the_first_unstable_steps_count_and_not_the_last(begin: float) -> None:
    """An island of unstable steps that is wider than a tenth is never passed over."""
    found = largest_stable(lambda step: "sea" if begin < step < 1.11 * begin else None, 1e-2, 1e-3, 1.0)
    assert found.stable_s == pytest.approx(begin, rel=0.01)


# ------------------------------------------------------------------------------------------- linear theory


def loaded(load: Load, start: State, duration_s: float) -> Scene:
    """Return a body of 2 kg that turns about no axis in particular, far slower than its load pulls."""
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
def test_the_limit_is_that_of_linear_theory(what: str) -> None:
    """Stiff springs and drag break an explicit method down at the step that theory gives, within 2 %."""
    scene, method, limit = THEORY[what]
    found = stable_step(Reference(), Search(Case(scene, method, Setting(dt_s=1e-3)), 1e-4, 0.1, 1e6))
    assert found.outcome == "ok"
    assert found.stable_s == pytest.approx(limit, rel=0.02)
    assert found.unstable_s == pytest.approx(limit, rel=0.02)


# --------------------------------------------------------------------------------------------- brute force


def breaks_down(engine: str, scene: Scene, method: str, dt_s: float, limit_j: float) -> bool:
    """Whether a recorded case, sampled at every step, is ever not finite or above the limit of K."""
    steps = math.ceil(scene.duration_s / dt_s - 1e-9)
    watched = replace(scene, duration_s=steps * dt_s, samples=steps + 1)
    motion = record(get_adapter(engine), Case(watched, method, Setting(dt_s=dt_s))).trajectory
    assert motion is not None
    with np.errstate(all="ignore"):
        held = (motion.quaternion, motion.rotation, motion.omega_world_rad_s, motion.omega_body_rad_s)
        if not all(np.all(np.isfinite(part)) for part in held if part is not None):
            return True
        omega, velocity = motion.omega_body, motion.velocity_m_s
        kinetic = 0.5 * np.einsum("ni,ij,nj->n", omega, scene.body.inertia, omega)
        kinetic += 0.5 * scene.body.mass * np.sum(velocity * velocity, axis=1)
        return not np.all(kinetic <= limit_j)


# of a scenario: the duration that is scanned, the steps between which its limits lie, and K's limit in J
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
@pytest.mark.parametrize(
    "scenario",
    ["stiff-spring", "stiff-drag", pytest.param("spring-pendulum", marks=pytest.mark.nightly)],
)
@pytest.mark.parametrize(("engine", "method"), SCANNERS)
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # what runs away overflows
def test_the_limit_is_that_of_a_scan_of_every_step(scenario: str, engine: str, method: str) -> None:
    """The first unstable step of a scan in steps of 1 %, judged at every step, is within 2 % of the limit."""
    if engine != "reference":
        pytest.importorskip({"mujoco": "mujoco", "dart": "dartpy"}[engine])
    duration, start, highest, limit_j = SCANNED[scenario]
    scene = replace(load_scenario(scenario).scene, duration_s=duration, samples=51)
    case = Case(scene, method, Setting(dt_s=start))
    found = stable_step(get_adapter(engine), Search(case, start / 5.0, highest, limit_j))
    if found.stable_s is None:
        assert breaks_down(engine, scene, method, start / 5.0, limit_j)
        return
    scanned = np.geomspace(start, highest, 1 + math.ceil(math.log(highest / start, 1.01)))
    first = next((dt for dt in scanned if breaks_down(engine, scene, method, float(dt), limit_j)), None)
    assert first == pytest.approx(found.unstable_s, rel=0.02)


# ------------------------------------------------------------------------------------------------ messages

SEARCH = Search(Case(SPRING, "m1", Setting(dt_s=1e-3)), 1e-4, 0.1, 1e6)


@pytest.mark.parametrize("limit", [1e6, math.inf])
def test_a_search_is_the_same_after_its_message(limit: float) -> None:
    """Read and written again a request is the very same, an infinite limit of K too."""
    message = case_messages.search_message(replace(SEARCH, kinetic_limit_j=limit))
    assert case_messages.search_message(case_messages.search_of(message)) == message
    assert case_messages.search_of(message).kinetic_limit_j == limit


def test_a_worker_answers_a_search() -> None:
    """What a worker says is what the search finds."""
    answer = RequestHandler(Reference()).answer(
        {"id": 1, "do": "stable-step", **case_messages.search_message(SEARCH)}
    )
    assert protocol.stable_step_of(answer) == stable_step(Reference(), SEARCH)


def test_a_scene_that_an_engine_cannot_represent_is_unsupported() -> None:
    """No step is tried then."""
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
def test_what_says_no_step_is_no_answer(wrong: dict[str, object]) -> None:
    """Neither no step at all nor what is no positive number passes for a finding."""
    with pytest.raises(protocol.ProtocolError):
        protocol.stable_step_of({"outcome": "ok", "message": "", "reason": "", **wrong})
