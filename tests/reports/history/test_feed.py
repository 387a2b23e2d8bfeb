"""The Atom feed of regressions, and what the page of a nightly run links to."""

from __future__ import annotations

import re
from datetime import datetime
from pathlib import Path
from xml.etree import ElementTree as ET

import pandas as pd
import pytest

from bodycheck.reports.history.history_output import release_changes
from bodycheck.reports.history.nightly_files import feed
from bodycheck.reports.run_files.run_tables import Run
from tests.helpers.nightly_runs import store_nightly_runs, unchanged

ATOM = {"": "http://www.w3.org/2005/Atom"}


def worse(results: pd.DataFrame) -> pd.DataFrame:
    """Return the results with the errors of one method ten times as large."""
    results.loc[results["method"] == "m1", "orientation_error_rad"] *= 10.0
    return results


@pytest.mark.slow
def test_a_regression_is_an_entry_of_the_feed(nightly_run: Run, tmp_path: Path) -> None:
    """Only the run that regressed has an entry, which links to its page; a page links to earlier ones."""
    runs = store_nightly_runs(nightly_run, tmp_path, [unchanged, unchanged])
    root = ET.parse(tmp_path / "feed.xml").getroot()
    assert root.findall("entry", ATOM) == []
    (regressed,) = store_nightly_runs(nightly_run, tmp_path, [worse], first=2)
    assert regressed.status == "regression"
    root = ET.parse(tmp_path / "feed.xml").getroot()
    (entry,) = root.findall("entry", ATOM)
    run_id = regressed.newest.run_id
    assert entry.findtext("id", namespaces=ATOM) == f"urn:bodycheck:{run_id}"
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


def run(run_id: str, status: str) -> dict[str, object]:
    """Return the part of a night.json that the feed reads."""
    counts = {"worse": 2, "missing": 1, "cases": 7}
    return {"run_id": run_id, "status": status, "engines": "a 1 & <b> 2", "machine": "m", **counts}


def test_the_feed_has_what_atom_requires() -> None:
    """Feed and entries have id, title and a date with its zone; the newest entry comes first; ids differ."""
    runs = [run(f"202601{day:02d}T000000Z-000000", "regression") for day in (1, 2)]
    root = ET.fromstring(feed([*runs, run("20260103T000000Z-000000", "no regression")]))
    entries = root.findall("entry", ATOM)
    for element in (root, *entries):
        assert element.findtext("title", namespaces=ATOM)
        updated = datetime.fromisoformat(element.findtext("updated", "", ATOM))
        assert updated.tzinfo is not None
    assert [entry.findtext("updated", "", ATOM)[:10] for entry in entries] == ["2026-01-02", "2026-01-01"]
    assert len({element.findtext("id", "", ATOM) for element in (root, *entries)}) == 3
    assert entries[0].findtext("title", "", ATOM) == "2 worse, 1 no longer measured"
    assert root.findtext("author/name", "", ATOM)


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
