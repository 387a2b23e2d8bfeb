"""The rules of a comparison at their limits, on rows and runs made of a few cells."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bodycheck.reports.comparison.change import (
    Change,
    Kind,
    Ratio,
    accuracy_changes,
    by_rank,
    noise,
    order_change,
    ratio,
    sign_changes,
    speed_changes,
    stability_change,
)
from bodycheck.reports.comparison.compare import compare
from bodycheck.reports.comparison.comparison_document import (
    HEADINGS,
    _best_change,
    change_tables,
    change_text,
    groups,
    identity,
    sentences,
)
from bodycheck.reports.comparison.environment_diff import environment_diff, redefined
from bodycheck.reports.gates.thresholds import Thresholds
from bodycheck.reports.run_files.run_tables import Tables
from bodycheck.reports.table_layout import MEDIA
from tests.helpers.gate_tables import make_tables
from tests.helpers.swapped_runs import swapped

EPS = float(np.finfo(np.float64).eps)
WHO = {"scenario": "brick", "engine": "mujoco", "method": "rk4", "control": "dt", "dt_s": 0.01}
LEAST = 2.0**-30
ERROR = "orientation_error_rad"


def run(*cases: dict[str, Any], **parts: Any) -> Tables:
    """Return a run of these cases, by default of two scenarios on one machine."""
    scenarios = {"brick": {"duration_s": 1.0}, "plate": {"duration_s": 1.0}}
    return make_tables(list(cases), **{"scenarios": scenarios, **parts})


def change(**cells: Any) -> Change:
    """Return a worse error of one case, with the given fields replaced."""
    usual = {"kind": "accuracy", "scenario": "brick", "engine": "mujoco", "method": "rk4", "quantity": ERROR}
    reported = {"before": 1e-3, "after": 1e-2, "status": "worse", "control": "dt", "fineness": 0.01}
    return Change(**{**usual, **reported, "decades": 1.0, **cells})


# ----------------------------------------------------------------------------------------------- accuracy


@pytest.mark.parametrize(
    ("measure", "row", "floors", "least"),
    [
        ("quaternion_norm_error", {}, {}, 8.0 * EPS),
        ("quaternion_norm_error", {"steps": 10_000}, {"quaternion_norm_error": 1.0}, 108.0 * EPS),
        (ERROR, {"steps": 10_000}, {}, 108.0 * EPS),
        (ERROR, {"truth_bound_rad": 1e-10}, {ERROR: 2e-10}, 3e-10),
        (ERROR, {"truth_bound_rad": 1e-10}, {ERROR: 4e-10}, 4e-10),
        (ERROR, {}, {"energy_drift": 1.0}, 8.0 * EPS),
        (ERROR, {ERROR: 3.0}, {}, 24.0 * EPS),
        (ERROR, {ERROR: 0.5}, {}, 8.0 * EPS),
        ("orientation_error_final_rad", {}, {ERROR: 1e-9}, 1e-9),
        ("velocity_error", {}, {"velocity_error": 1e-9}, 1e-9),
        ("energy_balance", {}, {"energy_balance": 1e-9}, 1e-9),
        ("linear_momentum_drift", {}, {"linear_momentum_drift": 1e-9}, 1e-9),
        ("invariant_drift", {}, {"invariant_drift": 1e-9}, 1e-9),
        (
            "rotational_energy_drift",
            {"energy_scale_j": 6.0, "rotational_energy_scale_j": 2.0, "truth_bound_energy": 1e-9},
            {},
            9e-9,
        ),
    ],
)
def test_noise_is_the_largest_of_bound_floor_and_round_off(
    measure: str, row: dict[str, Any], floors: dict[str, float], least: float
) -> None:
    """max(3 bound, floor, eps (8 + sqrt(steps)) max(1, value)), with the values of each measure."""
    assert noise(measure, row, floors) == pytest.approx(least, rel=1e-12, abs=0.0)


def accuracies(old: dict[str, Any], new: dict[str, Any], *floors: float) -> list[Change]:
    """Return what changed of one case whose method has these floors before and after."""
    known = tuple({ERROR: floor} for floor in floors or (LEAST, LEAST))
    return list(accuracy_changes({**WHO, **old}, {**WHO, **new}, known, Thresholds()))  # type: ignore[arg-type]


@pytest.mark.parametrize("floors", [(LEAST, LEAST), (1e-3, LEAST), (LEAST, 1e-3)])
def test_error_changes_by_more_than_the_smaller_noise(floors: tuple[float, float]) -> None:
    """Up to three times the noise there is no change; one double more has moved, from either side."""
    beyond = math.nextafter(3.0 * LEAST, 1.0)
    assert accuracies({ERROR: 0.0}, {ERROR: 3.0 * LEAST}, *floors) == []
    (moved,) = accuracies({ERROR: 0.0}, {ERROR: beyond}, *floors)
    assert (moved.status, moved.before, moved.after) == ("moved", 0.0, beyond)
    assert moved.decades == pytest.approx(math.log10(3.0))
    assert accuracies({ERROR: beyond}, {ERROR: 0.0}, *floors) == [swapped(moved)]


@pytest.mark.parametrize("floors", [(LEAST, LEAST), (1e-3, LEAST), (LEAST, 1e-3)])
def test_error_is_worse_beyond_noise_and_threshold(
    floors: tuple[float, float],
) -> None:
    """The limit is 2 % of the smaller value and the noise of both; values below the noise count as noise."""
    for low in (0.0, 1e-3):
        edge = max(low, LEAST) * 1.02 + 2.0 * LEAST
        (moved,) = accuracies({ERROR: low}, {ERROR: edge * (1.0 - 1e-9)}, *floors)
        (worse,) = accuracies({ERROR: low}, {ERROR: edge * (1.0 + 1e-9)}, *floors)
        assert (moved.status, worse.status) == ("moved", "worse")
        assert accuracies({ERROR: worse.after}, {ERROR: low}, *floors) == [swapped(worse)]


def test_measure_without_a_scale_is_compared_by_its_size() -> None:
    """A few roundings of a large number are no change; a hundred are one."""
    large = 1e6
    for roundings, reported in ((4.0, 0), (100.0, 1)):
        after = {"energy_drift_abs": large * (1.0 + roundings * EPS)}
        found = accuracies({"energy_drift_abs": large}, after)
        assert [one.quantity for one in found] == reported * ["energy_drift_abs"]


def test_body_without_rotation_is_compared() -> None:
    """Its rotational energy has no scale: ten times as much is a change, the round-off of 1 J is none."""
    still = {"energy_scale_j": 6.0, "rotational_energy_scale_j": 0.0}
    before = {**still, "rotational_energy_drift_abs": 1e-12}
    assert accuracies(before, before) == []
    for round_off in (1e-310, 3.7e-32, EPS):
        zero, tiny = ({**still, "rotational_energy_drift_abs": drift} for drift in (0.0, round_off))
        assert accuracies(zero, tiny) == accuracies(tiny, zero) == []
    (worse,) = accuracies(before, {**still, "rotational_energy_drift_abs": 1e-11})
    assert (worse.quantity, worse.status) == ("rotational_energy_drift_abs", "worse")


@pytest.mark.parametrize(
    ("cells", "fineness"),
    [({}, 0.01), ({"control": "tolerance", "dt_s": None, "tolerance": 1e-6}, 1e-6), ({"dt_s": None}, None)],
)
def test_change_names_its_case(cells: dict[str, Any], fineness: float | None) -> None:
    """Scenario, engine, method, control and step or tolerance; missing and new cases have no size."""
    there = {**cells, ERROR: 1e-3}
    (gone,) = accuracies(there, cells)
    control = cells.get("control", "dt")
    who = ("brick", "mujoco", "rk4", ERROR)
    assert gone == Change("accuracy", *who, 1e-3, None, "missing", control, fineness)
    assert accuracies(cells, there) == [swapped(gone)]


# ------------------------------------------------------------------------------------ changes by themselves


def test_measure_without_a_scale_that_only_one_run_has_is_a_change() -> None:
    """It is missing from the one or new in the other."""
    (gone,) = accuracies({"energy_drift_abs": 1.0}, {})
    assert (gone.quantity, gone.status) == ("energy_drift_abs", "missing")
    assert accuracies({}, {"energy_drift_abs": 1.0}) == [swapped(gone)]


def test_final_error_without_its_maximum_is_compared_with_itself() -> None:
    """There is no larger error that would make its change small."""
    (worse,) = accuracies({"orientation_error_final_rad": 1e-3}, {"orientation_error_final_rad": 1e-2})
    assert worse.status == "worse"


def test_change_at_the_threshold_itself_has_only_moved() -> None:
    """The part beyond the noise must exceed it: here by half of 1."""
    floors = {ERROR: LEAST}, {ERROR: LEAST}
    for high, status in ((1.5 + 2.0 * LEAST, "moved"), (1.5 + 3.0 * LEAST, "worse")):
        (found,) = accuracy_changes(WHO | {ERROR: 1.0}, WHO | {ERROR: high}, floors, Thresholds(0.5))
        assert found.status == status


def test_drift_of_round_off_grows_with_steps_and_value() -> None:
    """With 1e15 steps a value of 3 may drift by 3 eps 1e15 = 0.67: a change to 4 is within twice that."""
    for steps, status in ((1e15, "moved"), (5e14, "worse")):
        (found,) = accuracies({ERROR: 3.0, "steps": steps}, {ERROR: 4.0, "steps": steps})
        assert found.status == status


@pytest.mark.parametrize(
    ("old", "new", "floor", "found"),
    [
        (-1e-6, 1e-6, 1e-9, ("loses 1e-6", "gains 1e-6")),
        (2e-6, -1e-6, 1e-9, ("gains 2e-6", "loses 1e-6")),
        (-1e-6, -2e-6, 1e-9, None),
        (-1e-9, 1e-6, 1e-9, None),
        (-1e-6, 1e-6, 1e-6, None),
    ],
)
def test_a_drift_that_changes_its_sign_above_the_floor_is_a_change(
    old: float, new: float, floor: float, found: tuple[str, str] | None
) -> None:
    """A gain equals a loss in the absolute measure; below the floor, the sign is noise."""
    before, after = ({**WHO, "energy_drift": abs(v), "energy_drift_signed": v} for v in (old, new))
    changes = list(sign_changes(before, after, ({"energy_drift": floor}, {"energy_drift": floor})))
    if found is None:
        assert changes == []
    else:
        (only,) = changes
        assert (only.kind, only.quantity, only.status) == ("sign", "sign of energy_drift", "moved")
        assert (only.before, only.after) == found
    runs = [run({**row, "outcome": "ok"}) for row in (before, after)]
    in_runs = [one for one in compare(*runs).changes if one.kind == "sign"]
    assert len(in_runs) == (old * new < 0.0)  # without a row of methods.csv, the floor is round-off


def test_changes_without_a_size_come_first() -> None:
    """The size is that of the decades, in either direction."""
    assert [change(decades=decades).size for decades in (1.0, -1.0, None)] == [1.0, 1.0, math.inf]


def test_higher_rank_is_better() -> None:
    """A higher rank is an improvement, a lower one worse, an equal one moved."""
    assert [by_rank(*ranks) for ranks in ((0, 1), (1, 0), (1, 1))] == ["improved", "worse", "moved"]


# ------------------------------------------------------------------------------------------ stable steps


@pytest.mark.parametrize(
    ("old", "new", "reported"),
    [
        ((0.1, 0.2), (0.2, 0.3), ("improved", math.log10(2.0))),
        ((0.2, 0.3), (0.1, 0.2), ("worse", -math.log10(2.0))),
        ((0.1, 0.2), (0.19, 0.3), None),
        ((0.1, 0.1001), (0.1015, 0.102), ("moved", math.log10(1.015))),
        ((0.1, 0.1001), (0.1025, 0.103), ("improved", math.log10(1.025))),
        ((0.1, None), (0.05, 0.1), ("worse", -math.log10(2.0))),
        ((None, 0.1), (0.1, 0.2), ("improved", None)),
        ((0.1, 0.2), (None, 0.1), ("worse", None)),
        ((None, 0.1), (None, 0.2), None),
    ],
)
def test_change_of_a_stable_step_is_the_ratio_of_the_stable_ones(
    old: tuple[float | None, float | None],
    new: tuple[float | None, float | None],
    reported: tuple[str, float | None] | None,
) -> None:
    """Its size is log10 of the steps where the spans at most touch, and none where one is missing."""
    rows = []
    for stable, unstable in (old, new):
        cells = {"outcome": "ok", "dt_stable_s": stable, "dt_unstable_s": unstable}
        rows.append(WHO | {name: cell for name, cell in cells.items() if cell is not None})
    found = stability_change(rows[0], rows[1], 0.02)
    if reported is None:
        assert found is None
        return
    assert found is not None
    direction, decades = reported
    texts = (old[0] or "none", new[0] or "none")
    assert (found.kind, found.quantity, found.before, found.after) == ("stability", "dt_stable_s", *texts)
    assert found.status == direction
    assert found.decades == (None if decades is None else pytest.approx(decades))


def test_stable_step_at_the_threshold_itself_has_only_moved() -> None:
    """Twice the step is a change of 1."""
    rows = [WHO | {"outcome": "ok", "dt_stable_s": k, "dt_unstable_s": 1.5 * k} for k in (0.1, 0.2)]
    found = stability_change(rows[0], rows[1], 1.0)
    assert found is not None
    assert found.status == "moved"


@pytest.mark.parametrize(
    ("old", "new", "direction"),
    [("ok", "failed", "worse"), ("timeout", "ok", "improved"), ("failed", "timeout", "moved")],
)
def test_another_outcome_of_a_search_is_a_change(old: str, new: str, direction: str) -> None:
    """Success or failure decides on better or worse; two equal failures are no change."""
    found = stability_change({**WHO, "outcome": old}, {**WHO, "outcome": new}, 0.02)
    who = ("brick", "mujoco", "rk4", "stable step: search")
    assert found == Change("stability", *who, old, new, direction)  # type: ignore[arg-type]
    assert stability_change({**WHO, "outcome": "failed"}, {**WHO, "outcome": "failed"}, 0.02) is None


# ------------------------------------------------------------------------------------------------ speeds


def laps(low: float, middle: float, high: float, relative: float | None = None) -> dict[str, Any]:
    """Return the times of a case."""
    times = {**WHO, "cpu_s_low": low, "cpu_s": middle, "cpu_s_high": high}
    return times if relative is None else {**times, "relative_cpu": relative}


@pytest.mark.parametrize(
    ("before", "after", "decades", "sure"),
    [
        (laps(1.0, 10.0, 100.0), laps(1e3, 1e4, 1e5), 3.0, 1.0),
        (laps(1e3, 1e4, 1e5), laps(1.0, 10.0, 100.0), -3.0, -1.0),
        (laps(1.0, 10.0, 100.0), laps(10.0, 100.0, 1e3), 1.0, 0.0),
        # the reference took ten times as long too: nothing changed but the machine
        (laps(0.5, 1.0, 2.0, relative=2.0), laps(5.0, 10.0, 20.0, relative=2.0), 0.0, 0.0),
        (laps(0.5, 1.0, 2.0, relative=1.0), laps(0.5, 1.0, 2.0, relative=100.0), 2.0, 2.0 - math.log10(4.0)),
    ],
)
def test_quartiles_bound_a_ratio_of_times(
    before: dict[str, Any], after: dict[str, Any], decades: float, sure: float
) -> None:
    """log10 of the medians' ratio, and the gap between the nearest quartiles, 0 if they overlap."""
    found = ratio(before, after, same_machine=True)
    assert found is not None
    assert (found.scenario, found.engine, found.method) == ("brick", "mujoco", "rk4")
    assert found.decades == pytest.approx(decades, abs=1e-12)
    assert found.sure == pytest.approx(sure, abs=1e-12)


def test_incomparable_times_are_not_compared() -> None:
    """Seconds of two machines, of one run only, or below the clock's resolution give no ratio."""
    plain, relative = laps(1.0, 2.0, 3.0), laps(1.0, 2.0, 3.0, relative=1.0)
    assert ratio(plain, plain, same_machine=True) is not None
    assert ratio(plain, plain, same_machine=False) is None
    assert ratio(relative, relative, same_machine=False) is not None
    assert ratio(relative, plain, same_machine=False) is None
    assert ratio(plain, relative, same_machine=False) is None
    assert ratio(relative, plain, same_machine=True) is not None
    assert ratio(WHO, plain, same_machine=True) is None
    assert ratio(relative, laps(0.0, 0.0, 1.0, relative=0.0), same_machine=True) is None
    assert ratio(plain, WHO, same_machine=True) is None
    instant = laps(0.0, 1e-9, 1e-8)
    assert ratio(plain, instant, same_machine=True) is None
    assert ratio(instant, plain, same_machine=True) is None


def test_number_of_compared_times_is_counted() -> None:
    """Times in seconds are counted on one machine, and not across machines."""
    timed = {"cpu_s_low": 1.0, "cpu_s": 2.0, "cpu_s_high": 3.0}
    here, there = (run(timed, {"dt_s": 0.02}, cpu=cpu) for cpu in ("a", "b"))
    assert (compare(here, here).timed, compare(here, there).timed) == (1, 0)


@pytest.mark.parametrize(("noise_of_either", "reported"), [(None, 1), (0.6, 0)])
def test_slower_method_is_reported_beyond_the_noise(noise_of_either: float | None, reported: int) -> None:
    """1.5 times as long exceeds runs without noise, but not a noise of 0.6 in either run."""
    before, after = (run(laps(k, k, k), cpu="a") for k in (1.0, 1.5))
    noisy = replace(after, manifest={**after.manifest, "speed_noise": noise_of_either})
    assert [one.kind for one in compare(before, noisy).changes] == reported * ["speed"]
    assert [one.kind for one in compare(noisy, before).changes] == reported * ["speed"]


def moved(*sure: float, scenario: str = "brick", method: str = "rk4") -> list[Ratio]:
    """Return cases of a method that moved by so many decades at least, and twice that by their medians."""
    return [Ratio(scenario, "mujoco", method, 2.0 * one, one) for one in sure]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_method_is_slower_if_three_quarters_of_its_cases_are(sign: float) -> None:
    """The noises of both runs together are the bound; the median of all cases is reported."""
    slack = math.log10(1.0 + 0.1 + 0.2)
    beyond = math.nextafter(slack, 1.0)
    assert list(speed_changes(moved(*4 * [sign * slack]), (0.1, 0.2), 0.02)) == []
    (found,) = speed_changes(moved(*4 * [sign * beyond]), (0.1, 0.2), 0.02)
    assert found.status == ("worse" if sign > 0.0 else "improved")
    assert (found.kind, found.scenario, found.quantity) == ("speed", None, "relative_cpu")
    assert (found.before, found.after, found.decades) == (None, None, pytest.approx(2.0 * sign * slack))
    assert len(list(speed_changes(moved(*3 * [sign], 0.0), (0.1, 0.2), 0.02))) == 1
    assert len(list(speed_changes(moved(sign), (0.1, 0.2), 0.02))) == 1
    assert list(speed_changes(moved(sign, sign, 0.0, 0.0), (0.1, 0.2), 0.02)) == []


@pytest.mark.parametrize(("threshold", "status"), [(1.0, "moved"), (0.99, "worse")])
def test_speed_beyond_the_noise_has_moved_up_to_the_threshold(threshold: float, status: str) -> None:
    """Here it takes twice as long."""
    cases = [Ratio("brick", "mujoco", "rk4", math.log10(2.0), 0.2)]
    (found,) = speed_changes(cases, (0.1, 0.1), threshold)
    assert found.status == status


def test_disagreeing_cases_are_judged_per_scenario() -> None:
    """One of two scenarios that slowed down beyond three times the noise is named, and no other method."""
    slack = 3.0 * math.log10(1.1)
    still = moved(0.0, 0.0, 0.0, 0.0, scenario="plate") + moved(0.0, method="euler")
    for size, reported in ((slack, 0), (math.nextafter(slack, 1.0), 1)):
        found = list(speed_changes([*still, *moved(size, size)], (0.1, 0.0), 0.02))
        assert [(one.scenario, one.method, one.status) for one in found] == reported * [
            ("brick", "rk4", "worse")
        ]


# ------------------------------------------------------------------------------------------------- compare

SEVERITIES = {
    "converges": 0,
    "at-floor": 0,
    "pre-asymptotic": 1,
    "chaotic": 1,
    "does-not-converge": 2,
    "unstable": 3,
}


@pytest.mark.parametrize("error", [1e-9, 1e-3, 1e-15])
@pytest.mark.parametrize("after", SEVERITIES)
@pytest.mark.parametrize("before", SEVERITIES)
def test_more_severe_verdict_is_worse(before: str, after: str, error: float) -> None:
    """An accusing verdict always is; between sound and undecided only if the error of the quantity agrees."""
    old, new = (
        run({ERROR: found}, methods=[{"verdict": verdict, "order": None}])
        for verdict, found in ((before, 1e-9), (after, error))
    )
    rise = SEVERITIES[after] - SEVERITIES[before]
    status = "worse" if rise > 0 else "improved" if rise < 0 else "moved"
    agrees = (error > 1e-9) if rise > 0 else (error < 1e-9)
    if max(SEVERITIES[after], SEVERITIES[before]) < 2 and not agrees:
        status = "moved"
    found = [one for one in compare(old, new).changes if one.kind == "verdict"]
    reported = Change("verdict", "brick", "mujoco", "rk4", f"verdict of {ERROR}", before, after, status)  # type: ignore[arg-type]
    assert found == ([] if before == after else [reported])
    assert [swapped(one) for one in found] == [
        one for one in compare(new, old).changes if one.kind == "verdict"
    ]


def test_error_of_another_quantity_does_not_make_a_verdict_worse() -> None:
    """An order that is no longer observable is worse only if the quantity's own error is."""
    old, new = (
        run({ERROR: 1e-3, "energy_drift": drift}, methods=[{"verdict": verdict, "order": None}])
        for verdict, drift in (("converges", 1e-6), ("pre-asymptotic", 1e-3))
    )
    statuses = {one.kind: one.status for one in compare(old, new).changes}
    assert statuses == {"accuracy": "worse", "verdict": "moved"}


def test_order_that_only_one_run_has_is_not_compared() -> None:
    """Its verdict is."""
    row = {"scenario": "brick", "engine": "mujoco", "method": "rk4", "quantity": ERROR}
    known = row | {"order": 2.0, "order_low": 1.9, "order_high": 2.1}
    assert order_change(known, row, None, Thresholds()) is None
    assert order_change(row, known, None, Thresholds()) is None


@pytest.mark.parametrize(
    ("old", "new", "direction"),
    [
        ((2.0, 1.9, 2.1), (2.3, 2.15, 2.4), "improved"),
        ((2.3, 2.15, 2.4), (2.0, 1.9, 2.1), "worse"),
        ((2.0, 1.9, 2.1), (2.2, 2.1, 2.3), None),  # the intervals touch
        ((2.2, 2.1, 2.3), (2.0, 1.9, 2.1), None),
        ((2.0, 1.99, 2.01), (2.04, 2.03, 2.05), None),  # disjoint, but too small
        ((0.0, -0.01, 0.01), (0.05, 0.04, 0.06), None),
        ((2.0, 1.99, 2.01), (2.06, 2.05, 2.07), "moved"),  # an increase of less than 0.1
        ((2.0, 1.99, 2.01), (2.12, 2.11, 2.13), "improved"),
        ((2.12, 2.11, 2.13), (2.0, 1.99, 2.01), "worse"),
    ],
)
def test_order_changed_if_the_intervals_are_disjoint(
    old: tuple[float, ...], new: tuple[float, ...], direction: str | None
) -> None:
    """It must also move by more than 0.05; without a theory a loss of 0.1 is worse."""
    runs = [
        run({}, methods=[dict(zip(("order", "order_low", "order_high"), cells, strict=True))])
        for cells in (old, new)
    ]
    found = compare(*runs).changes
    who = ("order", "brick", "mujoco", "rk4", f"order of {ERROR}")
    assert found == ((Change(*who, old[0], new[0], direction),) if direction else ())  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("theories", "old", "new", "status"),
    [
        ((4, 2), (4.0, 3.99, 4.01), (2.0, 1.99, 2.01), "worse"),  # the theory of the better version counts
        ((2, 4), (2.0, 1.99, 2.01), (4.0, 3.99, 4.01), "improved"),
        ((4, 4), (5.0, 4.99, 5.01), (4.0, 3.99, 4.01), "moved"),  # still the theoretical order
        ((4, 4), (4.0, 3.99, 4.01), (3.92, 3.91, 3.93), "moved"),
        ((4, 4), (4.0, 3.99, 4.01), (3.85, 3.84, 3.86), "worse"),
        ((4, 4), (4.0, 3.99, 4.01), (3.85, 3.8, 4.0 - 0.1), "moved"),
        ((1, None), (1.0, 0.99, 1.01), (0.8, 0.79, 0.81), "worse"),
    ],
)
def test_order_below_theory_is_worse(
    theories: tuple[int | None, int | None], old: tuple[float, ...], new: tuple[float, ...], status: str
) -> None:
    """A loss must exceed its interval and 0.1; a loss above theory is not worse. The reverse is improved."""
    names = ("order", "order_low", "order_high")
    before, after = (
        run(
            {},
            methods=[dict(zip(names, cells, strict=True))],
            engines={"mujoco": {"version": "1", "methods": {"rk4": {"order": theory}}}},
        )
        for theory, cells in zip(theories, (old, new), strict=True)
    )
    (change,) = compare(before, after).changes
    assert (change.kind, change.status) == ("order", status)
    assert compare(after, before).changes == (swapped(change),)


def test_changed_scenarios_are_not_compared() -> None:
    """Their cases, verdicts and stable steps are not compared, and their names are reported."""
    row = {"scenario": "brick", "engine": "mujoco", "method": "rk4"}

    def made(duration_s: float, outcome: str, verdict: str) -> Tables:
        return run(
            {"outcome": outcome},
            {"scenario": "plate"},
            methods=[{"verdict": verdict, "order": None}],
            stability=[{**row, "outcome": outcome}],
            scenarios={"brick": {"duration_s": duration_s, "summary": outcome}, "plate": {}},
        )

    before, after = made(1.0, "ok", "converges"), made(2.0, "failed", "unstable")
    found = compare(before, after)
    assert (found.redefined, found.paired, found.changes) == (("brick",), 1, ())
    kinds = {one.kind for one in compare(before, made(1.0, "failed", "unstable")).changes}
    assert kinds == {"outcome", "verdict", "stability"}


@pytest.mark.parametrize(
    ("old", "new", "direction"),
    [("ok", "failed", "worse"), ("failed", "ok", "improved"), ("failed", "invalid", "moved")],
)
def test_change_between_failures_is_neither_better_nor_worse(old: str, new: str, direction: str) -> None:
    """Next to a failed outcome no accuracy is compared."""
    (found,) = compare(run({"outcome": old}), run({"outcome": new, ERROR: 1.0})).changes
    assert found == change(
        kind="outcome", quantity="outcome", before=old, after=new, status=direction, decades=None
    )


def test_cases_differ_by_step_and_tolerance() -> None:
    """A case of another step is new, one of a tolerance missing; each has its own outcome."""
    tolerance = {"control": "tolerance", "dt_s": None, "tolerance": 1e-6, "outcome": "timeout"}
    found = compare(run({}, tolerance), run({}, {"dt_s": 0.02})).changes
    cells = {"kind": "case", "quantity": "case", "decades": None}
    gone = change(**cells, before="timeout", after=None, status="missing", control="tolerance", fineness=1e-6)
    assert set(found) == {gone, change(**cells, before=None, after="ok", status="new", fineness=0.02)}


def test_largest_changes_come_first() -> None:
    """Changes without a size come before all others."""
    sizes = {0.01: 1e-8, 0.02: 1e-6, 0.03: 1e-7}
    before = run(*({"dt_s": dt_s} for dt_s in sizes))
    after = run(*({"dt_s": dt_s, ERROR: error} for dt_s, error in sizes.items()), {"dt_s": 0.04})
    assert [one.fineness for one in compare(before, after).changes] == [0.04, 0.02, 0.03, 0.01]


# ------------------------------------------------------------------------------------------ environment


def test_each_difference_of_the_environment_is_named_once() -> None:
    """Machine, software, engines, libraries and settings; a missing engine is unavailable."""
    before = {
        "cpu": "a",
        "platform": "x",
        "bodycheck": "0.1",
        "python": "3.11",
        "engines": {"mujoco": {"version": "3"}, "dart": {"unavailable": "no"}, "odd": {"version": "1"}},
        "libraries": {"numpy": "2.1", "numba": "0.61"},
        "timeout_s": 60.0,
        "tolerances": [1e-6],
    }
    after = {
        "cpu": "b",
        "cores": 2,
        "platform": "y",
        "bodycheck": "0.2",
        "python": "3.12",
        "engines": {"mujoco": {"version": "4"}, "dart": {"version": "6"}},
        "libraries": {"numpy": "2.2", "numba": "0.61"},
        "timeout_s": 30.0,
        "speed": False,
        "dt_s": [0.01],
    }
    assert environment_diff(before, after) == (
        "cpu: a -> b",
        "cores: none -> 2",
        "platform: x -> y",
        "bodycheck: 0.1 -> 0.2",
        "python: 3.11 -> 3.12",
        "mujoco: 3 -> 4",
        "dart: unavailable -> 6",
        "odd: 1 -> none",
        "numpy: 2.1 -> 2.2",
        "dt_s: none -> [0.01]",
        "tolerances: [1e-06] -> none",
        "speed: none -> False",
        "timeout_s: 60.0 -> 30.0",
    )
    assert environment_diff(before, before) == ()


def test_builds_of_one_version_are_named_with_the_parts_that_differ() -> None:
    """An engine that was built again; without a differing part only its builds are named."""

    def manifest(build: str, library: str) -> dict[str, Any]:
        about = {"version": "3", "build": {"id": build, "parts": {"libmujoco.so": library, "mujoco.py": "x"}}}
        return {"engines": {"mujoco": about}}

    (other,) = environment_diff(manifest("a" * 20, "1"), manifest("b" * 20, "2"))
    assert other.endswith(f"mujoco 3: {'a' * 12} -> {'b' * 12} (libmujoco.so)")
    (same,) = environment_diff(manifest("a" * 20, "1"), manifest("b" * 20, "1"))
    assert same.endswith(f"mujoco 3: {'a' * 12} -> {'b' * 12}")


@pytest.mark.parametrize("idle", ["summary", "source", "tags", "steps_s"])
def test_description_of_a_scenario_is_not_compared(idle: str) -> None:
    """Only what is simulated is compared, in scenarios that both runs have."""
    manifests = [
        {"scenarios": {"brick": {idle: 1, "samples": 11}, "old": {}}},
        {"scenarios": {"brick": {idle: 2, "samples": 11}, "new": {}}},
    ]
    assert redefined(manifests[0], manifests[1]) == ()
    manifests[1]["scenarios"]["brick"]["samples"] = 12
    assert redefined(manifests[0], manifests[1]) == ("brick",)


def test_surface_of_a_mesh_is_only_drawn() -> None:
    """Its mass properties are compared."""
    meshes = [{"surface": "a", "mass": 1.0}, {"surface": "b", "mass": 1.0}, {"mass": 2.0}]
    drawn, other, heavier = ({"scenarios": {"brick": {"body": {"mesh": mesh}}}} for mesh in meshes)
    assert redefined(drawn, other) == ()
    assert redefined(drawn, heavier) == ("brick",)
    assert redefined(drawn, {"scenarios": {"brick": {"body": {"mesh": {"mass": 1.0}}}}}) == ()


# -------------------------------------------------------------------------------------------------- words


@pytest.mark.parametrize(
    ("cells", "text"),
    [
        ({}, "orientation_error_rad 0.001 -> 0.01 (x 10) at dt 0.01 s"),
        ({"after": None, "decades": None}, "orientation_error_rad 0.001 -> not measured at dt 0.01 s"),
        (
            {"after": 1.00002e-3, "decades": math.log10(1.00002), "fineness": None},
            "orientation_error_rad 0.001 -> 0.00100002 (+0.002 %)",
        ),
        (
            {"before": 1.23456e-3, "after": 2.34567e-3, "decades": None, "fineness": None},
            "orientation_error_rad 0.001235 -> 0.002346",
        ),
        (
            {"decades": -math.log10(1.05), "fineness": None},
            "orientation_error_rad 0.001 -> 0.01 (-5 %)",
        ),
        ({"kind": "speed", "decades": math.log10(2.0)}, "2 times as slow"),
        ({"kind": "speed", "decades": math.log10(1.2346)}, "1.23 times as slow"),
        ({"kind": "speed", "decades": -math.log10(2.0)}, "2 times as fast"),
        ({"kind": "case", "before": None, "after": "ok"}, "new case at dt 0.01 s (ok)"),
        ({"kind": "case", "before": "failed", "after": None}, "missing case at dt 0.01 s (failed)"),
        (
            {"quantity": "outcome", "before": "ok", "after": "failed", "decades": None},
            "outcome ok -> failed at dt 0.01 s",
        ),
    ],
)
def test_change_is_described_with_its_values(cells: dict[str, Any], text: str) -> None:
    """The text has as many digits as distinguish the values, the size of the change and its step."""
    assert change_text(change(**cells)) == text


def test_tables_show_what_fails_everywhere_and_the_rest_on_pages() -> None:
    """There is a table per status, the most severe first; one that does not fail is folded."""
    tables = change_tables([change(status=status) for status in HEADINGS], "there")
    assert [(one.title, one.tint, one.folded, one.only) for one in tables] == [
        ("Worse", "bad", False, MEDIA),
        ("No longer measured", "bad", False, MEDIA),
        ("Improved", "good", True, ("page",)),
        ("Moved", "open", True, ("page",)),
        ("New", "open", True, ("page",)),
    ]
    assert [column.kind for column in tables[0].columns] == ["name", "name", "fixed", "number", "text"]
    (row,) = tables[0].rows
    assert row[:2] == ("brick", "mujoco:rk4")
    assert row[3] == "x 10"


def test_release_is_searched_for_the_largest_change_of_a_measure() -> None:
    """A worse one takes precedence, a missing one and times are not searched for."""
    small, large = change(decades=0.5), change(decades=2.0)
    order, better = change(kind="order"), change(status="improved", decades=4.0)
    idle = [change(status="missing", decades=None), change(kind="speed"), change(kind="case", status="new")]
    assert _best_change([*idle, better, order, small, large]) is large
    assert _best_change([*idle, better, order]) is order
    assert _best_change([*idle, better]) is better
    assert _best_change(idle) is None


def test_groups_are_sorted_by_status_then_kind_then_size() -> None:
    """Worst first; similar changes of a method on a scenario form one group with their number."""
    small, large = change(scenario="plate", decades=0.5), change(decades=2.0)
    order = change(kind="order", decades=0.1)
    better, other = change(status="improved"), change(status="moved", kind="outcome")
    slow = change(kind="speed", scenario=None)
    finer = change(fineness=0.005, decades=0.2)
    made = groups([other, better, slow, small, large, finer, order])
    assert [group.changes for group in made] == [
        (order,),
        (large, finer),
        (small,),
        (slow,),
        (better,),
        (other,),
    ]
    assert [group.where for group in made[2:4]] == ["plate", "all scenarios"]
    assert made[0].method == "mujoco:rk4"
    assert made[1].text == f"{change_text(large)}; 1 more change, in 2 cases"
    cases = [change(kind="case", before=None, after="ok", fineness=k, status="new") for k in (1.0, 2.0)]
    assert groups(cases)[0].text == f"{change_text(cases[0])}; 1 more case"


def test_a_group_names_the_change_that_the_headline_names() -> None:
    """The orientation error comes first, also where another measure changed by a larger factor."""
    error, drift = change(after=1.0, decades=3.0), change(quantity="energy_drift", after=1e5, decades=8.0)
    (group,) = groups([drift, error])
    assert group.text == f"{change_text(error)}; 1 more change, in 1 case"
    assert group.row[3] == "x 1e3"


def test_most_severe_kind_comes_first() -> None:
    """An outcome, a verdict, an order, a stable step, an error, a time, a missing case: in this order."""
    kinds: tuple[Kind, ...] = ("outcome", "verdict", "order", "stability", "accuracy", "speed", "case")
    made = groups([change(kind=kind) for kind in sorted(kinds)])
    assert [group.kind for group in made] == list(kinds)


def test_sentences_summarise_the_comparison() -> None:
    """Changes, environment, scenarios left out and numbers of cases, each only if there are any."""
    same = run({}, {"dt_s": 0.02})
    assert sentences(compare(same, same)) == [
        "Nothing changed beyond round-off and the noise of the machines.",
        "The same machine, versions and settings.",
        "2 cases compared; 0 new cases, 0 missing cases.",
    ]
    after = run({ERROR: 1e-6}, {"method": "euler"}, {"method": "implicit"}, cpu="other")
    assert sentences(compare(same, after)) == [
        "mujoco:rk4: no longer measured (1 case), error at dt 0.01 s x 1e3 in brick.",
        "Changed values: 1 worse, 1 missing, 2 new.",
        "Different environment: cpu: none -> other.",
        "1 case compared; 2 new cases, 1 missing case.",
    ]
    rebuilt = replace(compare(same, after), environment=("build of mujoco 4.0.0: 1 -> 2",))
    assert [line.partition(":")[0] for line in sentences(rebuilt)[:3]] == [
        "mujoco",
        "Different environment",
        "Changed values",
    ]
    fewer = compare(run({}, {"method": "euler"}, {"method": "implicit"}), run({}))
    assert sentences(fewer)[0] == "mujoco: euler and implicit: no longer measured (2 cases) in brick."
    other = run({}, scenarios={"brick": {"duration_s": 2.0}})
    assert sentences(compare(run({}), other)) == [
        "Nothing could be compared.",
        "The same machine, versions and settings.",
        "Not compared (scenario definition changed): brick.",
        "0 cases compared; 0 new cases, 0 missing cases.",
    ]


def test_run_is_named_by_id_time_and_version() -> None:
    """The name has these parts in this order."""
    assert identity(run({}, created="today", bodycheck="0.1")) == "made-up, today, bodycheck 0.1"
