"""The tables of the page are complete and equal those of the run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bodycheck._util.formatting import number
from bodycheck.reports.measurement.case import CaseResult
from bodycheck.reports.measurement.verdicts import STATES
from bodycheck.reports.render.page.cheapest_settings import TOLERANCES, CheapestSettings
from bodycheck.reports.render.page.cost_at_accuracy import ERRORS, TARGETS
from bodycheck.reports.render.page.scenario_section import anchor_of, limit_of
from bodycheck.reports.run_files.run_tables import Run
from bodycheck.reports.summary.cells import summary_cells
from bodycheck.reports.summary.sentences import Summary
from tests.helpers.copied_scenarios import with_scenarios
from tests.helpers.html_page import Page, report_page
from tests.helpers.markup_run import HOSTILE, METHODS

pytestmark = pytest.mark.slow


def test_the_page_holds_together(page: Page) -> None:
    """Tags balance, ids are unique, internal links have targets, and tables have captions and scopes."""
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    for _, attributes in page.tags:
        for key in ("aria-labelledby", "href"):
            if key in attributes:
                assert attributes[key].removeprefix("#") in ids
    kinds = [tag for tag, _ in page.tags]
    assert kinds.count("caption") == kinds.count("table") == len(page.tables)
    assert all("scope" in attributes for tag, attributes in page.tags if tag == "th")


def same(shown: str, stored: Any, digits: int = 4) -> bool:
    """Return whether a shown number equals the stored one to so many digits; "" is a missing value."""
    if shown == "":
        return bool(pd.isna(stored))
    return float(shown) == float(f"{stored:.{digits}g}")


def fineness_of(row: Any) -> float:
    """Return the step or the tolerance of a row of the results, NaN where it has neither."""
    return float(row["tolerance"] if pd.isna(row["dt_s"]) else row["dt_s"])


def is_fineness(shown: str, row: Any) -> bool:
    """Return whether a step or a tolerance is shown as exactly the stored double."""
    fineness = fineness_of(row)
    return bool(np.isnan(fineness)) if shown == "" else float(shown) == fineness


def test_every_number_of_the_case_tables_is_that_of_the_results(page: Page, run: Run) -> None:
    """Row by row the tables repeat results.csv: case, outcome, message, command, and each number shown."""
    shown = [(table.place, record) for table in page.with_class("cases") for record in table.records()]
    stored = run.results.to_dict("records")
    assert len(shown) == len(stored)
    for (place, record), row in zip(shown, stored, strict=True):
        assert place == anchor_of(row["scenario"], (row["engine"], row["method"]))
        assert record.pop("outcome") == row["outcome"]
        assert record.pop("message") == row["message"]
        assert record.pop("reproduce") == row["reproduce"]
        assert is_fineness(record.pop("dt_s or tolerance"), row)
        assert {"orientation_error_rad", "energy_drift", "cpu_s"} <= record.keys()
        for column, text in record.items():
            assert same(text, row[column]), f"{column}: {text} is not {row[column]!r}"


def test_every_number_of_the_order_tables_is_that_of_the_methods(page: Page, run: Run) -> None:
    """Row by row the tables repeat methods.csv: quantity, verdict, order with interval, points, floor."""
    shown = [(table.place, record) for table in page.with_class("orders") for record in table.records()]
    stored = run.methods.to_dict("records")
    assert len(shown) == len(stored)
    for (place, record), row in zip(shown, stored, strict=True):
        assert place == anchor_of(row["scenario"], (row["engine"], row["method"]))
        for column, text in record.items():
            assert text == row[column] if isinstance(row[column], str) else same(text, row[column])


def rows_of(table: pd.DataFrame, scenario: str, engine: str, method: str) -> pd.DataFrame:
    """Return the rows of one method on one scenario."""
    who = (table["scenario"] == scenario) & (table["engine"] == engine) & (table["method"] == method)
    return table[who]


def standing_rows(page: Page, run: Run) -> Iterator[tuple[str, str, str, dict[str, str]]]:
    """Yield scenario, engine, method and record of every row of the tables of methods."""
    for table, problem in zip(page.with_class("standing"), run.problems, strict=True):
        for record in table.records():
            engine, method = record.pop("engine:method").rsplit(":", 1)
            yield problem.scenario.name, engine, method, record


def test_the_methods_of_a_scenario_stand_as_in_the_tables(page: Page, run: Run) -> None:
    """Each row shows the stored verdict, order, and measures at the common step."""
    verdicts = run.methods[run.methods["quantity"] == "orientation_error_rad"]
    seen = 0
    for scenario, engine, method, record in standing_rows(page, run):
        own = rows_of(run.results, scenario, engine, method)
        found = rows_of(verdicts, scenario, engine, method)
        verdict, order = record.pop("verdict"), record.pop("order")
        record.pop("problems")
        growing = rows_of(run.methods, scenario, engine, method).set_index("quantity")["growth"].dropna()
        for quantity in ("energy_drift", "angular_momentum_drift"):
            grows = record.pop(f"{quantity} growth", "")
            assert grows.partition(",")[0] == growing.get(quantity, "")
        if own["outcome"].eq("ok").any() and len(found):
            assert STATES[found["verdict"].item()].word in verdict
            assert order == ("" if np.isnan(found["order"].item()) else f"{found['order'].item():.2f}")
        compared = own[own["dt_s"].isna() | (own["dt_s"] == 0.005)]
        for row in compared.sort_values("tolerance").head(1).to_dict("records"):
            seen += 1
            for column, text in record.items():
                assert same(text, row[column]), f"{method}: {column}: {text} is not {row[column]!r}"
    assert seen > 2 * 12


def test_methods_requested_by_name_are_shown(run: Run) -> None:
    """Of the reference's methods only those that nobody named are folded."""
    asked = {"engines": ["reference:euler", HOSTILE]}
    text = report_page(replace(run, manifest={**run.manifest, "request": asked}))
    rows = re.findall(
        r'<tr( class="of-reference")?><th scope="row"><a href="[^"]*">reference:<wbr>(.*?)</a>', text
    )
    assert {name for folded, name in rows if not folded} == {"euler"}
    assert {name for folded, name in rows if folded} == {*METHODS} - {"euler"}


def test_the_heat_map_has_every_cell_with_its_most_severe_verdict(page: Page, run: Run) -> None:
    """Rows are scenarios, columns methods; a cell has the most severe state, the order and a link."""
    cells = summary_cells(run)
    (heat,) = page.with_class("heat collapsed")
    begin = next(i for i, (tag, a) in enumerate(page.tags) if tag == "table" and a.get("id") == "heat")
    hrefs = (a.get("href", "") for tag, a in page.tags[begin:] if tag == "a")
    links = (href for href in hrefs if href.startswith("#cell-"))
    keys = [tuple(a["title"].rsplit(":", 1)) for tag, a in page.tags[begin:] if tag == "th" and "title" in a]
    keys = keys[: len(heat.rows[1])]
    assert heat.rows[1] == [method for _, method in keys]
    assert heat.rows[0][1:] == list(dict.fromkeys(engine for engine, _ in keys))
    assert [row[0] for row in heat.rows[2:]] == list(cells)
    for scenario, *marks in heat.rows[2:]:
        for (engine, method), mark in zip(keys, marks, strict=True):
            cell = cells[scenario][engine, method]
            state = STATES[cell.state]
            order = "" if cell.order is None else f" {cell.order:.1f}"
            assert mark == f"{state.symbol}{state.word}{order}"
            assert next(links) == f"#{anchor_of(scenario, (engine, method))}"


def meeting_tolerance(results: pd.DataFrame, error: str, target: float) -> pd.DataFrame:
    """Return the timed cases that meet an error tolerance."""
    return results[results["outcome"].eq("ok") & results["cpu_s"].notna() & (results[error] <= target)]


def test_the_cheapest_cases_are_those_of_the_results(page: Page, run: Run) -> None:
    """For each decade of each error the fastest case that meets it is named, with and without reference."""
    tables = page.with_class("cheapest")
    assert [table.error for table in tables] == [*ERRORS] * len(run.problems)
    rows = 0
    for place, table in enumerate(tables):
        scenario = run.problems[place // len(ERRORS)].scenario.name
        own = run.results[run.results["scenario"] == scenario]
        for target, *shown in table.rows[1:]:
            rows += 1
            for (who, fineness, cpu_s), some in zip(
                (shown[:3], shown[3:]), (own, own[own["engine"] != "reference"]), strict=True
            ):
                meeting = meeting_tolerance(some, table.error, float(target))
                if meeting.empty:
                    assert who == "none"
                    continue
                fastest = meeting[meeting["cpu_s"] == meeting["cpu_s"].min()].to_dict("records")
                named = [row for row in fastest if who == f"{row['engine']}:{row['method']}"]
                assert any(is_fineness(fineness, row) and same(cpu_s, row["cpu_s"]) for row in named)
        least = own.loc[own["outcome"].eq("ok") & own["cpu_s"].notna(), table.error].min()
        assert len(table.rows) - 1 >= sum(least <= target for target in TARGETS if target > 1e-12)
    assert rows > 50


def test_an_engine_that_misses_the_error_says_by_how_much(run: Run) -> None:
    """If no measured setting meets the tolerance, the row has the smallest error and where it occurs."""
    cases = tuple(case for case in run.cases if case.columns["method"] != "sound" or case.dt_s == 0.05)
    rows = CheapestSettings(replace(run, cases=cases)).rows
    own = run.results[(run.results["method"] == "sound") & (run.results["dt_s"] == 0.05)]
    errors = own.set_index("scenario")["orientation_error_rad"] + own.set_index("scenario")["truth_bound_rad"]
    worst = str(errors.idxmax())
    for place, scenario in enumerate((worst, *errors.index)):
        for tolerance, found in zip(TOLERANCES, rows[place], strict=True):
            row = next(row for row in found if row["engine"] == "<script>alert(1)</script>")
            if errors[scenario] <= tolerance:
                assert row["method"] == "sound"
                assert same(row["error"], errors[scenario], 3)
            else:
                smallest = f"smallest measured error {number(errors[scenario], 3)} rad"
                assert row["missed"] == f"{smallest} (sound, limited by {scenario})"


def median_costs(results: pd.DataFrame, error: str, target: float) -> pd.DataFrame:
    """Return the median CPU time per simulated second of each method, infinite where it misses the error."""
    timed = results[results["outcome"] != "unsupported"].assign(
        seconds=results["cpu_s"] / results["duration_s"]
    )
    timed.loc[~(timed["outcome"].eq("ok") & (timed[error] <= target)), "seconds"] = np.inf
    least = timed.fillna({"seconds": np.inf}).groupby(["engine", "method", "scenario"])["seconds"].min()
    of_method = least.groupby(["engine", "method"])
    median = of_method.quantile(0.5, interpolation="higher")
    return pd.DataFrame(
        {"median": median, "kept": of_method.apply(lambda s: np.isfinite(s).sum())}
    ).reset_index()


def at_several_speeds(run: Run) -> Run:
    """Return a run with four copies of its first scenario, with different processor times."""
    free, problems, cases = run.problems[0], [], []
    for copy, factor in enumerate((1.0, 7.0, 0.3, 50.0)):
        name = f"copy-{copy}"
        problems.append(replace(free, scenario=free.scenario.model_copy(update={"name": name})))
        for case in run.cases:
            if case.columns["scenario"] == free.scenario.name:
                columns = {**case.columns, "scenario": name}
                if "cpu_s" in columns:
                    columns["cpu_s"] *= factor
                cases.append(replace(case, columns=columns))
    return replace(
        run.with_rows(methods=[], stability=[]),
        manifest=with_scenarios(run, problems),
        problems=tuple(problems),
        cases=tuple(cases),
    )


def test_the_front_is_that_of_the_results(run: Run) -> None:
    """For each decade the named method has the least median cost; the scenarios that meet it are counted."""
    run = at_several_speeds(run)
    tables = Page(report_page(run)).with_class("fronts")
    assert [table.error for table in tables] == [*ERRORS]
    for table in tables:
        assert len(table.rows) > 5
        for target, *shown in table.rows[1:]:
            found = median_costs(run.results, table.error, float(target))
            for (who, seconds, best_cases), some in zip(
                (shown[:3], shown[3:]), (found, found[found["engine"] != "reference"]), strict=True
            ):
                least = some["median"].min()
                if np.isinf(least):
                    assert who == "none"
                    continue
                assert same(seconds, least, 3)
                fastest = some[some["median"] == least].to_dict("records")
                named = [row for row in fastest if who == f"{row['engine']}:{row['method']}"]
                assert any(best_cases.startswith(f"{row['kept']} of ") for row in named)


def test_the_stability_map_is_that_of_the_table(page: Page, run: Run) -> None:
    """Each mark has the largest stable step of stability.csv; a pair without a row there has no mark."""
    (limits,) = page.with_class("heat limits")
    keys = list(dict.fromkeys((case.columns["engine"], case.columns["method"]) for case in run.cases))
    keys.sort(key=lambda key: key[0] == "reference")
    assert limits.rows[1] == [method for _, method in keys]
    marks = {
        (scenario, *key): mark
        for scenario, *row in limits.rows[2:]
        for key, mark in zip(keys, row, strict=True)
    }
    searched = run.stability[run.stability["outcome"] == "ok"]
    assert len(searched) > 10
    for row in searched.to_dict("records"):
        mark = marks.pop((row["scenario"], row["engine"], row["method"]))
        assert mark.startswith("≥ ") == bool(np.isnan(row["dt_unstable_s"]))
        assert same(mark.removeprefix("≥ ").replace("none", ""), row["dt_stable_s"], 3)
    for row in run.stability[run.stability["outcome"] != "ok"].to_dict("records"):
        assert marks.pop((row["scenario"], row["engine"], row["method"])) == STATES[row["outcome"]].symbol
    assert set(marks.values()) == {""}


@pytest.mark.parametrize(
    ("changes", "mark", "tint", "words"),
    [
        ({}, "0.123", "open", "stable up to dt = 0.123 s, not at 0.125 s: it spins up"),
        ({"dt_unstable_s": None}, "≥ 0.123", "good", "where the search ended"),
        ({"dt_stable_s": None}, "none", "bad", "unstable at every step tried: it spins up"),
        ({"outcome": "timeout", "message": "too late"}, "!", "fault", "timeout: too late"),
    ],
)
def test_a_limit_says_how_far_a_method_is_stable(
    changes: dict[str, Any], mark: str, tint: str, words: str
) -> None:
    """The search found a limit, ended without one, found no stable step, or failed."""
    row = {"dt_stable_s": 0.1234, "dt_unstable_s": 0.1246, "reason": "it spins up", "outcome": "ok"}
    limit = limit_of(row | changes)
    assert (limit.mark, limit.tint) == (mark, tint)
    assert words in limit.sentence
    assert limit_of(None).mark == ""


def test_what_went_wrong_is_never_hidden(page: Page, run: Run) -> None:
    """Outcomes are counted; failed, invalid, unstable, unsupported and absent are listed with reasons."""
    for outcome, amount in run.manifest["outcomes"].items():
        assert f"{amount} {outcome}" in page.text
    (heat,) = page.with_class("heat collapsed")
    for column, head in enumerate(heat.rows[0]):
        for word in ("failed", "invalid", "unstable", "unsupported"):
            if word in head:
                assert all(STATES[word].word in row[column] for row in heat.rows[1:])
    (faults,) = page.with_class("faults")
    stored = run.results[~run.results["outcome"].isin(["ok", "unsupported"])]
    assert {row[-1] for row in faults.rows[1:]} == set(stored["message"])
    assert sum(len(row[2].split(", ")) for row in faults.rows[1:]) == len(stored)
    assert set(stored["outcome"]) == {"failed", "invalid", "unstable"}
    assert "absent cannot be imported: <tt>no module</tt>" in page.text
    reported = " ".join(Summary.of(run).sentences)
    assert all(word in reported for word in ("failed", "invalid", "unstable"))


def test_what_an_engine_read_back_stands_in_its_cell(html: str, run: Run) -> None:
    """The details of a cell show what the engine holds, even if it differs from what was given."""
    parts = html.split('<details class="cell" ')[1:]
    methods = run.results.groupby(["scenario", "engine", "method"], sort=False)["outcome"].agg(set)
    for part, outcomes in zip(parts, methods, strict=True):
        if outcomes & {"ok", "invalid"}:
            assert f"<dt>Mass</dt><dd>{3 if 'invalid' in outcomes else 1} kg</dd>" in part
        else:
            assert ("Nothing was read back from the engine." in part) == ("unstable" not in outcomes)


def test_a_run_without_speed_says_so(run: Run) -> None:
    """If no processor time was measured, a sentence replaces the plots."""
    cases = tuple(
        CaseResult({k: v for k, v in case.columns.items() if not k.startswith("cpu_")}, case.motion)
        for case in run.cases
    )
    page = Page(report_page(replace(run, cases=cases)))
    assert page.text.count("CPU time was not measured.") == len(run.problems) + 1
    assert not {"speed", "overall"} & {attributes.get("data-plot") for _, attributes in page.tags}
    assert not page.with_class("fronts")


def test_a_coarse_clock_that_measures_nothing_leaves_the_page(run: Run) -> None:
    """Cases whose processor time is 0 are shown, without a speed."""
    clock = {"cpu_s": 0.0, "cpu_s_low": 0.0, "cpu_s_high": 0.0}
    cases = tuple(replace(case, columns={**case.columns, **clock}) for case in run.cases)
    found = re.findall(r'"met":\[([^\]]*)\]', report_page(replace(run, cases=cases)))
    assert {speed for row in found for speed in row.split(",")} == {"0.0", "null"}
