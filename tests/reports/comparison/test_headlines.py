"""The lines of a comparison: one per method and direction, the gravest first."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from markupsafe import escape

from bodycheck.reports.comparison.change import Change, Status
from bodycheck.reports.comparison.compare import Comparison, compare, paired_versions
from bodycheck.reports.comparison.comparison_document import (
    comparison_document,
    comparison_page,
    release_searches,
    sentences,
)
from bodycheck.reports.comparison.environment_diff import is_refinement
from bodycheck.reports.comparison.headlines import factor as factor_text
from bodycheck.reports.comparison.headlines import headlines as texts_of
from bodycheck.reports.comparison.headlines import label, lines_of
from bodycheck.reports.document import escaped_markdown, markdown, print_document
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.run_files.run_tables import Tables
from tests.helpers.gate_tables import make_tables

ERROR = "orientation_error_rad"
ORDER = ("order", "order_low", "order_high")
SCENARIOS = {"brick": {"duration_s": 1.0}, "plate": {"duration_s": 1.0}}


def run(*cases: dict[str, Any], version: str = "3.17.0", engine: str = "mujoco", **parts: Any) -> Tables:
    """Return a run of one engine in one version."""
    named = [{"engine": engine, **cells} for cells in cases]
    methods = [{"engine": engine, **cells} for cells in parts.pop("methods", [])]
    about = {"version": version, "methods": {"rk4": {"order": 4 if version == "4.0.0" else 2}}}
    manifest = {"scenarios": SCENARIOS, "engines": {engine: about}, "created": "today", "bodycheck": "1"}
    return make_tables(named, methods, **{**manifest, **parts})


def headlines(comparison: Comparison) -> list[str]:
    """Return the texts of the lines of a comparison."""
    return texts_of(lines_of(comparison))


def of_order(order: float) -> dict[str, float]:
    """Return an order with its interval."""
    return dict(zip(ORDER, (order, order - 0.01, order + 0.01), strict=True))


OTHERS = ("euler", "implicit", "implicitfast", "discrete")


def release(version: str, error: float, order: float, *, digits: float = 0.0, **names: Any) -> Tables:
    """Return a run of rk4 with an error and an order, and of four methods that hardly differ."""
    others = [{"method": name, "dt_s": 1e-3, ERROR: 1.4e-2 * (1.0 + digits)} for name in OTHERS]
    rk4 = {"dt_s": 1e-3, ERROR: error}
    return run(rk4, *others, version=version, methods=[of_order(order)], **names)


OLD, NEW = release("3.17.0", 4.3e-7, 2.0), release("4.0.0", 2.3e-13, 4.0, digits=5e-12)


def test_another_one_step_map_is_named() -> None:
    """A changed map is reported with the change of the error, and also for a method that only moved."""

    def mapped(tables: Tables, **names: str) -> Tables:
        rows = [{"engine": "mujoco", "method": who, "fingerprint": name} for who, name in names.items()]
        return tables.with_rows(fingerprints=rows)

    before = mapped(OLD, rk4="RK4", euler="M1", implicit="M2")
    after = mapped(NEW, rk4="RK4 Munthe-Kaas", euler="M1", implicit="implicit midpoint")
    since = "in brick (since version 4.0.0, 3.17.0 before)."
    assert headlines(compare(before, after)) == [
        f"mujoco:rk4 improved: order 2 -> 4 in orientation, error at dt 0.001 s x 5.3e-7, "
        f"one-step map RK4 -> RK4 Munthe-Kaas {since}",
        "mujoco:implicit: one-step map linearly implicit Euler (M2) -> implicit midpoint "
        "(since version 4.0.0, 3.17.0 before).",
    ]


@pytest.mark.parametrize(
    ("before", "after", "status"),
    [
        ("holds", "broken", "moved"),
        ("property", "broken", "moved"),
        ("broken", "holds", "moved"),
        ("holds", "property", None),
        ("broken", "broken", None),
        ("not-measured", "broken", None),
        (None, "broken", None),
    ],
)
def test_a_law_that_a_method_begins_to_break_is_named(
    before: str | None, after: str, status: Status | None
) -> None:
    """It is reported even where no error changed; a law measured in one run only is no change."""
    obeyed, obeying = (
        OLD.with_rows(
            laws=[{"engine": "mujoco", "method": "rk4", "law": "boost", "verdict": verdict}]
            if verdict
            else []
        )
        for verdict in (before, after)
    )
    found = compare(obeyed, obeying)
    assert [(one.quantity, one.status) for one in found.changes] == [("law boost", status)] * bool(status)
    if status is not None:
        assert headlines(found) == [f"mujoco:rk4: law boost {before} -> {after}."]
        assert "law boost" in markdown(comparison_document(found))


def test_a_change_of_speed_is_a_factor() -> None:
    """A larger relative time is reported as a factor slower, a smaller one as a factor faster."""
    made = partial(Change, "speed", None, "mujoco", quantity="relative_cpu", before=1.0)
    slower = made(method="rk4", after=2.0, status="worse", decades=math.log10(2.0))
    faster = made(method="euler", after=0.25, status="improved", decades=-math.log10(4.0))
    comparison = replace(compare(OLD, OLD), changes=(slower, faster))
    assert headlines(comparison) == [
        "mujoco:rk4: 2 times slower.",
        "mujoco:euler improved: 4 times faster.",
    ]


@pytest.mark.parametrize(("before", "after", "shown"), [(4.0, 2.0, "4 -> 2"), (2.34, 2.341, "2.34 -> 2.341")])
def test_values_have_as_many_digits_as_distinguish_them(before: float, after: float, shown: str) -> None:
    """Two values are shown with at least two digits, and with more only if those are equal."""
    change = Change("order", "brick", "mujoco", "rk4", f"order of {ERROR}", before, after, "worse")
    (line,) = headlines(replace(compare(OLD, OLD), changes=(change,)))
    assert line == f"mujoco:rk4: order {shown} in orientation in brick."


def test_a_better_release_is_one_sentence() -> None:
    """It has method, order, error with step and factor, scenario and versions; those that moved are one."""
    assert sentences(compare(OLD, NEW))[:3] == [
        "mujoco:rk4 improved: order 2 -> 4 in orientation, error at dt 0.001 s x 5.3e-7 in brick "
        "(since version 4.0.0, 3.17.0 before).",
        "mujoco: euler, implicit, implicitfast and discrete moved in the 12th digit.",
        "Changed values: 2 improved, 4 moved in the 12th digit.",
    ]
    assert not compare(OLD, NEW).failing


def test_the_release_before_is_worse_by_the_same_factor() -> None:
    """In the reverse direction the same change is reported as worse, and the comparison fails."""
    found = compare(NEW, OLD)
    assert headlines(found) == [
        "mujoco:rk4: order 4 -> 2 in orientation, error at dt 0.001 s x 1.9e6 in brick "
        "(since version 3.17.0, 4.0.0 before)."
    ]
    assert {change.method for change in found.failing} == {"rk4"}


def test_two_versions_that_stand_alone_are_compared_under_one_name() -> None:
    """If each run has one version, the two are compared; if a run has both, each is compared with itself."""
    old = release("3.17.0", 4.3e-7, 2.0, engine="mujoco==3.17.0")
    new = release("4.0.0", 2.3e-13, 4.0, digits=5e-12, engine="mujoco==4.0.0")
    assert headlines(compare(old, new)) == headlines(compare(OLD, NEW))
    assert headlines(compare(OLD, new)) == headlines(compare(OLD, NEW))
    assert compare(old, new).environment == ("mujoco: 3.17.0 -> 4.0.0",)
    engines = {name: {"version": name[8:]} for name in ("mujoco==3.17.0", "mujoco==4.0.0")}
    both = replace(old, cases=old.cases + new.cases, manifest={**old.manifest, "engines": engines})
    moved = release("3.17.0", 4.5e-7, 2.0, engine="mujoco==3.17.0")
    assert headlines(compare(old, moved))[0].startswith("mujoco==3.17.0:rk4: ")
    assert compare(both, both).changes == ()
    assert {change.engine for change in compare(both, new).changes} == {"mujoco==3.17.0"}


def test_both_names_of_an_engine_are_replaced_in_every_table() -> None:
    """With one version per run, cases, tables and manifest are renamed; with two in a run, none are."""
    old = release("3.17.0", 4.3e-7, 2.0, engine="mujoco==3.17.0")
    new = release("4.0.0", 2.3e-13, 4.0, engine="mujoco==4.0.0")
    for tables in paired_versions(old, new):
        assert {case.columns["engine"] for case in tables.cases} == {"mujoco"}
        assert set(tables.results["engine"]) == set(tables.methods["engine"]) == {"mujoco"}
        assert list(tables.manifest["engines"]) == ["mujoco"]

    def two(other: str) -> Tables:
        return replace(old, cases=old.cases + release("", 1.0, 2.0, engine=f"mujoco=={other}").cases)

    for tables in paired_versions(two("3.18.0"), two("4.0.0")):
        assert "mujoco" not in {case.columns["engine"] for case in tables.cases}


def test_what_is_worse_leads_and_what_improved_follows() -> None:
    """However small the one and large the other, because only the first fails."""
    before = run({ERROR: 1e-4, "energy_drift": 1e-3, "dt_s": 1e-3})
    after = run({ERROR: 1e-8, "energy_drift": 1.1e-3, "dt_s": 1e-3})
    assert headlines(compare(before, after)) == [
        "mujoco:rk4: energy drift at dt 0.001 s +10 % in brick.",
        "mujoco:rk4 improved: error at dt 0.001 s x 0.0001 in brick.",
    ]
    assert headlines(compare(after, before)) == [
        "mujoco:rk4: error at dt 0.001 s x 1e4 in brick.",
        "mujoco:rk4 improved: energy drift at dt 0.001 s -10 % in brick.",
    ]


@pytest.mark.parametrize(
    ("after", "words"),
    [
        ({"verdict": "does-not-converge"}, "no longer converges"),
        ({"verdict": "unstable"}, "unstable (converges before)"),
    ],
)
def test_improvements_of_a_method_that_no_longer_converges_do_not_count(
    after: dict[str, Any], words: str
) -> None:
    """A broken method often drifts less, which is no progress."""
    sound = {**of_order(2.0), "verdict": "converges"}
    found = compare(
        run({ERROR: 1e-4, "energy_drift": 1e-3}, methods=[sound]),
        run({ERROR: 1e-2, "energy_drift": 1e-4}, methods=[{**sound, **after}]),
    )
    assert headlines(found) == [f"mujoco:rk4: {words}, error at dt 0.01 s x 100 in brick."]
    assert not any("improved" in sentence for sentence in sentences(found))


def test_a_method_that_converges_again_is_said_to_do_so_now() -> None:
    """The verdict before is beside it."""
    sound = {**of_order(2.0), "verdict": "converges"}
    found = compare(
        run({ERROR: 1e-2}, methods=[{**sound, "verdict": "unstable"}]), run({ERROR: 1e-4}, methods=[sound])
    )
    assert sentences(found)[0].startswith("mujoco:rk4 improved: now converges (unstable before)")


@pytest.mark.parametrize(("factor", "named"), [(5.0, False), (1e3, True)])
def test_a_measure_that_is_far_worse_than_the_orientation_is_named(factor: float, named: bool) -> None:
    """A measure that is more than a decade worse is named; the orientation comes first in any case."""
    before = run({ERROR: 1e-4, "energy_drift": 1e-6})
    after = run({ERROR: 2e-4, "energy_drift": 2e-6 * factor})
    (line,) = headlines(compare(before, after))
    assert line.startswith("mujoco:rk4: error at dt 0.01 s x 2")
    assert ("energy drift at dt 0.01 s x 2e3" in line) == named


def test_a_measure_that_is_a_decade_worse_than_the_orientation_is_not_named() -> None:
    """It must be worse by more."""
    found = compare(run({ERROR: 1e-4, "energy_drift": 1e-6}), run({ERROR: 2e-4, "energy_drift": 1e-4}))
    sizes = {ERROR: 0.25, "energy_drift": 1.25}
    changes = tuple(replace(change, decades=sizes[change.quantity]) for change in found.changes)
    (line,) = headlines(replace(found, changes=changes))
    assert "energy drift" not in line


def test_a_method_has_one_line_however_many_of_its_digits_moved() -> None:
    """Changes of last digits in both directions are counted once, and make no method worse or improved."""
    before = run({ERROR: 1e-2}, {"dt_s": 0.02, ERROR: 1e-2}, {"method": "euler", ERROR: 1e-2})
    after = run({ERROR: 1e-2 + 3e-13}, {"dt_s": 0.02, ERROR: 1e-2 - 3e-13}, {"method": "euler", ERROR: 2e-2})
    assert sentences(compare(before, after))[:3] == [
        "mujoco:euler: error at dt 0.01 s x 2 in brick.",
        "mujoco:rk4 moved in the 11th digit.",
        "Changed values: 1 worse, 2 moved in the 11th digit.",
    ]


def test_lines_are_sorted_by_what_fails_and_by_factor() -> None:
    """Missing methods come first, then worse ones by factor, then improved ones; the rest is counted."""
    factors = {"a": 1.5, "b": 30.0, "c": 1e-3, "d": 0.5, "e": 1.01}
    before = run(*({"method": name, ERROR: 1e-5} for name in factors), {"method": "gone"})
    after = run(
        *({"method": name, ERROR: 1e-5 * factor} for name, factor in factors.items()), {"method": "came"}
    )
    found = compare(before, after)
    assert [(one.methods, one.direction) for one in lines_of(found)] == [
        (("gone",), "worse"),
        (("b",), "worse"),
        (("a",), "worse"),
        (("c",), "improved"),
        (("d",), "improved"),
    ]
    many = [replace(one, methods=(str(k),)) for one in lines_of(found) for k in range(7)]
    assert [text.count("\n") for text in texts_of(many)] == [0] * 14
    assert texts_of(many)[6::7] == ["15 more methods worse.", "8 more methods improved."]


def diagnosed(error: float, *methods: str, release: str = "3.17.0", **found: str) -> Tables:
    """Return a run of rk4 and euler of which these methods have that row of diagnoses.csv."""
    made = run(*({"method": name, ERROR: error} for name in ("rk4", "euler")), version=release)
    rows = [{"scenario": "brick", "engine": "mujoco", "method": name, **found} for name in methods]
    return made.with_rows(diagnoses=rows)


def test_a_motion_that_no_fault_explains_is_said_to_be_one() -> None:
    """Each method has a line of its own then, because nothing says that they have one cause."""
    found = {"verdict": "unexplained", "diagnosis": "unexplained: no known fault makes this motion"}
    lines = headlines(compare(diagnosed(1e-4), diagnosed(1e-2, "rk4", "euler", **found)))
    assert lines == [
        f"mujoco:{name}: error at dt 0.01 s x 100 in brick (no known fault explains it)."
        for name in ("rk4", "euler")
    ]
    found = {"verdict": "lower-order", "diagnosis": "the method is of order 2, not 4"}
    (line, _) = headlines(compare(diagnosed(1e-4), diagnosed(1e-2, "rk4", **found)))
    assert line.endswith("in brick (the method is of order 2, not 4).")


def test_a_cause_that_is_known_in_another_scenario_is_stated_with_it() -> None:
    """Where the largest error has no known cause, that of a smaller one says more; it is not that of both."""
    cases = [{"method": "rk4", "scenario": name} for name in SCENARIOS]
    before = run(*(case | {ERROR: 1e-4} for case in cases))
    after = run(*(case | {ERROR: error} for case, error in zip(cases, (1e-1, 1e-2), strict=True)))
    found = [("unexplained", {}), ("explained", {"faults": "late"})]
    rows = [
        {"engine": "mujoco", "verdict": verdict, "diagnosis": "omega is late (explains all)"} | case | faults
        for case, (verdict, faults) in zip(cases, found, strict=True)
    ]
    (line,) = headlines(compare(before, after.with_rows(diagnoses=rows)))
    assert line.endswith("in brick and 1 more scenario (omega is late, explains all in plate).")


@pytest.mark.parametrize("version", ["3.17.0", "4.0.0"])
def test_methods_with_one_cause_share_a_line(version: str) -> None:
    """The diagnosis is the cause unless the method had it before; a new version is named too."""
    cause = "the gyroscopic term omega x I omega is multiplied by 0.9 (explains all of the error)"
    gyroscopic = {"verdict": "explained", "diagnosis": cause, "faults": "gyro"}
    since = "" if version == "3.17.0" else "; since version 4.0.0, 3.17.0 before"
    broken = diagnosed(1e-2, "rk4", "euler", release=version, **gyroscopic)
    assert headlines(compare(diagnosed(1e-4), broken)) == [
        "mujoco: rk4 and euler: error at dt 0.01 s x 100 in brick (the gyroscopic term omega x I omega is "
        f"multiplied by 0.9, explains all of the error{since})."
    ]
    known = headlines(compare(diagnosed(1e-4, "rk4", "euler", **gyroscopic), broken))
    assert [line.partition(" (")[0].removesuffix(".") for line in known] == [
        f"mujoco:{name}: error at dt 0.01 s x 100 in brick" for name in ("rk4", "euler")
    ]
    assert not any("gyroscopic" in line for line in known)


@pytest.mark.parametrize(("old", "new"), [("ok", "failed"), ("failed", "ok")])
def test_a_case_that_ends_otherwise_is_named_first(old: str, new: str) -> None:
    """What a method with a failing case measures better elsewhere does not count."""
    improved = new == "ok"
    before = run({"outcome": old}, {"dt_s": 0.02, ERROR: 1e-3})
    after = run({"outcome": new}, {"dt_s": 0.02, ERROR: 1e-3 * (1e-6 if new == "failed" else 1e-3)})
    assert headlines(compare(before, after)) == [
        "mujoco:rk4 improved: ok in 1 case (failed before), error at dt 0.02 s x 0.001 in brick."
        if improved
        else "mujoco:rk4: failed in 1 case (ok before) in brick."
    ]


def test_a_step_that_a_run_chose_itself_is_neither_new_nor_missing() -> None:
    """Refined steps follow the errors and are not compared; a requested step that is absent is missing."""
    requested = {"dt_s": [0.02, 0.01], "tolerances": None}
    few = run({"dt_s": 0.02}, {"dt_s": 0.01}, **requested)
    more = run({"dt_s": 0.02}, {"dt_s": 0.01}, {"dt_s": 0.005}, {"dt_s": 0.05}, **requested)
    for found in (compare(few, more), compare(more, few)):
        assert (found.changes, found.refined) == ((), 2)
    assert (
        "2 not compared, because only one of the runs chose their steps" in sentences(compare(few, more))[-1]
    )
    lost = run({"dt_s": 0.02}, **requested)
    assert [(one.status, one.fineness) for one in compare(few, lost).changes] == [("missing", 0.01)]
    assert [(one.status, one.fineness) for one in compare(lost, few).changes] == [("new", 0.01)]


@pytest.mark.parametrize(
    ("row", "manifest", "chosen"),
    [
        ({"dt_s": 0.02}, {"dt_s": None, "scenarios": {"brick": {"steps_s": [0.02]}}}, False),
        ({"dt_s": 0.01}, {"dt_s": None, "scenarios": {"brick": {"steps_s": [0.02]}}}, True),
        ({"dt_s": 0.02}, {"dt_s": [0.1], "scenarios": {"brick": {"steps_s": [0.02]}}}, True),
        ({"dt_s": 0.02}, {"dt_s": None, "scenarios": {"brick": {"duration_s": 10.0, "samples": 101}}}, False),
        (
            {"dt_s": 0.0005},
            {"dt_s": None, "scenarios": {"brick": {"duration_s": 10.0, "samples": 101}}},
            True,
        ),
        ({"dt_s": 0.02}, {"dt_s": None, "scenarios": {"brick": {}}}, False),
        ({"dt_s": None, "control": "none"}, {"dt_s": [0.1], "scenarios": {}}, False),
        ({"dt_s": None, "tolerance": 1e-6, "control": "tolerance"}, {"dt_s": [0.1], "scenarios": {}}, False),
    ],
)
def test_the_steps_of_a_run_are_the_requested_ones(
    row: dict[str, Any], manifest: dict[str, Any], chosen: bool
) -> None:
    """A step is requested by the run's option, else by the scenario, else as one of five per interval."""
    assert is_refinement({"scenario": "brick", "control": "dt", **row}, manifest) == chosen


def test_an_instant_error_is_weighed_against_its_maximum_over_time() -> None:
    """A final error near a zero crossing is not better; one that grows to a tenth of the maximum is worse."""
    final = "orientation_error_final_rad"
    before = run({ERROR: 1e-2, final: 1e-9})
    for now, status in ((1e-4, "moved"), (1e-3, "worse")):
        (change,) = compare(before, run({ERROR: 1e-2, final: now})).changes
        assert (change.quantity, change.status) == (final, status)


def test_round_off_that_drifts_accuses_nobody() -> None:
    """After 100,000 steps an error of 1e-11 may be accumulated round-off and is not worse; 1e-10 is."""
    before = run({ERROR: 1e-12, "steps": 100_000})
    for now, status in ((1e-11, "moved"), (1e-10, "worse")):
        (change,) = compare(before, run({ERROR: now, "steps": 100_000})).changes
        assert change.status == status


def test_a_stable_step_in_chaos_accuses_nobody() -> None:
    """If the truth ends before the scenario, the step at which a motion breaks down is a matter of chance."""
    row = {"scenario": "brick", "engine": "mujoco", "method": "rk4", "outcome": "ok", "dt_unstable_s": 0.3}
    complete, chaotic = ({"compared_until_s": until, "duration_s": 1.0} for until in (1.0, 0.5))
    for old, new, status in (
        (chaotic, chaotic, "moved"),
        (chaotic, complete, "moved"),
        (complete, chaotic, "moved"),
        (complete, complete, "worse"),
    ):
        before = run(old, stability=[{**row, "dt_stable_s": 0.2}])
        after = run(new, stability=[{**row, "dt_stable_s": 0.1, "dt_unstable_s": 0.11}])
        (change,) = compare(before, after).changes
        assert (change.kind, change.status) == ("stability", status)


def test_a_balance_that_the_samples_cannot_resolve_is_not_missing() -> None:
    """The balance is empty where it is small; the energy drift from the truth is reported next to it."""
    there, empty = run({"energy_balance": 1e-9}), run({})
    assert compare(there, empty).changes == compare(empty, there).changes == ()
    gone = compare(run({"omega_error": 1e-9}), empty).changes
    assert [(one.quantity, one.status) for one in gone] == [("omega_error", "missing")]


def test_each_measure_has_its_own_threshold() -> None:
    """A named threshold applies to its measure and absolute column; the default applies to all others."""
    thresholds = Thresholds(0.1, {"energy_drift": 0.5, f"order.{ERROR}": 0.3, "stability.dt_stable_s": 2.0})
    row = {"scenario": "brick", "engine": "mujoco", "method": "rk4", "outcome": "ok"}
    before, after = (
        run(
            {ERROR: 1e-3 * factor, "energy_drift": 1e-3 * factor, "position_error_abs": 1e-3 * factor},
            methods=[of_order(4.0 - 0.2 * place)],
            stability=[{**row, "dt_stable_s": 0.2 / factor, "dt_unstable_s": 0.21 / factor}],
            version="4.0.0",
        )
        for place, factor in enumerate((1.0, 1.3))
    )
    found = {(one.kind, one.quantity): one.status for one in compare(before, after, thresholds).changes}
    assert found == {
        ("accuracy", ERROR): "worse",
        ("accuracy", "energy_drift"): "moved",
        ("accuracy", "position_error_abs"): "worse",
        ("order", f"order of {ERROR}"): "moved",
        ("stability", "dt_stable_s"): "moved",
    }
    assert Thresholds(0.1, {"energy_drift": 0.5}).of("energy_drift_abs") == 0.5
    assert {one.status for one in compare(before, after).changes} == {"worse"}


@pytest.mark.parametrize(
    ("before", "after", "command"),
    [
        (
            OLD,
            NEW,
            "bodycheck versions mujoco --since 3.17.0 --until 4.0.0 --scenario brick --method rk4 "
            "--measure orientation_error_rad --dt 0.001",
        ),
        (
            NEW,
            OLD,
            "bodycheck versions mujoco --since 3.17.0 --until 4.0.0 --scenario brick --method rk4 "
            "--measure orientation_error_rad --dt 0.001",
        ),
        (
            run({"omega_error": 1e-3}, version="3.9.0"),
            run({"omega_error": 1.01e-3}, version="3.10.0"),
            "bodycheck versions mujoco --since 3.9.0 --until 3.10.0 --scenario brick --method rk4 "
            "--measure omega_error --dt 0.01 --threshold 0",
        ),
        (
            run({}, methods=[of_order(2.0)], version="3.9.0"),
            run({}, methods=[of_order(1.0)], version="3.10.0"),
            "bodycheck versions mujoco --since 3.9.0 --until 3.10.0 --scenario brick --method rk4 "
            f"--measure order.{ERROR}",
        ),
        (
            run({}, methods=[of_order(2.0)], version="3.9.0"),
            run({}, methods=[{**of_order(2.0), "verdict": "does-not-converge"}], version="3.10.0"),
            "bodycheck versions mujoco --since 3.9.0 --until 3.10.0 --scenario brick --method rk4 "
            f"--measure verdict.{ERROR}",
        ),
        (run({ERROR: 1e-3}), run({ERROR: 1e-2}), None),  # the same release
        (run({}), run({}, version="4.0.0"), None),  # nothing changed with it
        (
            run({"engine": "reference"}, engine="reference", version="1"),
            run({"engine": "reference", ERROR: 1.0}, engine="reference", version="2"),
            None,  # it has no releases of its own
        ),
    ],
)
def test_the_command_that_finds_the_release_is_named(
    before: Tables, after: Tables, command: str | None
) -> None:
    """The command is for the largest change, older release first; a change that moved has threshold 0."""
    assert list(release_searches(compare(before, after))) == ([command] if command else [])


def test_terminal_markdown_and_page_say_the_same(capsys: pytest.CaptureFixture[str]) -> None:
    """Each sentence and each group of failing changes appears in all three."""
    lost = {"method": "lost", "dt_s": 1e-3}
    before = replace(NEW, cases=(*NEW.cases, *run(lost).cases))
    found = compare(before, OLD)
    document = comparison_document(found)
    print_document(document)
    shown, page, as_markdown = capsys.readouterr().out, comparison_page(found), markdown(document)
    assert len(as_markdown.splitlines()) < 60
    lines = shown.splitlines()
    listed = [line for line in lines if line.startswith("brick")]
    assert len(listed) == 3
    for line in listed:
        words = re.split(" {2,}", line)
        for text in words:
            assert str(escape(text)) in page
            assert escaped_markdown(text) in as_markdown
    for sentence in sentences(found):
        assert sentence in lines
        assert escaped_markdown(sentence) in as_markdown
        assert str(escape(sentence)) in page
    for heading in ("Worse", "No longer measured"):
        assert heading in lines
        assert f"{heading}</h2>" in page
        assert f"**{heading}**" in as_markdown


@pytest.mark.parametrize(("after", "text"), [(2e-6, "x 2"), (1.021e-6, "+2.1 %")])
def test_a_small_change_is_given_in_percent(after: float, text: str) -> None:
    """A change by a few percent is not a factor of 1."""
    (change,) = compare(run({ERROR: 1e-6}), run({ERROR: after})).changes
    assert factor_text(change) == text


@pytest.mark.parametrize(
    ("before", "after", "ending"),
    [(0.0, 1e-7, " above its noise"), (1e-7, 0.0, ", to its noise"), (1e-9, 1e-7, "")],
)
def test_a_factor_of_a_value_below_its_noise_says_so(before: float, after: float, ending: str) -> None:
    """It is not the ratio of the two numbers that stand beside it."""
    (change,) = compare(run({ERROR: before}), run({ERROR: after})).changes
    assert re.fullmatch(rf"x [\d.e-]+{ending}", factor_text(change))


def test_an_error_says_more_than_an_order_that_is_no_longer_known() -> None:
    """A measure that leaves round-off has too few steps for an order, which is no headline; its error is."""
    norm = {"quantity": "quaternion_norm_error", "order": None}
    before = run({ERROR: 1e-9, "quaternion_norm_error": 0.0}, methods=[norm | {"verdict": "at-floor"}])
    after = run({ERROR: 1e-9, "quaternion_norm_error": 1e-7}, methods=[norm | {"verdict": "too-few-points"}])
    (line,) = headlines(compare(before, after))
    assert line.startswith("mujoco:rk4: quaternion norm at dt 0.01 s x ")
    assert "too few points" not in line


def test_a_change_without_a_size_has_no_text_of_it() -> None:
    """A new measure has neither a factor nor a share."""
    assert factor_text(Change("accuracy", "brick", "mujoco", "rk4", ERROR, None, 1.0, "new")) == ""


def test_every_measure_has_a_name_without_its_unit() -> None:
    """An error is named after its quantity, a drift is a drift."""
    named = [label(name) for name in (ERROR, "energy_drift", "omega_error_abs", "order of position_error")]
    assert named == ["orientation", "energy drift", "omega", "position"]


@pytest.mark.parametrize("size", [1.0, 1e3])
def test_a_relative_size_is_the_larger_over_the_smaller_value(size: float) -> None:
    """The relative size of a change is this ratio less 1, in either direction."""
    up = compare(run({ERROR: 1e-6 * size}), run({ERROR: 1.5e-6 * size})).changes[0]
    down = compare(run({ERROR: 1.5e-6 * size}), run({ERROR: 1e-6 * size})).changes[0]
    assert up.relative == pytest.approx(0.5)
    assert down.relative == pytest.approx(0.5)
    assert math.isclose(up.size, down.size)


@pytest.mark.parametrize(
    ("quantity", "words"),
    [
        ("dt_stable_s", "largest stable step in s"),
        ("orientation_error_rad", "orientation"),
        ("order of energy_drift_abs", "energy drift"),
    ],
)
def test_a_quantity_is_named_in_words(quantity: str, words: str) -> None:
    """Without the parts of its column that are no words."""
    assert label(quantity) == words
