"""The Atom feed of regressions, and what the page of a nightly run links to."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree as ET

import pandas as pd
import pytest

from bodycheck.reports.comparison.change import Change
from bodycheck.reports.history.acceptances import Acceptance, Accepted
from bodycheck.reports.history.history_output import release_changes
from bodycheck.reports.history.levels import LevelSource
from bodycheck.reports.history.nightly_files import feed
from bodycheck.reports.history.open_regressions import NightlyState, Regression, open_lines
from bodycheck.reports.measurement.measures import ORIENTATION
from bodycheck.reports.run_files.run_tables import Run
from tests.helpers.nightly_runs import store_nightly_runs, unchanged

ATOM = {"": "http://www.w3.org/2005/Atom"}


def worse(results: pd.DataFrame) -> pd.DataFrame:
    """Return the results with the errors of one method ten times as large."""
    results.loc[results["method"] == "m1", "orientation_error_rad"] *= 10.0
    return results


def entries_of(feed: ET.Element) -> list[tuple[str, str]]:
    """Return date and title of each entry."""
    return [
        (entry.findtext("updated", "", ATOM)[:10], entry.findtext("title", "", ATOM))
        for entry in feed.findall("entry", ATOM)
    ]


@pytest.mark.slow
def test_a_regression_is_an_entry_of_the_feed(nightly_run: Run, tmp_path: Path) -> None:
    """The run that regressed has an entry, which links to its page; a page links to earlier ones."""
    runs = store_nightly_runs(nightly_run, tmp_path, [unchanged, unchanged])
    assert entries_of(ET.parse(tmp_path / "feed.xml").getroot()) == []
    (regressed,) = store_nightly_runs(nightly_run, tmp_path, [worse], first=2)
    assert regressed.status == "regression"
    (entry,) = ET.parse(tmp_path / "feed.xml").getroot().findall("entry", ATOM)
    run_id = regressed.newest.run_id
    assert entry.findtext("id", "", ATOM).startswith(f"urn:bodycheck:{run_id}:opened:")
    (link,) = entry.findall("link", ATOM)
    assert (tmp_path / link.attrib["href"]).read_text(encoding="utf-8").startswith("<!doctype html>")
    page = (tmp_path / run_id / "night.html").read_text(encoding="utf-8")
    links = re.findall(r'href="(\.\./[^"]+)"', page)
    pages = ("night.html", "report.html")
    assert links == [
        "../trends.html",
        "../feed.xml",
        *(f"../{run.newest.run_id}/{name}" for run in runs[::-1] for name in pages),
    ]
    assert all((tmp_path / run_id / link).exists() for link in links)
    trends = page[page.index('id="trends"') : page.index('id="earlier"')]
    assert re.search(r"m\d|rk4", trends)[0] == "m1"  # farthest from its median


def run(day: int, status: str = "no regression") -> dict[str, object]:
    """Return the part of a night.json that the feed reads."""
    counts = {"worse": 2, "missing": 1, "cases": 7}
    run_id = f"202601{day:02d}T000000Z-000000"
    return {"run_id": run_id, "status": status, "engines": "a 1 & <b> 2", "machine": "m", **counts}


def test_the_feed_has_what_atom_requires() -> None:
    """Feed and entries have id, title and a date with its zone; the newest entry comes first; ids differ.

    Runs of earlier versions, which did not store what is open, have an entry each.
    """
    runs = [run(1, "regression"), run(2, "regression"), run(3)]
    root = ET.fromstring(feed((one, NightlyState()) for one in runs))
    entries = root.findall("entry", ATOM)
    for element in (root, *entries):
        assert element.findtext("title", namespaces=ATOM)
        updated = datetime.fromisoformat(element.findtext("updated", "", ATOM))
        assert updated.tzinfo is not None
    title = "2 worse, 1 no longer measured"
    assert entries_of(root) == [("2026-01-02", title), ("2026-01-01", title)]
    assert len({element.findtext("id", "", ATOM) for element in (root, *entries)}) == 3
    assert root.findtext("author/name", "", ATOM)


def test_a_regression_has_one_entry_when_it_opens_and_one_when_it_ends() -> None:
    """A run in which it stays open has none; one that worsens again, is gone or is accepted has one."""
    first = run(1)["run_id"]
    change = Change("accuracy", "brick", "mujoco", "rk4", ORIENTATION, 1.0, 3.0, "worse", "dt", 0.01, 0.477)
    other_map = replace(change, kind="law", quantity="law boost", status="moved", decades=None)
    opened = Regression(change, first)
    still = replace(opened, runs=2, newly=False)
    again = replace(opened, runs=3, change=replace(change, decades=1.0))
    accepted = Acceptance(
        "ab12", "2026-01-05", "Ada", "meant", first, "m", (Accepted(change, {}, {}, LevelSource("", "")),)
    )
    states = [
        NightlyState((opened, Regression(other_map, first))),
        NightlyState((still,), closed=(Regression(other_map, first),)),
        NightlyState((again,)),
        NightlyState(closed=(replace(again, newly=False),)),
        NightlyState((opened,)),
        NightlyState(acceptances=("ab12",)),
        NightlyState(acceptances=("ab12",)),
    ]
    found = ET.fromstring(feed([(run(day + 1), one) for day, one in enumerate(states)], [accepted]))
    text = "mujoco:rk4: error at dt 0.01 s x {} in brick"
    assert entries_of(found) == [
        (
            "2026-01-06",
            f"Acceptance ab12: 1 value of mujoco:rk4 in {first}, accepted on 2026-01-05 by Ada: meant",
        ),
        ("2026-01-05", text.format(3)),
        (
            "2026-01-04",
            "mujoco:rk4: back at its level in brick; it was worse since 2026-01-01 (3 nightly runs)",
        ),
        ("2026-01-03", text.format(10)),
        ("2026-01-01", text.format(3)),
    ]
    assert len({entry.findtext("id", "", ATOM) for entry in found.findall("entry", ATOM)}) == 5


def test_what_is_newly_worse_comes_before_what_is_more_severe() -> None:
    """Whatever was reported the night before, the new regression is the first line."""
    change = Change("accuracy", "brick", "mujoco", "rk4", ORIENTATION, 1.0, 3.0, "worse", "dt", 0.01, 0.477)
    failed = replace(change, kind="outcome", method="euler", quantity="outcome", decades=None)
    known = Regression(failed, run(0)["run_id"], newly=False)
    new = Regression(change, run(1)["run_id"])
    for regressions in ([known, new], [new, known]):
        assert [one.newly for one in open_lines(regressions)] == [True, False]
    both = open_lines([new, replace(known, newly=True)])
    assert [one.line.methods for one in both] == [("euler",), ("rk4",)]


@pytest.mark.parametrize(
    ("versions", "changes"),
    [
        (["1", "1", "1"], []),
        (["1", None, "2", "2"], [(2, "1 -> 2")]),
        ([None, "1", "2", None, "1"], [(2, "1 -> 2"), (4, "2 -> 1")]),
        ([], []),
    ],
)
def test_a_release_is_marked_where_the_version_changes(
    versions: list[str | None], changes: list[tuple[int, str]]
) -> None:
    """A run without the engine does not count as a change."""
    assert release_changes(versions) == changes
