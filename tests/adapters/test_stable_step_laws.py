"""The trials of the search for the largest stable step: which steps, how many of each, and where it looks."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest

from bodycheck.adapters.contract import Reading, Setting
from bodycheck.adapters.execution import Case
from bodycheck.adapters.stable_step import Search, StableStep, largest_stable, stable_step
from bodycheck.reference_impl.scene import RigidBody, Scene, State, Torque


def trials(limit: float, start: float, lowest: float, highest: float) -> tuple[list[float], StableStep]:
    """Return the steps that are tried of a method that breaks down above a limit, and what is found."""
    tried: list[float] = []

    def broken(step: float) -> str | None:
        tried.append(step)
        return "broken" if step > limit else None

    return tried, largest_stable(broken, start, lowest, highest)


def test_a_scan_goes_upward_by_a_tenth_and_then_halves_the_bracket() -> None:
    """On a log scale, until it is no wider than 1 %."""
    tried, found = trials(1.5, 1.0, 0.1, 2.0)
    scan = [1.1**k for k in range(6)]
    assert tried[:6] == pytest.approx(scan)
    assert tried[6] == pytest.approx(math.sqrt(scan[4] * scan[5]))
    assert len(tried) == 6 + 4  # log 1.1 / 2^4 is the first within log 1.01
    assert found.stable_s is not None
    assert found.unstable_s is not None
    assert found.stable_s <= 1.5 < found.unstable_s <= 1.01 * found.stable_s
    assert found.reason == "broken"


def test_a_scan_ends_with_the_highest_step() -> None:
    """Which is tried itself, and nothing after it."""
    tried, found = trials(9.0, 1.0, 0.1, 1.15)
    assert tried == pytest.approx([1.0, 1.1, 1.15])
    assert found == StableStep("ok", stable_s=1.15)
    assert trials(9.0, 1.0, 0.1, 1.0) == ([1.0], StableStep("ok", stable_s=1.0))


def test_an_unstable_start_is_halved_down_to_the_lowest_step() -> None:
    """Which is tried itself; from the first stable one the scan goes upward."""
    tried, found = trials(0.0, 1.0, 0.3, 2.0)
    assert tried == [1.0, 0.5, 0.3]
    assert found == StableStep("ok", unstable_s=0.3, reason="broken")
    tried, found = trials(0.3, 1.0, 0.3, 2.0)
    assert tried[:4] == pytest.approx([1.0, 0.5, 0.3, 0.33])
    assert found.stable_s is not None
    assert found.stable_s == pytest.approx(0.3, rel=0.01)


# ------------------------------------------------------------------------------------------- of an engine


@dataclass
class Runner:
    """A body of 2 kg at 1 m/s, whose speed is another from some step on; it keeps what it was asked."""

    scene: Scene
    dt_s: float
    speeds: dict[int, float]
    advanced: list[int] = field(default_factory=list)
    closed: int = 0

    def apply(self, wrench: Any) -> None:
        """Heed no load."""

    def advance(self, steps: int) -> None:
        """Count."""
        self.advanced.append(steps)

    def read(self) -> Reading:
        """Return the speed of the last change."""
        made = sum(self.advanced)
        speed = [1.0, *(speed for begin, speed in self.speeds.items() if made >= begin)][-1]
        velocity = np.array([speed, 0.0, 0.0])
        return Reading(np.zeros(3), velocity, np.array([1.0, 0, 0, 0]), omega_body=np.zeros(3))

    def close(self) -> None:
        """Count."""
        self.closed += 1


class Running:
    """An engine whose method is stable wherever its speeds say so; it keeps its simulations."""

    def __init__(self, speeds: dict[int, float], above_s: float = 0.0) -> None:
        self.speeds, self.above_s, self.made = speeds, above_s, list[Runner]()

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Refuse one method."""
        del scene
        return "no" if method == "none" else None

    def build(self, scene: Scene, method: str, dt_s: float) -> Runner:
        """Build one, that runs away only at steps above the limit."""
        del method
        self.made.append(Runner(scene, dt_s, self.speeds if dt_s > self.above_s else {}))
        return self.made[-1]


def searched(
    engine: Any, dt_s: float, *loads: Torque, duration_s: float = 1.0, samples: int = 11, **cells: Any
) -> StableStep:
    """Return what is found from one step up to it, of a body of 2 kg; the limit of K is 100 J."""
    start = State(np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3), np.zeros(3))
    scene = Scene(RigidBody(2.0, np.eye(3)), start, loads, np.zeros(3), duration_s, samples)
    case = Case(scene, cells.pop("method", "rk4"), Setting(dt_s=dt_s))
    bounds = {"lowest_s": dt_s, "highest_s": dt_s, "kinetic_limit_j": 100.0, **cells}
    return stable_step(engine, Search(case, **bounds))


@pytest.mark.parametrize(
    ("duration_s", "dt_s", "samples", "advanced"),
    [
        (1.0, 0.25, 11, [1, 1, 1, 1]),
        (1.0, 0.3, 3, [2, 2]),  # the last step ends after the scene
        (1.0, 0.2, 3, [2, 2, 1]),
        (1.1, 0.1, 2, [11]),  # 1.1 / 0.1 is a rounding above 11
        (1.0, 3.0, 11, [1]),
        (1.0, 0.001, 1001, 50 * [20]),
        (1.0, 0.001, 11, 10 * [100]),
    ],
)
def test_a_trial_lasts_as_long_as_the_scene_and_looks_as_often(
    duration_s: float, dt_s: float, samples: int, advanced: list[int]
) -> None:
    """To the end of its last step; as often as there are samples, and fifty times at the most."""
    engine = Running({})
    found = searched(engine, dt_s, duration_s=duration_s, samples=samples)
    assert found == StableStep("ok", stable_s=dt_s)
    (made,) = engine.made
    assert (made.advanced, made.closed) == (advanced, 1)
    assert made.scene.duration_s == sum(advanced) * dt_s
    assert made.scene.samples == 2
    assert made.dt_s == pytest.approx(dt_s)


def test_a_trial_goes_through_every_load_that_comes_and_goes() -> None:
    """Each stretch in pieces of its own."""
    engine = Running({})
    push = Torque("world", np.array([1.0, 0.0, 0.0]), from_s=0.3, until_s=0.8)
    searched(engine, 0.1, push, samples=6)
    assert engine.made[0].advanced == [2, 1, 2, 2, 1, 2]


@pytest.mark.parametrize(
    ("speeds", "reason"),
    [
        ({3: 10.0}, ""),  # K = 100 J, and no more
        ({3: 10.1}, "kinetic energy above 100 times the true maximum from t = 0.3 s on"),
        ({3: 10.1, 4: 1.0}, "kinetic energy above 100 times the true maximum from t = 0.3 s on"),
        ({5: math.nan}, "velocity_m_s is not finite from t = 0.5 s on"),
        ({5: 1e200}, "kinetic energy above 100 times the true maximum from t = 0.5 s on"),
    ],
)
def test_a_method_breaks_down_where_a_look_finds_what_is_no_motion(
    speeds: dict[int, float], reason: str
) -> None:
    """More kinetic energy than its limit, or what is not finite, with its time."""
    found = searched(Running(speeds), 0.1)
    expected = {"unstable_s": 0.1, "reason": reason} if reason else {"stable_s": 0.1}
    assert found == StableStep("ok", **expected)


def test_the_search_is_bounded_by_what_it_is_asked() -> None:
    """From the case's step downward to the lowest and upward to the highest."""
    engine = Running({1: 1e3}, above_s=0.06)
    found = searched(engine, 0.2, lowest_s=0.05, highest_s=0.4)
    assert [made.dt_s for made in engine.made[:4]] == pytest.approx([0.2, 0.1, 0.05, 0.055])
    assert found.stable_s == pytest.approx(0.06, rel=0.01)
    assert all(made.closed == 1 for made in engine.made)
    assert searched(engine, 0.1, method="none") == StableStep("unsupported", "no")


def test_a_simulation_is_closed_also_where_the_engine_raises(monkeypatch: pytest.MonkeyPatch) -> None:
    """And what it raised passes."""

    def give_up(runner: Runner, steps: int) -> None:
        raise RuntimeError(f"{runner.dt_s}: no solution after {steps} step")

    monkeypatch.setattr(Runner, "advance", give_up)
    engine = Running({})
    with pytest.raises(RuntimeError, match="no solution after 1 step"):
        searched(engine, 0.1)
    assert engine.made[0].closed == 1
