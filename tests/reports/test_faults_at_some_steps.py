"""Faults that act at one listed step only, or that accumulate with each step, in runs by default."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bodycheck
from bodycheck.adapters.contract import Adapter, Method, ReadBack, Reading, Stepping
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import registered
from bodycheck.reference_impl.rotations import exp_matrix
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.wrench import Wrench
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.summary.cells import Cell, overviews, summary_cells
from tests.helpers.planted_faults import FaultySimulation, Model

RK4 = replace(Reference().methods["rk4"], continuous_loads="zero-order hold", changed_defaults=())


class AtSomeSteps:
    """An engine that damps the spin, each method at other steps."""

    name = "at-some-steps"
    version = "1"
    damped: Mapping[str, tuple[float, float]] = {
        "sound": (0.0, 0.0),
        "one": (4e-3, 7e-3),
        "coarsest": (0.015, 1.0),
    }
    others = ("reversed-torque", "long-calls")
    methods: Mapping[str, Method] = {name: replace(RK4, name=name) for name in (*damped, *others)}

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract
        """Refuse what the base does not support."""
        return "no continuous loads" if scene.continuous_loads else None

    def build(self, scene: Scene, method: str, dt_s: float) -> FaultySimulation:
        """Return a simulation that is damped at some steps."""
        model = Model.of(scene)
        low, high = self.damped.get(method, (0.0, 0.0))
        if low < dt_s < high:
            model.angular_damping = 0.03
        if method == "reversed-torque":
            model.wrench = lambda wrench, _: replace(
                wrench, torque_body=wrench.torque_body * np.array([-1.0, 1.0, 1.0])
            )
        made = WrongInLongCalls if method == "long-calls" else FaultySimulation
        return made(model, 4, dt_s)


class NoGyroscopicTerm(AtSomeSteps):
    """An engine without the term omega x I omega."""

    name = "no-gyroscopic-term"
    methods: Mapping[str, Method] = {"rk4": RK4}

    def build(self, scene: Scene, method: str, dt_s: float) -> FaultySimulation:  # noqa: ARG002
        """Return a simulation without it."""
        return FaultySimulation(replace(Model.of(scene), gyro=0.0), 4, dt_s)


class WrongInLongCalls(FaultySimulation):
    """Loses a ten-thousandth of omega in each call of more than 60 steps."""

    def advance(self, steps: int) -> None:
        """Make the steps."""
        super().advance(steps)
        if steps > 60:
            self._state[6:9] *= 1.0 - 1e-4


class Unknown(AtSomeSteps):
    """An engine with a term that no known fault has: -2 W x v in v', or -c |omega|^2 omega in omega'."""

    name = "unknown-terms"
    methods: Mapping[str, Method] = {name: replace(RK4, name=name) for name in ("coriolis", "cubic-damping")}

    def build(self, scene: Scene, method: str, dt_s: float) -> FaultySimulation:
        """Return a simulation with the term."""
        return UnknownTerm(scene, method, dt_s)


class UnknownTerm(FaultySimulation):
    """Makes half of the term before each step, and half after it."""

    def __init__(self, scene: Scene, term: str, dt_s: float) -> None:
        self._term = term
        self._turn = exp_matrix(-dt_s * np.array([7e-4, -9e-4, 1.1e-3]))  # by 2 W, half a step
        super().__init__(Model.of(scene), 4, dt_s)

    def _half(self) -> None:
        if self._term == "coriolis":
            self._state[3:6] = self._turn @ self._state[3:6]
        else:
            omega = self._state[6:9]
            omega /= np.sqrt(1.0 + 8e-4 * self._dt_s * (omega @ omega))

    def advance(self, steps: int) -> None:
        """Make the steps."""
        for _ in range(steps):
            self._half()
            super().advance(1)
            self._half()


SINE = """kind = "sine-torque"
axes = "body"
amplitude_n_m = [0.0, 0.0, 0.7]
rate_rad_s = 2.9
phase_rad = 0.3
"""
SPIN = """
name = "spin-up"
duration_s = 4.0
samples = 41
[body]
mass_kg = 1.0
inertia_kg_m2 = [1.0, 1.5, 2.0]
[[forcing]]
"""


class Planar:
    """An engine for rotation about z under a sine torque, of order 4, whose clock adds up its steps."""

    name = "planar"
    version = "1"
    clocks: Mapping[str, type[np.floating]] = {"float64-clock": np.float64, "float32-clock": np.float32}
    methods: Mapping[str, Method] = {name: replace(RK4, name=name) for name in clocks}

    def unsupported(self, scene: Scene, method: str) -> str | None:  # noqa: ARG002 - the contract
        """Refuse every scene but one rotation about z, as the probes set others."""
        spin = scene.initial.omega_body
        if len(scene.loads) != 1 or spin.any() or scene.gravity.any() or scene.initial.velocity.any():
            return "only the rotation about z under a sine torque"
        return None

    def build(self, scene: Scene, method: str, dt_s: float) -> PlanarSimulation:
        """Return a simulation with the clock of the method."""
        return PlanarSimulation(scene, dt_s, self.clocks[method])


class PlanarSimulation:
    """omega+ = omega + h / 6 (a0 + 4 a1 + a2), angle+ = angle + h omega + h^2 / 6 (a0 + 2 a1)."""

    stepping: Stepping = "native"

    def __init__(self, scene: Scene, dt_s: float, clock: type[np.floating]) -> None:
        self._scene, self._dt_s, self._clock = scene, dt_s, clock
        self.reset()

    def reset(self) -> None:
        """Return to the start."""
        self._angle = self._omega = 0.0
        self._t = self._clock(0.0)

    def apply(self, wrench: Wrench) -> None:
        """Ignore constant loads: there are none."""

    def advance(self, steps: int) -> None:
        """Make the steps at the times of the clock."""
        h = self._dt_s
        clock = np.cumsum(np.concatenate([[self._t], np.full(steps, self._clock(h))]), dtype=self._clock)
        t, self._t = clock[:-1].astype(np.float64), clock[-1]
        a0, a1, a2 = (0.35 * np.sin(2.9 * (t + lag) + 0.3) for lag in (0.0, 0.5 * h, h))
        omega = self._omega + np.cumsum(np.concatenate([[0.0], h / 6.0 * (a0 + 4.0 * a1 + a2)]))
        self._angle += float(np.sum(h * omega[:-1] + h * h / 6.0 * (a0 + 2.0 * a1)))
        self._omega = float(omega[-1])

    def read(self) -> Reading:
        """Return the state."""
        start = self._scene.initial
        turned = np.array([np.cos(0.5 * self._angle), 0.0, 0.0, np.sin(0.5 * self._angle)])
        spin = np.array([0.0, 0.0, self._omega])
        return Reading(start.position, start.velocity, quaternion=turned, omega_body=spin)

    def read_back(self) -> ReadBack:
        """Return the numbers of the scene."""
        body = self._scene.body
        return ReadBack(body.mass, body.inertia, self._dt_s, self._scene.gravity, self.read())

    def close(self) -> None:
        """Nothing to free."""


def run_of(adapter: Adapter, scenario: str) -> tuple[Run, Callable[[str], Cell]]:
    """Return the run of all methods of an adapter on a scenario, and a function that gives their cells."""
    with registered(adapter):
        run = bodycheck.run([scenario], engines=[adapter.name], speed=False, laws=False)
    (cells,) = summary_cells(run).values()
    return run, lambda method: cells[adapter.name, method]


@pytest.fixture(scope="module")
def two_flights() -> Run:
    """Return the run of AtSomeSteps on a free flight and a powered one."""
    adapter = AtSomeSteps()
    with registered(adapter):
        return bodycheck.run(
            ["free-flight", "powered-flight"], engines=[adapter.name], speed=False, laws=False
        )


@pytest.mark.nightly
def test_fault_at_one_listed_step_is_a_finding_of_that_case(two_flights: Run) -> None:
    """Verdict, error, step and command are those of the wrong case; above the usable step is no finding."""
    run = two_flights
    cells = summary_cells(run)["powered-flight"]

    def cell(method: str) -> Cell:
        return cells[AtSomeSteps.name, method]

    (wrong,) = (one for one in cell("one").wrong if one.quantity == ORIENTATION)
    (error,) = run.results.query("scenario == 'powered-flight' and method == 'one' and dt_s == 5e-3")[
        ORIENTATION
    ]
    assert (wrong.state, wrong.fineness) == ("does-not-converge", 5e-3)
    assert wrong.size == error
    assert wrong.ratio is not None
    assert wrong.ratio > 1e5
    assert (cell("one").largest, cell("one").largest_at) == (wrong.size, "dt 0.005 s")
    for method in ("sound", "coarsest"):
        assert (cell(method).state, cell(method).wrong) == ("converges", ())
        assert cell(method).order == pytest.approx(4.0, abs=0.1)
    rows = run.methods[run.methods["quantity"] == ORIENTATION].set_index(["scenario", "method"])
    assert rows.loc[("powered-flight", "coarsest"), "usable_dt_s"] == 0.01
    assert cell("coarsest").largest_at == "dt 0.02 s"
    (overview,) = (one for one in overviews(summary_cells(run)) if one.method == "at-some-steps:one")
    assert overview.largest_error[1].startswith("dt 0.005 s, ")


@pytest.mark.nightly
def test_diagnosis_is_of_the_case_of_the_finding_and_of_the_engine(two_flights: Run) -> None:
    """A fault at one step is named from that step; one that the run refutes is named for its scene only.

    Beside a finding there is never "no fault", although the single steps of most cases are right.
    """
    found = {(row["method"], row["scenario"]): row for row in two_flights.diagnoses.to_dict("records")}
    damped = found["one", "powered-flight"]
    assert (damped["dt_s"], damped["verdict"], damped["value"]) == (5e-3, "explained", pytest.approx(0.03))
    reversed_torque = found["reversed-torque", "powered-flight"]
    assert reversed_torque["verdict"] == "this-scene-only"
    assert "free-flight" in reversed_torque["diagnosis"]
    assert found["long-calls", "powered-flight"]["verdict"] != "explained"
    assert not any(row["verdict"] == "healthy" for row in found.values())
    assert {method for method, _ in found} == {"one", "reversed-torque", "long-calls"}


@pytest.mark.nightly
def test_of_equal_diagnoses_those_are_named_that_the_run_does_not_refute(tmp_path: Path) -> None:
    """A missing gyroscopic term and the inertia of a sphere make one free motion, but not one about z."""
    path = tmp_path / "spin.toml"
    path.write_text(SPIN + 'kind = "torque"\naxes = "body"\nvalue_n_m = [0.0, 0.0, 0.7]\n')
    adapter = NoGyroscopicTerm()
    alike = []
    for scenarios in (["free-flight"], ["free-flight", str(path)]):
        with registered(adapter):
            run = bodycheck.run(scenarios, engines=[adapter.name], speed=False, laws=False)
        (found,) = run.diagnoses.to_dict("records")
        assert (found["verdict"], found["faults"]) == ("explained", "gyroscopic-term")
        alike.append(found["alike"])
    assert alike == ["the inertia is that of a sphere: trace(I) / 3 about every axis", ""]


@pytest.mark.nightly
def test_motion_that_no_fault_makes_is_explained_in_no_scene() -> None:
    """Terms that constant faults imitate in one scene are not named for the engine: other scenes differ."""
    adapter = Unknown()
    with registered(adapter):
        run = bodycheck.run(["smoke"], engines=[adapter.name], speed=False, laws=False)
    rows = run.diagnoses.to_dict("records")
    assert len(rows) == len(adapter.methods) * 3
    assert {row["verdict"] for row in rows} == {"unexplained"}
    assert not any("of the error" in row["diagnosis"] for row in rows)


@pytest.mark.nightly
def test_errors_that_a_clock_in_float32_accumulates_are_a_finding(tmp_path: Path) -> None:
    """The error grows at every finer step, although no probe or law contains the load."""
    path = tmp_path / "spin.toml"
    path.write_text(SPIN + SINE)
    _, cell = run_of(Planar(), str(path))
    assert cell("float64-clock").is_sound
    grown = [one for one in cell("float32-clock").wrong if one.quantity == ORIENTATION]
    assert [one.state for one in grown] == ["error-grows"]
