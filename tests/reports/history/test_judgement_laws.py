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

from bodycheck.errors import InputError
from bodycheck.reports.history import judgement
from bodycheck.reports.history.judgement import Judgement, judge_night
from bodycheck.reports.stored import Tables

ERROR = "orientation_error_rad"
COLUMNS = ["engine", "method", "scenario", "control", "dt_s", "tolerance", "relative_cpu", ERROR]


def tables(number: int, *cases: dict[str, Any], **parts: Any) -> Tables:
    """Return what one night found; one case, unless told otherwise."""
    made = a_run(list(cases or ({},)), **{"scenarios": {"brick": {}, "plate": {}}, **parts})
    return replace(made, run_id=f"night {number}")


def judged(*nights: Tables, monkeypatch: pytest.MonkeyPatch, damaged: tuple[str, ...] = ()) -> Judgement:
    """Return what the last of these nights is beside the others; damaged ones cannot be read whole."""

    class Night(SimpleNamespace):
        @property
        def tables(self) -> Tables:
            if self.name in damaged:
                raise InputError(f"{self.name} is damaged")
            return self.found

        def same_scenarios(self, manifest: dict[str, Any]) -> set[str]:
            mine = self.found.manifest["scenarios"]
            return {name for name, about in mine.items() if manifest["scenarios"].get(name) == about}

    *past, tonight = nights
    made = [Night(name=one.run_id, folder=Path(one.run_id), found=one) for one in past[::-1]]
    by_folder = {night.folder: night.found for night in made}

    def recorded(folders: list[Path]) -> pd.DataFrame:
        found = [by_folder[one].results.assign(night=one.name) for one in folders]
        well = [cases.loc[cases["outcome"] == "ok", ["night", *COLUMNS]] for cases in found]
        return pd.concat(well) if well else pd.DataFrame(columns=["night", *COLUMNS])

    monkeypatch.setattr(judgement, "past_of", lambda _, manifest: SimpleNamespace(nights=made, of=manifest))
    monkeypatch.setattr(judgement, "recorded_cases", recorded)
    return judge_night(None, tonight)  # type: ignore[arg-type]


def told(found: Judgement) -> list[tuple[str, str, float | None]]:
    """Return kind, direction and step of each change."""
    assert found.comparison is not None
    return [(one.kind, one.direction, one.fineness) for one in found.comparison.changes]


FAILED = {"outcome": "failed", ERROR: None}
WORSE = {ERROR: 1e-6}


@pytest.mark.parametrize(
    ("nights", "status"),
    [
        ((tables(0),), "past too thin"),
        ((tables(0), tables(1)), "no regression"),
        ((tables(0), tables(1, WORSE)), "regression"),
        ((tables(0, WORSE), tables(1)), "no regression"),
        ((tables(0), tables(1, FAILED)), "nothing measured"),
        ((tables(0), tables(1, FAILED, {"dt_s": 0.02})), "regression"),
        ((tables(0), tables(1, {"method": "euler"})), "past too thin"),
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
    """However long ago, each case with its own; a night that is damaged is passed over."""
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
        ("outcome", "better", 0.01),
        ("outcome", "better", 0.02),
        ("accuracy", "worse", 0.01),
        ("accuracy", "worse", 0.02),
    ]
    assert found.comparison is not None
    assert [one.before for one in found.comparison.changes[2:]] == [1e-9, 1e-8]
    passed_over = judged(*nights, monkeypatch=monkeypatch, damaged=("night 1",))
    assert ("accuracy", "better", 0.01) in told(passed_over)


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
