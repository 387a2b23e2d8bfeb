"""The page of a history: the levels over the nightly runs, and the runs in which a value was worse."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from bodycheck.reports.history.acceptances import accept
from bodycheck.reports.history.archive import History
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.runs import nightly_run as nightly_run_module
from tests.helpers.gate_tables import with_tables
from tests.helpers.nightly_runs import scaled, slower, store_nightly_runs, unchanged

ERROR = "orientation_error_rad"


def series_in(folder: Path) -> dict[tuple[str, str, str, str], dict[str, Any]]:
    """Return the series of the page by method, scenario, measure and setting."""
    page = (folder / "trends.html").read_text(encoding="utf-8")
    data = json.loads(re.findall(r'id="data">(.*?)</script>', page, re.DOTALL)[0])
    return {(one["m"], one["s"], one["q"], one["f"]): one for one in data["series"]}


def with_step(run: Run, step_s: float) -> Run:
    """Return the run with this largest stable step of m1 in slow, and an order that is as much lower."""
    row = {"run_id": run.run_id, "scenario": "slow", "engine": "reference", "method": "m1", "outcome": "ok"}
    row |= {"family": "slow", "dt_stable_s": step_s, "dt_unstable_s": 1.01 * step_s}
    stability = pd.DataFrame([row], columns=list(run.stability.columns))
    methods = run.methods.copy()
    mine = (methods["scenario"] == "slow") & (methods["method"] == "m1") & (methods["quantity"] == ERROR)
    methods.loc[mine, ["order", "order_low", "order_high"]] *= step_s
    return with_tables(run, stability=stability, methods=methods)


@pytest.mark.slow
def test_levels_of_errors_orders_and_stable_steps_are_steps(nightly_run: Run, tmp_path: Path) -> None:
    """Worse in run 1, accepted after it, at that level in runs 2 and 3."""
    good, bad = with_step(nightly_run, 1.0), with_step(nightly_run, 0.5)
    store_nightly_runs(good, tmp_path, [unchanged])
    store_nightly_runs(bad, tmp_path, [scaled(1.5)], first=1)
    accept(History(tmp_path), run_id=None, ids=(), reason="meant", author="me")
    store_nightly_runs(bad, tmp_path, [scaled(1.5), scaled(1.5)], first=2)
    found = series_in(tmp_path)
    for quantity, setting in ((ERROR, "dt 0.01 s"), ("order", "orientation"), ("dt_stable_s", "step")):
        one = found["reference:m1", "slow", quantity, setting]
        (first, _, before), (second, runs, after) = one["v"]
        assert (first, second, runs) == (0, 1, 3)
        assert one["l"] == [[0, before], [2, after]]
        assert one["w"] == [1]
    other = found["reference:rk4", "slow", "order", "orientation"]
    assert other["l"] == [[0, other["v"][0][2]]]
    assert "w" not in other


@pytest.mark.slow
def test_level_of_a_time_is_the_median_of_its_runs(
    nightly_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Once speeds are judged; a slower engine is shaded, and its level stays until somebody accepts it."""
    monkeypatch.setattr(nightly_run_module, "report_pages", lambda _: ())

    def half_slower(results: pd.DataFrame) -> pd.DataFrame:
        mine = results["method"] == "rk4"
        return pd.concat([results[~mine], slower(results[mine].copy(), "reference", 1.5)]).sort_index()

    with monkeypatch.context() as patch:
        patch.setattr(nightly_run_module, "trends_page", lambda _: "")
        store_nightly_runs(nightly_run, tmp_path, [unchanged] * 11)
    store_nightly_runs(nightly_run, tmp_path, [unchanged], first=11)
    assert all("l" not in one for key, one in series_in(tmp_path).items() if key[2] == "relative_cpu")
    store_nightly_runs(nightly_run, tmp_path, [half_slower] * 5, first=12)
    time = ("reference:rk4", "slow", "relative_cpu", "dt 0.01 s")
    one = series_in(tmp_path)[time]
    before, after = (value for _, _, value in one["v"])
    assert (one["l"], one["w"]) == ([[0, before]], [16])
    accept(History(tmp_path), run_id=None, ids=(), reason="meant", author="me")
    store_nightly_runs(nightly_run, tmp_path, [half_slower], first=17)
    one = series_in(tmp_path)[time]
    assert (one["l"], one["w"]) == ([[0, before], [16, after]], [16])
