"""A night beside nights of a few cells: what is worse, what comes back, what is left out."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pandas as pd
import pytest
from gated import a_run

from bodycheck.reports.history import regression
from bodycheck.reports.history.regression import Judgement, judge_night
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.run_files.run_reader import Tables

ERROR = "orientation_error_rad"
COLUMNS = ["engine", "method", "scenario", "control", "dt_s", "tolerance", "relative_cpu", ERROR]


def tables(number: int, *cases: dict[str, Any], **parts: Any) -> Tables:
    """Return what one night found; one case, unless told otherwise."""
    made = a_run(list(cases or ({},)), **{"scenarios": {"brick": {}, "plate": {}}, **parts})
    return replace(made, run_id=f"night {number}")


def judged(*nights: Tables, monkeypatch: pytest.MonkeyPatch) -> Judgement:
    """Return what the last of these nights is beside the others, each judged when it came."""
    before: list[SimpleNamespace] = []
    for tonight in nights:
        found = judged_after(before, tonight, monkeypatch)
        levels = tuple(CaseResult(dict(row)) for row in found.accepted)
        before.insert(0, night_of(tonight, replace(tonight, cases=levels)))
    return found


def night_of(found: Tables, accepted: Tables) -> SimpleNamespace:
    """Return an earlier nightly run, with the levels accepted after it."""

    def same_scenarios(manifest: dict[str, Any]) -> set[str]:
        mine = found.manifest["scenarios"]
        return {name for name, about in mine.items() if manifest["scenarios"].get(name) == about}

    return SimpleNamespace(
        name=found.run_id,
        folder=Path(found.run_id),
        tables=found,
        accepted=accepted,
        same_scenarios=same_scenarios,
    )


def judged_after(
    before: list[SimpleNamespace], tonight: Tables, monkeypatch: pytest.MonkeyPatch
) -> Judgement:
    """Return the judgement of a nightly run against its baseline runs, newest first."""
    by_folder = {night.folder: night.tables for night in before}

    def recorded(folders: list[Path]) -> pd.DataFrame:
        found = [by_folder[one].results.assign(night=one.name) for one in folders]
        well = [cases.loc[cases["outcome"] == "ok", ["night", *COLUMNS]] for cases in found]
        return pd.concat(well) if well else pd.DataFrame(columns=["night", *COLUMNS])

    past = SimpleNamespace(nights=list(before))
    monkeypatch.setattr(regression, "past_of", lambda _, manifest: past if manifest else None)
    monkeypatch.setattr(regression, "recorded_cases", recorded)
    return judge_night(None, tonight)  # type: ignore[arg-type]


def told(found: Judgement) -> list[tuple[str, str, float | None]]:
    """Return kind, status and step of each change."""
    assert found.comparison is not None
    return [(one.kind, one.status, one.fineness) for one in found.comparison.changes]


FAILED = {"outcome": "failed", ERROR: None}
WORSE = {ERROR: 1e-6}


@pytest.mark.parametrize(
    ("nights", "status"),
    [
        ((tables(0),), "insufficient history"),
        ((tables(0), tables(1)), "no regression"),
        ((tables(0), tables(1, WORSE)), "regression"),
        ((tables(0, WORSE), tables(1)), "no regression"),
        ((tables(0), tables(1, FAILED)), "nothing measured"),
        ((tables(0), tables(1, FAILED, {"dt_s": 0.02})), "regression"),
        ((tables(0), tables(1, {"method": "euler"})), "insufficient history"),
        ((tables(0, {}, {"dt_s": 0.02}), tables(1)), "regression"),
        ((tables(0), tables(1, {}, {"dt_s": 0.02})), "no regression"),
        ((tables(0, {"omega_error": 1.0}), tables(1)), "regression"),
        ((tables(0), tables(1, {"omega_error": 1.0})), "no regression"),
    ],
)
def test_a_night_is_a_regression_where_anything_is_worse_or_lost(
    nights: tuple[Tables, ...], status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A case or a measure that is gone is worse; one that is new is not; nothing measured never passes."""
    found = judged(*nights, monkeypatch=monkeypatch)
    assert found.status == status
    assert found.tonight is nights[-1]
    assert (found.comparison is None) == (len(nights) == 1)


def test_what_comes_back_is_compared_with_the_last_night_on_which_it_ended_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """However long ago, each case with its own."""
    other = {"dt_s": 0.02}
    nights = [
        tables(0, {ERROR: 1e-3}, {**other, ERROR: 1e-3}),  # too long ago for either
        tables(1, {}, {**other, **FAILED}),
        tables(2, FAILED, {**other, ERROR: 1e-8}),
        tables(3, FAILED, {**other, **FAILED}),
        tables(4, WORSE, {**other, **WORSE}),
    ]
    found = judged(*nights, monkeypatch=monkeypatch)
    assert told(found) == [
        ("outcome", "improved", 0.01),
        ("outcome", "improved", 0.02),
        ("accuracy", "worse", 0.01),
        ("accuracy", "worse", 0.02),
    ]
    assert found.comparison is not None
    assert [one.before for one in found.comparison.changes[2:]] == [1e-9, 1e-8]


def creeping(*errors: float | None, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Return what was said of the error on each night after the first; None: the case failed."""
    nights = [tables(k, FAILED if error is None else {ERROR: error}, OTHER) for k, error in enumerate(errors)]
    found = []
    for place in range(1, len(nights)):
        changes = judged(*nights[: place + 1], monkeypatch=monkeypatch).comparison
        assert changes is not None
        found.append(" ".join(one.status for one in changes.changes if one.kind == "accuracy"))
    return found


OTHER = {"method": "euler"}  # a case that always ends well


@pytest.mark.parametrize(
    ("errors", "statuses"),
    [
        ((1.0, 1.01, 1.02, 1.03, 1.03), ["moved", "moved", "worse", ""]),
        ((1.0, 0.99, 0.98, 0.97, 0.96), ["moved", "improved", "moved", "improved"]),
        ((1.0, 1.01, 1.0, 1.01, 1.0), ["moved", "", "moved", ""]),
        ((1.0, 1.05, 1.04, 1.03, 1.02), ["worse", "moved", "moved", "improved"]),
        ((1.0, 1.01, None, 1.025, 1.025), ["moved", "", "worse", ""]),
        ((1.0, 1.0 + 1e-15, 1.0, 2.0, 1.0), ["", "", "worse", "improved"]),
    ],
)
def test_an_error_is_compared_with_its_accepted_level(
    errors: tuple[float | None, ...], statuses: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Small steps add up until they are reported; what was reported is the level; a crash changes none."""
    scaled = (error if error is None else 1e-3 * error for error in errors)
    assert creeping(*scaled, monkeypatch=monkeypatch) == statuses


def test_each_measure_has_its_own_level(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report of one leaves the others at theirs."""
    nights = [
        tables(k, {ERROR: 1e-3 * error, "omega_error": 1e-3 * omega})
        for k, (error, omega) in enumerate(((1.0, 1.0), (2.0, 1.015), (2.0, 1.03)))
    ]
    found = judged(*nights, monkeypatch=monkeypatch)
    assert found.comparison is not None
    assert [(one.quantity, one.status, one.before) for one in found.comparison.changes] == [
        ("omega_error", "worse", 1e-3)
    ]


def test_a_scenario_that_means_another_thing_begins_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """No level of the old one counts for the new one."""
    scenarios = {"brick": {"mass": 2.0}, "plate": {}}
    nights = [tables(0), tables(1, WORSE, scenarios=scenarios), tables(2, WORSE, scenarios=scenarios)]
    found = judged(*nights, monkeypatch=monkeypatch)
    assert told(found) == []
    assert [row[ERROR] for row in found.accepted] == [1e-6]


def test_another_version_of_an_engine_keeps_its_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    """`mujoco==3.16.0`, `mujoco==3.17.0`, then as it is installed: one engine, and one creeping error."""
    nights = [
        tables(k, {"engine": name, ERROR: 1e-3 * error})
        for k, (name, error) in enumerate(
            (("mujoco==3.16.0", 1.0), ("mujoco==3.17.0", 1.015), ("mujoco", 1.03))
        )
    ]
    assert told(judged(*nights, monkeypatch=monkeypatch)) == [("accuracy", "worse", 0.01)]


def test_speed_is_judged_by_all_nights_and_not_by_the_one_before(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half as slow again on five nights is one change, told once; on one night it is none."""
    timed = [
        {"relative_cpu": 1.0, "cpu_s_low": 1.0, "cpu_s": 1.0, "cpu_s_high": 1.0},
        {"relative_cpu": 1.5, "cpu_s_low": 1.5, "cpu_s": 1.5, "cpu_s_high": 1.5},
    ]
    usual = [tables(k, timed[0]) for k in range(8)]
    once = judged(*usual, tables(8, timed[1]), monkeypatch=monkeypatch)
    assert told(once) == []
    slow = judged(*usual, *(tables(k, timed[1]) for k in range(8, 13)), monkeypatch=monkeypatch)
    assert told(slow) == [("speed", "worse", None)]
    assert slow.status == "regression"
    assert slow.speeds.series.nights == tuple(f"night {k}" for k in range(13))


def test_the_errors_are_those_of_the_same_scenarios_that_ended_well(monkeypatch: pytest.MonkeyPatch) -> None:
    """The farthest of a method's cases, over the median of its nights, the oldest first."""
    plate = {"scenario": "plate", ERROR: 1e-5}
    nights = [tables(k, {}, {"dt_s": 0.02, ERROR: 1e-7}, plate) for k in range(3)]
    nights[0] = replace(
        nights[0], manifest={**nights[0].manifest, "scenarios": {"brick": {}, "plate": {"x": 1}}}
    )
    last = tables(3, {ERROR: 1e-8}, {"dt_s": 0.02, ERROR: 1e-9}, {**plate, "outcome": "failed"})
    found = judged(*nights, last, monkeypatch=monkeypatch)
    assert found.errors.nights == tuple(f"night {k}" for k in range(4))
    assert found.errors.methods == (("mujoco", "rk4"),)
    assert found.errors.decades[:, 0] == pytest.approx([0.0, 0.0, 0.0, -2.0])
    alone = judged(tables(0), monkeypatch=monkeypatch)
    assert alone.errors.nights == ("night 0",)
    assert math.isclose(alone.errors.decades[0, 0], 0.0)
    nothing = judged(tables(0, FAILED), monkeypatch=monkeypatch)
    assert nothing.errors.methods == ()
