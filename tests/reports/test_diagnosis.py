"""The diagnosis names the fault behind a wrong motion, its parameter, and faults that fit equally well."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import bodycheck
from bodycheck.adapters.contract import Setting, Simulation
from bodycheck.adapters.execution import Case, record
from bodycheck.adapters.pybullet import PyBullet
from bodycheck.adapters.reference import Reference
from bodycheck.adapters.registry import registered
from bodycheck.examine.diagnosis.candidate_maps import BASES
from bodycheck.examine.diagnosis.diagnosis import Diagnosis, _percent, bases_for, diagnosed
from bodycheck.examine.diagnosis.engine_model import Grid
from bodycheck.examine.diagnosis.faults import FAULTS
from bodycheck.examine.diagnosis.faults.fault import FaultContext
from bodycheck.examine.diagnosis.fit import planted
from bodycheck.examine.diagnosis.transitions import Transitions
from bodycheck.examine.explanation.explain import ExplainedCase, explain_run
from bodycheck.examine.explanation.explanation_document import (
    explanation_document,
    similar_issues,
    upstream_issues,
)
from bodycheck.reference_impl.arrays import Array
from bodycheck.reference_impl.dynamics import angular_acceleration
from bodycheck.reference_impl.rotations import exp_quaternion, normalised, quaternion_product
from bodycheck.reference_impl.scene import Scene
from bodycheck.reference_impl.trajectory import Trajectory
from bodycheck.reference_impl.wrench import steps_per_sample
from bodycheck.reports.document import Document, Sentence, Table
from bodycheck.reports.document import markdown as as_markdown
from bodycheck.reports.measurement.case import CaseResult, MeasuredMotion
from bodycheck.reports.measurement.problem import Problem
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.table_layout import Span
from bodycheck.runs.directory import write_run
from bodycheck.scenarios.library import load_scenario
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.in_process_cli import run_bodycheck
from tests.helpers.planted_faults import FAULTS as PLANTED
from tests.helpers.planted_faults import Faulty
from tests.helpers.planted_maps import FaultyMap
from tests.helpers.scenario_texts import tumbling

STEPS = {"full-tensor": 1e-2, "powered-flight": 2e-2, "body-torque": 0.1, "fast-flight": 2e-4}
KNOWN = frozenset({"position", "velocity", "attitude", "omega"})


@cache
def problem_of(scenario: str) -> Problem:
    """Return a scenario with its truth."""
    return Problem.of(load_scenario(scenario), scenario)


def motion_of(scenario: str, base: str, faults: Sequence[str] = ()) -> Trajectory:
    """Return the motion of a map with planted faults."""
    engine = FaultyMap(base, [fault for fault in PLANTED if fault.name in faults])
    scene = problem_of(scenario).scenario.scene
    found = record(engine, Case(scene, "planted", Setting(dt_s=STEPS[scenario]))).trajectory
    assert found is not None
    return found


def diagnosis_of(
    scenario: str, motion: Trajectory, order: int, known_faults: Sequence[tuple[str, ...]] = ()
) -> Diagnosis:
    """Return the diagnosis of a motion; known_faults: those of other motions of the method."""
    problem = problem_of(scenario)
    scene, dt_s = problem.scenario.scene, STEPS[scenario]
    found = diagnosed(scene, motion, problem.scales, dt_s, order=order, known_faults=known_faults)
    assert found is not None
    return found


@pytest.mark.slow
@pytest.mark.parametrize("base", ["m1", "m2", "rk4"])
@pytest.mark.parametrize("scenario", ["full-tensor", "powered-flight"])
def test_the_motion_of_a_healthy_map_is_no_fault(base: str, scenario: str) -> None:
    """The diagnosis is `healthy` and names the map."""
    found = diagnosis_of(scenario, motion_of(scenario, base), 4 if base == "rk4" else 1)
    assert (found.verdict, found.base, found.faults) == ("healthy", base, ())


def tints(document: Document) -> dict[str, str]:
    """Return the tint of the first line of a document, and of each tinted cell, by its text."""
    first = document.parts[0]
    assert isinstance(first, Sentence)
    rows = [row for part in document.parts if isinstance(part, Table) for row in part.rows]
    cells = (cell for row in rows for cell in row)
    return {first.text: first.tint} | {cell.text: cell.tint for cell in cells if isinstance(cell, Span)}


class Mislabelled:
    """The reference's midpoint method, whose facts state order 4."""

    name, version = "mislabelled", "1"

    def __init__(self) -> None:
        self.methods = {"midpoint": replace(Reference().methods["midpoint"], order=4)}

    def unsupported(self, scene: Scene, method: str) -> str | None:
        """Return what the reference returns."""
        return Reference().unsupported(scene, method)

    def build(self, scene: Scene, method: str, dt_s: float) -> Simulation:
        """Return the simulation of the reference."""
        return Reference().build(scene, method, dt_s)


def test_the_motion_of_a_map_of_a_lower_order_is_not_that_of_the_method(
    expected_message: ExpectedMessage,
) -> None:
    """The midpoint rule is the cause where the method is of order 4, and no fault where it is of order 2."""
    scene = problem_of("full-tensor").scenario.scene
    motion = record(Reference(), Case(scene, "midpoint", Setting(dt_s=STEPS["full-tensor"]))).trajectory
    assert motion is not None
    found = diagnosis_of("full-tensor", motion, 4)
    assert (found.verdict, found.base, found.faults) == ("lower-order", "midpoint", ())
    expected_message(found.sentence)
    assert diagnosis_of("full-tensor", motion, 2).verdict == "healthy"


def test_a_map_of_a_lower_order_is_not_blamed_where_maps_agree(tmp_path: Path) -> None:
    """The midpoint rule and Runge-Kutta 4 move a body alike that hardly rotates."""
    (tmp_path / "slow.toml").write_text(tumbling("slow", omega_body_rad_s=(3e-6, 1e-6, 2e-6)))
    problem = Problem.of(load_scenario(tmp_path / "slow.toml"), "slow")
    scene = problem.scenario.scene
    motion = record(Reference(), Case(scene, "midpoint", Setting(dt_s=0.01))).trajectory
    assert motion is not None
    found = diagnosed(scene, motion, problem.scales, 0.01, order=4)
    assert found is not None
    assert (found.verdict, found.base) == ("healthy", "rk4")


@pytest.mark.nightly
def test_a_mislabelled_method_is_not_shown_as_good(tmp_path: Path) -> None:
    """The explanation of the case has the tint of a cause."""
    with registered(Mislabelled()):
        run = bodycheck.run(["full-tensor"], engines=["mislabelled"], dt_s=[1e-2], speed=False)
    write_run(run, tmp_path / "run")
    shown = tints(explanation_document(explain_run(tmp_path / "run", "full-tensor")))
    assert [tint for text, tint in shown.items() if "order 2" in text] == ["bad"]


TRUE_MOTIONS = ("symmetric-top", "powered-flight")
NIGHTLY_TRUE_MOTIONS = ("intermediate-axis", "thruster", "torsion-spring", "world-torque", "free-flight")


@pytest.mark.parametrize(
    "scenario",
    [*TRUE_MOTIONS, *(pytest.param(name, marks=pytest.mark.nightly) for name in NIGHTLY_TRUE_MOTIONS)],
)
def test_the_true_motion_is_no_fault(scenario: str) -> None:
    """Without a step, the truth at the samples is the motion of the exact flow."""
    problem = problem_of(scenario)
    found = diagnosed(problem.scenario.scene, problem.truth.trajectory, problem.scales, None)
    assert found is not None
    assert (found.verdict, found.base, found.faults) == ("healthy", "exact", ())


@pytest.mark.nightly
def test_a_body_that_never_moves_is_diagnosed(tmp_path: Path) -> None:
    """No change is small relative to values that are all 0."""
    (tmp_path / "forced.toml").write_text(
        tumbling("forced")
        + '[[forcing]]\nkind = "torque"\naxes = "body"\nvalue_n_m = [0.3, 0.0, 0.0]\n'
        + '[[forcing]]\nkind = "gravity"\nacceleration_m_s2 = [0.0, 0.0, -9.81]\n'
    )
    problem = Problem.of(load_scenario(tmp_path / "forced.toml"), "forced")
    t_s = problem.scenario.scene.sample_times
    still, attitude = np.zeros((len(t_s), 3)), np.tile([1.0, 0.0, 0.0, 0.0], (len(t_s), 1))
    motion = Trajectory(
        t_s=t_s, position_m=still, velocity_m_s=still, quaternion=attitude, omega_body_rad_s=still
    )
    found = diagnosed(problem.scenario.scene, motion, problem.scales, 0.01)
    assert found is not None
    assert found.verdict != "healthy"


@pytest.mark.slow
def test_a_step_too_short_to_be_examined_costs_nothing() -> None:
    """The grid of a step of 0.1 ns would take more memory than there is."""
    problem = problem_of("full-tensor")
    found = diagnosed(problem.scenario.scene, motion_of("full-tensor", "rk4"), problem.scales, 1e-10, order=4)
    assert found is None or found.base == "exact"


@pytest.mark.slow
@pytest.mark.nightly(after=1)
@pytest.mark.parametrize(
    ("scenario", "base", "fault", "name", "value"),
    [
        ("full-tensor", "m1", "damping-angular-1e-3", "damping-angular", 1e-3),
        ("full-tensor", "m2", "no-gyroscopic-term", "gyroscopic-term", 0.0),
        ("full-tensor", "rk4", "off-diagonals-reversed", "off-diagonals", -1.0),
        ("full-tensor", "m1", "state-late", "state-late", 1.0),
        ("full-tensor", "m2", "quaternion-conjugated", "quaternion-conjugated", None),
        ("body-torque", "m1", "torque-1-percent", "torque", 1.01),
        ("body-torque", "rk4", "step-1-percent", "step-scaled", 1.01),
        ("powered-flight", "m1", "gravity-reversed", "gravity", -1.0),
        ("fast-flight", "m2", "omega-clamped-at-175", "omega-clamped-body-after", 175.0),
        ("full-tensor", "m2", "omega-turned-when-read", "omega-axes-x-y-z", None),
    ],
)
def test_a_planted_fault_is_named_with_its_parameter(
    scenario: str, base: str, fault: str, name: str, value: float | None
) -> None:
    """The fault, with its value, is first or among those that the scene cannot distinguish from it."""
    found = diagnosis_of(scenario, motion_of(scenario, base, [fault]), 4 if base == "rk4" else 1)
    assert found.verdict == "explained"
    assert found.base == base or fault == "no-gyroscopic-term"  # without the term, M1 and M2 are equal
    assert (name,) in ((found.faults[0].name,), *found.alike_names)
    if value is not None and found.faults[0].name == name:
        fitted = found.faults[0].parameters[0]
        assert math.isclose(fitted.value, value, rel_tol=1e-6, abs_tol=1e-9)
        assert fitted.low <= fitted.value <= fitted.high
    assert found.share > 0.999


@pytest.mark.nightly
def test_a_fault_that_leaves_more_than_another_map_would_is_the_nearest_one() -> None:
    """Something unknown acts besides the missing term: what is left is far above round-off."""
    motion = motion_of("full-tensor", "rk4", ["no-gyroscopic-term"])
    noise = np.random.default_rng(25).normal(size=motion.omega_body.shape)
    noisy = replace(motion, omega_body_rad_s=motion.omega_body + 1e-3 * noise)
    found = diagnosis_of("full-tensor", noisy, 4)
    assert (found.verdict, found.faults[0].name) == ("nearest", "gyroscopic-term")
    assert found.sentence.startswith(
        "nearest known fault: the gyroscopic term omega x I omega is missing; or"
    )
    assert not found.without_faults.sentence.startswith("nearest")


@pytest.mark.nightly
def test_a_fault_of_an_unknown_map_is_stated_as_it_is() -> None:
    """What is left is no more than one map of order 1 differs from another."""
    scene = problem_of("full-tensor").scenario.scene
    initial, inertia, dt_s = scene.initial, scene.body.inertia, STEPS["full-tensor"]
    rows = [(normalised(initial.quaternion), initial.omega_body)]

    def rate(omega: Array) -> Array:
        return angular_acceleration(inertia, omega, np.zeros(3)) - 0.5 * omega

    for _ in range(steps_per_sample(scene.duration_s, dt_s)):
        q, omega = rows[-1]
        omega = omega + dt_s * (0.7 * rate(omega) + 0.3 * rate(omega + dt_s * rate(omega)))
        rows.append((quaternion_product(q, exp_quaternion(dt_s * omega)), omega))
    stride = steps_per_sample(scene.sample_interval_s, dt_s)
    attitude, omegas = (np.array(part)[::stride] for part in zip(*rows, strict=True))
    still = motion_of("full-tensor", "m1")
    found = diagnosis_of("full-tensor", replace(still, quaternion=attitude, omega_body_rad_s=omegas), 1)
    assert "damping-angular" in {found.faults[0].name, *(name for (name,) in found.alike_names)}
    assert found.verdict == "explained"
    assert found.share < 0.995


@pytest.mark.slow
def test_faults_that_a_scene_cannot_tell_apart_are_one_class() -> None:
    """Without a torque, a missing gyroscopic term and a sphere both keep omega; with one they differ."""
    free = diagnosis_of("full-tensor", motion_of("full-tensor", "m1", ["no-gyroscopic-term"]), 1)
    assert {"gyroscopic-term", "inertia-sphere"} <= {free.faults[0].name, *(n for (n,) in free.alike_names)}
    assert all(f"; or {other}" in free.sentence for other in free.alike)
    forced = diagnosis_of("body-torque", motion_of("body-torque", "m1", ["no-gyroscopic-term"]), 1)
    assert (forced.faults[0].name, forced.alike_names) == ("gyroscopic-term", ())
    assert "; or " not in forced.sentence


@pytest.mark.slow
def test_pybullet_untouched_is_damped_and_clamped() -> None:
    """With its defaults, PyBullet damps velocity and omega by 0.04 and clamps each component at 100."""
    scene = problem_of("fast-flight").scenario.scene
    motion = record(PyBullet(), Case(scene, "multibody@defaults", Setting(dt_s=2e-4))).trajectory
    assert motion is not None
    found = diagnosis_of("fast-flight", motion, 1)
    fitted = {fault.name: fault.parameters[0].value for fault in found.faults}
    assert fitted == pytest.approx({"velocities-clamped": 100.0, "damping-bullet": 0.04}, rel=1e-6)


@pytest.mark.parametrize(("order", "name"), [(4, "rk4"), (2, "midpoint")])
def test_maps_of_the_order_of_the_method_come_first(order: int, name: str) -> None:
    """Among maps that explain a motion about equally well the first is taken, so these are tried first."""
    assert bases_for(order)[0].name == name
    assert {base.name for base in bases_for(order)} == {"midpoint", "rk4", "exact"}


@pytest.mark.slow
def test_of_two_known_faults_only_those_with_an_effect_are_named() -> None:
    """A limit that another motion of the method reaches, and this one does not, is not named here."""
    motion = motion_of("full-tensor", "m1", ["damping-angular-1e-3"])
    found = diagnosis_of("full-tensor", motion, 1, [("velocities-clamped", "damping-angular")])
    assert [fault.name for fault in found.faults] == ["damping-angular"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "base", "planted_names", "names"),
    [
        pytest.param(
            *("powered-flight", "m1", ("moment-1-percent", "moment-1e-4")),
            {"largest-moment", "smallest-moment"},
            marks=pytest.mark.nightly,
        ),
        (
            "fast-flight",
            "m2",
            ("damping-quadratic", "gravity-axes"),
            {"damping-quadratic-linear", "gravity-axes-xzy"},
        ),
    ],
)
def test_two_specific_faults_are_named_rather_than_a_general_one(
    scenario: str, base: str, planted_names: tuple[str, str], names: set[str]
) -> None:
    """A general inertia tensor and gravity vector could explain both, but with more parameters."""
    found = diagnosis_of(scenario, motion_of(scenario, base, planted_names), 1)
    assert names in [{fault.name for fault in found.faults}, *map(set, found.alike_names)]
    assert not {"inertia-tensor", "gravity-vector"} & {fault.name for fault in found.faults}
    assert found.share > 0.9999


@pytest.mark.nightly
def test_each_pair_that_makes_the_same_motion_is_named_once() -> None:
    """Each of the two faults has an equivalent one here: four pairs, whatever the order within a pair."""
    motion = motion_of("body-torque", "m1", ["torque-frozen", "first-step-free"])
    found = diagnosis_of("body-torque", motion, 1)
    pairs = [frozenset(fault.name for fault in found.faults), *map(frozenset, found.alike_names)]
    assert len(pairs) == len(set(pairs))
    assert set(pairs) == {
        frozenset((torque, start))
        for torque in ("torque-frozen", "torque-body-as-world")
        for start in ("first-step-free", "load-late-1")
    }


@pytest.mark.nightly
def test_an_unknown_fault_is_unexplained() -> None:
    """No fault explains a motion whose omega contains noise."""
    motion = motion_of("full-tensor", "m1")
    noise = np.random.default_rng(25).normal(size=motion.omega_body.shape)
    found = diagnosis_of("full-tensor", replace(motion, omega_body_rad_s=motion.omega_body + 0.1 * noise), 1)
    assert (found.verdict, found.faults) == ("unexplained", ())


def test_a_motion_without_omega_or_attitude_is_not_examined() -> None:
    """The transitions need a whole rotational state."""
    problem = problem_of("full-tensor")
    motion = motion_of("full-tensor", "m1")
    assert diagnosed(problem.scenario.scene, motion, problem.scales, 1e-2, known=frozenset({"omega"})) is None


@pytest.mark.parametrize("scenario", ["full-tensor", "powered-flight"])
def test_faults_with_healthy_parameters_change_nothing(scenario: str) -> None:
    """A fault at its healthy values changes no step; names are unique, and texts contain their numbers."""
    problem = problem_of(scenario)
    scene = problem.scenario.scene
    grid = Grid.of(scene, STEPS[scenario])
    transitions = Transitions.of(scene, motion_of(scenario, "m1"), grid, problem.scales, KNOWN).subset(4)
    at, healthy = FaultContext(transitions, BASES["m1"]), grid.model(scene)
    assert len({fault.name for fault in FAULTS}) == len(FAULTS)
    models = []
    for fault in FAULTS:
        values = np.array([parameter.healthy for parameter in fault.parameters])
        assert fault.text(np.full(len(values), 0.37))
        if fault.parameters and np.all(np.isfinite(values)) and fault.applies(at) and fault.kind != "limit":
            models.append(planted(at, healthy, [fault], values))
    gaps = transitions.differences(models, BASES["m1"])
    assert len(models) > 20
    assert np.max(np.abs(gaps)) < 100.0 * transitions.round_off


def test_advice_about_the_gyroscopic_term_fits_every_factor(expected_message: ExpectedMessage) -> None:
    """With a factor of -1 or 0.97 omega changes, too: its rate and its sign tell them apart."""
    (fault,) = (one for one in FAULTS if one.name == "gyroscopic-term")
    expected_message(fault.confirm)


def test_each_upstream_issue_is_of_the_kind_of_a_fault() -> None:
    """Each pattern matches the name of a fault, and each address is that of an issue or a pull request."""
    names = [fault.name for fault in FAULTS]
    for issue in upstream_issues():
        assert issue.url.startswith("https://github.com/")
        assert "/issues/" in issue.url or "/pull/" in issue.url
        assert all(any(fnmatchcase(name, pattern) for name in names) for pattern in issue.faults), issue
    assert [issue.url for issue in similar_issues(["energy-pulled"])] == [
        "https://github.com/avianphysics/avian/pull/993"
    ]


@pytest.fixture(scope="module")
def run() -> Run:
    """Return a run of a healthy method and of one without gyroscopic term."""
    engine = Faulty("m1")
    engine.methods = {name: engine.methods[name] for name in ("sound", "no-gyroscopic-term")}
    with registered(engine):
        return bodycheck.run(["full-tensor"], engines=[engine.name], speed=False)


@pytest.mark.slow
def test_a_run_diagnoses_wrong_methods_only(
    run: Run, tmp_path: Path, expected_message: ExpectedMessage
) -> None:
    """diagnoses.csv has one row, which is read back; the report and the command name the cause."""
    assert list(run.diagnoses["method"]) == ["no-gyroscopic-term"]
    assert list(run.diagnoses["faults"]) == ["gyroscopic-term"]
    sentence = "gyroscopic term omega x I omega is missing"
    report = write_run(run, tmp_path / "run")
    assert sentence in report.read_text(encoding="utf-8")
    assert list(read_tables(tmp_path / "run").diagnoses["diagnosis"]) == list(run.diagnoses["diagnosis"])
    files = ("--html", "why.html", "--markdown", "why.md", "--svg", "why.svg", "--pdf", "why.pdf")
    done = run_bodycheck(tmp_path, "explain", "run", *files)
    assert (done.returncode, done.stdout.startswith(f"The {sentence}")) == (0, True)
    assert all(sentence in (tmp_path / name).read_text() for name in ("why.html", "why.md"))
    assert (tmp_path / "why.svg").read_text().startswith("<?xml")
    assert (tmp_path / "why.pdf").read_bytes().startswith(b"%PDF")
    named = run_bodycheck(tmp_path, "explain", "run", "--case", "full-tensor,faulty-m1:sound", "--json")
    assert '"verdict": "healthy"' in named.stdout
    for words in (("--case", "nothing"), ("--case", "a,b,c"), ("--svg", "no/why.svg")):
        refused = run_bodycheck(tmp_path, "explain", "run", *words)
        assert (refused.returncode, refused.stdout) == (2, "")
        expected_message(refused.stderr.strip())


@pytest.mark.nightly
@pytest.mark.parametrize("fault", ["no-gyroscopic-term", "inertia-sphere"])
def test_a_scenario_that_separates_faults_decides_for_all_scenarios(fault: str) -> None:
    """The first scenario has no torque, so a sphere moves like a body without gyroscopic term."""
    engine = Faulty("m1")
    engine.methods = {fault: engine.methods[fault]}
    with registered(engine):
        found = bodycheck.run(["full-tensor", "body-torque"], engines=[engine.name], speed=False)
    name = fault.removeprefix("no-")
    assert list(found.diagnoses["scenario"]) == ["full-tensor", "body-torque"]
    assert list(found.diagnoses["faults"]) == [name, name]
    assert not any("; or " in sentence for sentence in found.diagnoses["diagnosis"])


@pytest.mark.parametrize(
    ("factor", "text"), [(1.0, "1"), (1.01, "1.01"), (1.0 + 1e-6, "1 + 1e-06"), (1.0 - 2.5e-7, "1 - 2.5e-07")]
)
def test_a_factor_near_one_is_written_as_a_difference(factor: float, text: str) -> None:
    """Five digits would show a factor of 1."""
    (fault,) = (fault for fault in FAULTS if fault.name == "torque")
    assert fault.text([factor]).endswith(f"multiplied by {text}")


@pytest.mark.slow
def test_methods_that_broke_down_are_listed_without_a_diagnosis(tmp_path: Path) -> None:
    """Explicit Euler diverges at 20 rad per step; nothing can be compared, but it is not healthy."""
    scenario = tmp_path / "fast.toml"
    scenario.write_text(tumbling("fast", omega_body_rad_s=(300.0, 400.0, 500.0)))
    run = bodycheck.run([scenario], engines=["reference:euler"], dt_s=[0.05], speed=False)
    assert {*run.results["outcome"]} == {"unstable"}
    write_run(run, tmp_path / "run")
    cases = explain_run(tmp_path / "run", None)
    assert [(one.case.columns["outcome"], one.diagnosis) for one in cases] == [("unstable", None)]
    assert "unstable: " in as_markdown(explanation_document(cases))


@pytest.mark.nightly
def test_a_run_in_which_nothing_was_measured_is_not_healthy(tmp_path: Path) -> None:
    """Each unsupported method is listed, with the reason, and nothing has the tint of a good result."""
    engine = FaultyMap("m1", [])
    with registered(engine):
        run = bodycheck.run(["heavy-top"], engines=[engine.name], dt_s=[0.01], speed=False)
    assert {*run.results["outcome"]} == {"unsupported"}
    write_run(run, tmp_path / "run")
    cases = explain_run(tmp_path / "run", None)
    assert [(one.case.columns["outcome"], one.diagnosis) for one in cases] == [("unsupported", None)]
    named = explain_run(tmp_path / "run", f"heavy-top,{engine.name}")
    assert [one.case.columns["outcome"] for one in named] == ["unsupported"]
    assert tints(explanation_document(cases)) == {
        "unsupported: no continuous loads": "open",
        "Not examined: nothing was measured": "open",
    }
    (one,) = cases
    unexplained = replace(one, diagnosis=Diagnosis("unexplained", "M1", ""))
    known = replace(one, diagnosis=Diagnosis("lower-order", "M1", "M1", order=4))
    title = "The method is of order 1, not 4: the motion is that of M1"
    assert explanation_document([unexplained, known, known]).title == f"{title} (2 cases; 1 case unexplained)"
    assert explanation_document([unexplained, one, known]).title.startswith(
        "2 causes in 2 cases, the first: "
    )


@pytest.mark.nightly
def test_judge_explains_a_trajectory_of_any_program(tmp_path: Path) -> None:
    """With the program's step the fault is named to round-off; without it, relative to the exact flow."""
    motion = motion_of("full-tensor", "rk4", ["damping-angular"])
    np.savez(
        tmp_path / "motion.npz",
        t_s=motion.t_s,
        quaternion=motion.attitude,
        omega_body_rad_s=motion.omega_body,
    )
    for words in (("--dt", "0.01"), ()):
        done = run_bodycheck(
            tmp_path, "judge", "motion.npz", "--scenario", "full-tensor", "--explain", *words
        )
        assert done.returncode == 0, done.stderr
        assert "omega is damped at the rate 0.04 1/s" in " ".join(done.stdout.split())


@pytest.mark.parametrize(("share", "text"), [(0.99984, "99.98 %"), (0.99991, "all"), (0.9501, "95.01 %")])
def test_a_share_is_rounded_down(share: float, text: str) -> None:
    """What leaves something is not 100 %."""
    assert _percent(share) == text


@pytest.mark.parametrize(("noise", "label"), [(0.0, "map"), (1e-13, "nearest map")])
def test_a_map_that_leaves_more_than_round_off_is_only_the_nearest(noise: float, label: str) -> None:
    """A method that differs from the map by little, beside its fault, is not stated to be that map."""
    problem, dt_s = problem_of("full-tensor"), STEPS["full-tensor"]
    setting = Case(problem.scenario.scene, "no-gyroscopic-term", Setting(dt_s=dt_s))
    motion = record(Faulty("m1"), setting).trajectory
    assert motion is not None
    assert motion.omega_body_rad_s is not None
    factors = 1.0 + noise * np.sin(np.arange(len(motion.t_s)))
    motion = replace(motion, omega_body_rad_s=motion.omega_body_rad_s * factors[:, None])
    found = diagnosis_of("full-tensor", motion, 1)
    assert [fault.name for fault in found.faults] == ["gyroscopic-term"]
    columns = {"engine": "faulty", "method": "m1", "control": "dt", "dt_s": dt_s, "outcome": "ok"}
    case = CaseResult({"scenario": "full-tensor", **columns}, MeasuredMotion(motion))
    shown = as_markdown(explanation_document([ExplainedCase(problem, ("faulty",), case, (), found)]))
    assert re.findall(r"^\| ((?:nearest )?map) \|", shown, flags=re.MULTILINE) == [label]
