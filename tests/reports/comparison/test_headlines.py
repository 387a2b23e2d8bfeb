"""The headlines of a comparison: one sentence per engine, net per method, the largest factor first."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from markupsafe import escape

from bodycheck.reports.comparison.change import Change, Status
from bodycheck.reports.comparison.compare import compare, paired_versions
from bodycheck.reports.comparison.describe import (
    comparison_document,
    comparison_page,
    release_searches,
    sentences,
)
from bodycheck.reports.comparison.environment_diff import is_refinement
from bodycheck.reports.comparison.headlines import by_method, error_text, headlines, size_text
from bodycheck.reports.document import escaped_markdown, markdown, print_document
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.run_files.run_reader import Tables
from tests.helpers.gate_tables import make_tables
from tests.helpers.swapped_runs import SWAPPED_STATUS

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
        return replace(tables, fingerprints=tables.fingerprints.from_records(rows))

    before = mapped(OLD, rk4="RK4", euler="M1", implicit="M2")
    after = mapped(NEW, rk4="RK4 Munthe-Kaas", euler="M1", implicit="implicit midpoint")
    (headline,) = headlines(compare(before, after))
    assert "(factor 1.9e6), one-step map RK4 -> RK4 Munthe-Kaas; " in headline
    assert "; implicit moved, one-step map M2 -> implicit midpoint; 3 methods moved in the " in headline


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
        replace(
            OLD,
            laws=OLD.laws.from_records(
                [{"engine": "mujoco", "method": "rk4", "law": "boost", "verdict": verdict}]
                if verdict
                else [],
                columns=["engine", "method", "law", "verdict"],
            ),
        )
        for verdict in (before, after)
    )
    found = compare(obeyed, obeying)
    assert [(one.quantity, one.status) for one in found.changes] == [("law boost", status)] * bool(status)
    if status is not None:
        assert headlines(found) == [f"mujoco 3.17.0: rk4 moved, law boost {before} -> {after}."]
        assert "law boost" in markdown(comparison_document(found))


def test_a_change_of_speed_is_a_factor() -> None:
    """A larger relative time is reported as a factor slower, a smaller one as a factor faster."""
    made = partial(Change, "speed", None, "mujoco", quantity="relative_cpu", before=1.0)
    slower = made(method="rk4", after=2.0, status="worse", decades=math.log10(2.0))
    faster = made(method="euler", after=0.25, status="improved", decades=-math.log10(4.0))
    comparison = replace(compare(OLD, OLD), changes=(slower, faster))
    assert headlines(comparison) == [
        "mujoco 3.17.0: rk4 worse, 2 times slower; euler improved, 4 times faster."
    ]


@pytest.mark.parametrize(
    ("before", "after", "shown"),
    [(1.234e-3, 5.678e-3, "0.0012 -> 0.0057"), (1.2341e-3, 1.2349e-3, "0.001234 -> 0.001235")],
)
def test_values_have_as_many_digits_as_distinguish_them(before: float, after: float, shown: str) -> None:
    """Two values are shown with at least two digits, and with more only if those are equal."""
    change = Change(
        "case",
        "brick",
        "mujoco",
        "rk4",
        ERROR,
        before,
        after,
        "worse",
        fineness=1e-3,
        control="dt",
        decades=0.5,
    )
    (line,) = headlines(replace(compare(OLD, OLD), changes=(change,)))
    assert f" {shown}." in line


def test_a_better_release_is_one_sentence() -> None:
    """A headline has versions, method, order, error with step and factor; moved methods are counted."""
    assert headlines(compare(OLD, NEW)) == [
        "mujoco 3.17.0 -> 4.0.0: rk4 improved, order 2 -> 4, error at 1 ms 4.3e-7 -> 2.3e-13 rad "
        "(factor 1.9e6); 4 methods moved in the 12th digit."
    ]
    assert not compare(OLD, NEW).failing


def test_the_release_before_is_worse_by_the_same_factor() -> None:
    """In the reverse direction the same change is reported as worse, and the comparison fails."""
    found = compare(NEW, OLD)
    assert headlines(found) == [
        "mujoco 4.0.0 -> 3.17.0: rk4 worse, order 4 -> 2, error at 1 ms 2.3e-13 -> 4.3e-7 rad "
        "(factor 1.9e6); 4 methods moved in the 12th digit."
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
    moved = release("3.17.0", 4.31e-7, 2.0, engine="mujoco==3.17.0")
    assert headlines(compare(old, moved))[0].startswith("mujoco 3.17.0: ")
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


def test_what_dominates_leads_and_a_real_worsening_is_named() -> None:
    """Better in orientation by decades and worse in energy by a tenth is one clause that states both."""
    before = run({ERROR: 1e-4, "energy_drift": 1e-3, "dt_s": 1e-3})
    after = run({ERROR: 1e-8, "energy_drift": 1.1e-3, "dt_s": 1e-3})
    assert headlines(compare(before, after)) == [
        "mujoco 3.17.0: rk4 improved, error at 1 ms 0.0001 -> 1e-8 rad (factor 1e4), "
        "but worse, energy_drift at 1 ms 0.001 -> 0.0011 (10 %)."
    ]
    assert headlines(compare(after, before)) == [
        "mujoco 3.17.0: rk4 worse, error at 1 ms 1e-8 -> 0.0001 rad (factor 1e4), "
        "but improved, energy_drift at 1 ms 0.0011 -> 0.001 (10 %)."
    ]
    assert compare(before, after).failing


@pytest.mark.parametrize(("factor", "named"), [(5.0, False), (1e3, True)])
def test_a_measure_that_is_far_worse_than_the_orientation_is_named(factor: float, named: bool) -> None:
    """A measure that is more than a decade worse is named; the orientation comes first in any case."""
    before = run({ERROR: 1e-4, "energy_drift": 1e-6})
    after = run({ERROR: 2e-4, "energy_drift": 2e-6 * factor})
    (headline,) = headlines(compare(before, after))
    assert "rk4 worse, error at 10 ms 0.0001 -> 0.0002 rad (factor 2)" in headline
    assert ("energy_drift at 10 ms 1e-6 -> 0.002 (factor 2e3)" in headline) == named


def test_a_measure_that_is_a_decade_worse_than_the_orientation_is_not_named() -> None:
    """It must be worse by more."""
    found = compare(run({ERROR: 1e-4, "energy_drift": 1e-6}), run({ERROR: 2e-4, "energy_drift": 1e-4}))
    sizes = {ERROR: 0.25, "energy_drift": 1.25}
    changes = tuple(replace(change, decades=sizes[change.quantity]) for change in found.changes)
    (headline,) = headlines(replace(found, changes=changes))
    assert "energy_drift" not in headline


def test_a_method_stands_in_one_clause_however_many_of_its_digits_moved() -> None:
    """Changes of last digits in both directions count once, and make no method worse or improved."""
    before = run({ERROR: 1e-2}, {"dt_s": 0.02, ERROR: 1e-2}, {"method": "euler", ERROR: 1e-2})
    after = run({ERROR: 1e-2 + 3e-13}, {"dt_s": 0.02, ERROR: 1e-2 - 3e-13}, {"method": "euler", ERROR: 2e-2})
    (headline,) = headlines(compare(before, after))
    assert headline == (
        "mujoco 3.17.0: euler worse, error at 10 ms 0.01 -> 0.02 rad (factor 2);"
        " 1 method moved in the 11th digit."
    )


def test_methods_are_sorted_by_what_fails_and_by_factor() -> None:
    """Worse methods come first, then missing ones, then improved ones; each engine has its own sentence."""
    factors = {"a": 1.5, "b": 30.0, "c": 1e-3, "d": 0.5, "e": 1.01}
    before = run(*({"method": name, ERROR: 1e-5} for name in factors), {"method": "gone"})
    after = run(
        *({"method": name, ERROR: 1e-5 * factor} for name, factor in factors.items()), {"method": "came"}
    )
    found = compare(before, after)
    assert [one.method for one in by_method(found.changes)][:5] == ["b", "a", "gone", "c", "d"]
    (headline,) = headlines(found)
    places = [
        headline.index(words) for words in ("b worse", "a worse", "gone missing (1 case)", "c improved")
    ]
    assert places == sorted(places)
    assert headline.endswith(
        "d improved, error at 10 ms 1e-5 -> 5e-6 rad (factor 2); 1 method moved by up to 1 %; came new."
    )


def test_failures_without_a_size_outweigh_any_factor() -> None:
    """A method that no longer converges, or lacks a case, is not improved by a smaller error elsewhere."""
    error = {"dt_s": 0.02, ERROR: 1e-3}
    before = run({}, error, methods=[{**of_order(2.0), "verdict": "converges"}])
    after = run({}, {**error, ERROR: 1e-9}, methods=[{**of_order(2.0), "verdict": "does-not-converge"}])
    (wrong,) = by_method(compare(before, after).changes)
    assert (wrong.net, bool(wrong.of("improved"))) == ("worse", True)
    (missing,) = by_method(compare(before, run({**error, ERROR: 1e-9})).changes)
    assert (missing.net, bool(missing.of("improved"))) == ("missing", True)


@pytest.mark.parametrize(
    ("old", "new", "status"),
    [("ok", "failed", "worse"), ("failed", "ok", "improved")],
)
def test_a_case_that_ends_otherwise_outweighs_any_factor(old: str, new: str, status: Status) -> None:
    """A method with a case that now fails is worse, whatever else improved."""
    factor = {"worse": 1e-6, "improved": 1e6}[status]
    before = run({"outcome": old}, {"dt_s": 0.02, ERROR: 1e-3})
    after = run({"outcome": new}, {"dt_s": 0.02, ERROR: 1e-3 * factor})
    (one,) = by_method(compare(before, after).changes)
    assert one.net == status
    opposite = SWAPPED_STATUS[status]
    assert (
        f"rk4 {status}, outcome at 10 ms {old} -> {new}, but {opposite}, error"
        in headlines(compare(before, after))[0]
    )


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


@pytest.mark.parametrize(("after", "text"), [(2e-6, "(factor 2)"), (1.021e-6, "(2.1 %)")])
def test_a_small_change_is_given_in_percent(after: float, text: str) -> None:
    """A change by a few percent is not a factor of 1."""
    (change,) = compare(run({ERROR: 1e-6}), run({ERROR: after})).changes
    assert error_text(change).endswith(text)


def test_a_change_without_a_size_has_no_text_of_it() -> None:
    """A new measure has neither a factor nor a share."""
    assert size_text(Change("accuracy", "brick", "mujoco", "rk4", ERROR, None, 1.0, "new"), 2) == ""


@pytest.mark.parametrize("size", [1.0, 1e3])
def test_a_relative_size_is_the_larger_over_the_smaller_value(size: float) -> None:
    """The relative size of a change is this ratio less 1, in either direction."""
    up = compare(run({ERROR: 1e-6 * size}), run({ERROR: 1.5e-6 * size})).changes[0]
    down = compare(run({ERROR: 1.5e-6 * size}), run({ERROR: 1e-6 * size})).changes[0]
    assert up.relative == pytest.approx(0.5)
    assert down.relative == pytest.approx(0.5)
    assert math.isclose(up.size, down.size)
