"""The report of a large run: linked pages of limited size, with as many motions as can be read soon."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from urllib.parse import unquote, urljoin, urlsplit

import pytest
from jinja2 import ChoiceLoader, DictLoader, PackageLoader
from markupsafe import escape
from playwright.sync_api import Browser, Error, expect

from bodycheck._util.errors import InputError
from bodycheck.reports import templating
from bodycheck.reports.history.archive import History
from bodycheck.reports.history.baseline import check_files, read_summary
from bodycheck.reports.measurement.case import CaseResult, MeasuredMotion
from bodycheck.reports.render import html as report
from bodycheck.reports.render.page.scenario_section import anchor_of
from bodycheck.reports.run_files.report_files import replace_pages, write_pages
from bodycheck.reports.run_files.run_tables import Run, key_of
from tests.helpers.copied_scenarios import with_scenarios
from tests.helpers.expected_messages import ExpectedMessage
from tests.helpers.html_page import Page
from tests.helpers.nightly_runs import as_nightly_run, store_nightly_runs, unchanged

LONG_MS = 120_000
FIRST = "report.html"


def grown(run: Run, scenarios: int) -> Run:
    """Return the run with the first of its scenarios repeated under other names."""
    problem = run.problems[0]
    old = problem.scenario.name
    names = [f"copy-{k}" for k in range(scenarios)]

    def named(case: CaseResult, name: str) -> CaseResult:
        return replace(case, columns={**case.columns, "scenario": name})

    own = [case for case in run.cases if case.columns["scenario"] == old]
    problems = [
        replace(problem, scenario=problem.scenario.model_copy(update={"name": name})) for name in names
    ]
    studies = {
        table: [
            {**row, "scenario": name} for name in names for row in run.rows(table) if row["scenario"] == old
        ]
        for table in ("methods", "stability")
    }
    return replace(
        run.with_rows(**studies),
        problems=tuple(problems),
        cases=tuple(named(case, name) for name in names for case in own),
        manifest=with_scenarios(run, problems),
    )


@pytest.fixture
def one_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give every scenario a page of its own."""
    monkeypatch.setattr(report, "_ONE_PAGE", 1)
    monkeypatch.setattr(report, "_NEXT_PAGES", 1)


def links_of(page: Page) -> Iterator[str]:
    """Yield the addresses of the links to pages of the report."""
    for tag, attributes in page.tags:
        if tag == "a" and not attributes["href"].startswith("http"):
            yield attributes["href"]


@pytest.mark.usefixtures("one_each")
def test_every_link_of_every_page_leads_to_its_place(run: Run) -> None:
    """Each scenario is on one page; the map, the findings and the pages link to ids that exist there."""
    pages = dict(report.report_pages(run, "a & b?.html"))
    assert list(pages) == ["a & b?-files/1.html", "a & b?-files/2.html", "a & b?.html"]
    parsed = {path: Page(text) for path, text in pages.items()}
    ids = {
        path: {attributes["id"] for _, attributes in page.tags if "id" in attributes}
        for path, page in parsed.items()
    }
    followed = set()
    for path, page in parsed.items():
        for link in links_of(page):
            target = urlsplit(urljoin(f"file:///{path.replace('?', '%3F')}", link))
            there = unquote(target.path).removeprefix("/")
            assert not target.fragment or target.fragment in ids[there], link
            followed.add((there, target.fragment))
    sections = [anchor_of(problem.scenario.name) for problem in run.problems]
    for number, section in enumerate(sections, 1):
        holders = [path for path in pages if section in ids[path]]
        assert holders == [f"a & b?-files/{number}.html"]
        assert (holders[0], section) in followed
    for case in run.cases:
        cell = anchor_of(case.columns["scenario"], key_of(case.columns))
        assert [fragment for _, fragment in followed].count(cell) == 1


def test_a_small_run_has_one_page(run: Run) -> None:
    """It needs no other file."""
    assert [path for path, _ in report.report_pages(run)] == [FIRST]


@pytest.mark.usefixtures("one_each")
def test_a_new_section_of_the_report_is_a_template_and_its_place(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its template reads the run; it stands where report.html includes it, on the first page alone."""
    loader = templating.environment().loader
    assert isinstance(loader, PackageLoader)
    text, _, _ = loader.get_source(templating.environment(), "report.html")
    place = '{% include "overall.html" %}'
    assert text.count(place) == 1
    added = {
        "report.html": text.replace(place, place + '\n{% include "engines.html" %}'),
        "engines.html": "<section><h2>Engines</h2>{{ run.manifest.engines | join }}</section>",
    }
    changed = templating.environment().overlay(loader=ChoiceLoader([DictLoader(added), loader]))
    monkeypatch.setattr(templating, "environment", lambda: changed)
    *further, first = (text for _, text in report.report_pages(run))
    found = re.search(r'id="overall".*<h2>Engines</h2>(.*?)</section>.*id="scenarios"', first, re.DOTALL)
    assert found is not None
    assert found[1] == escape("".join(run.manifest["engines"]))
    assert further
    assert not any("<h2>Engines</h2>" in text for text in further)


@pytest.mark.nightly
def test_pages_have_a_limited_size(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """No page exceeds the limit by more than what all pages have; scenarios are in the order of the run."""
    monkeypatch.setattr(report, "_ONE_PAGE", 2_000_000)
    monkeypatch.setattr(report, "_NEXT_PAGES", 1_000_000)
    monkeypatch.setattr(report, "_MOST_CELLS", 5)
    large = grown(run, 60)
    pages = dict(report.report_pages(large))
    shared = len(dict(report.report_pages(grown(run, 1)))[FIRST].encode())
    assert len(pages) > 3
    assert all(len(text.encode()) < 1_000_000 + shared for text in pages.values())
    found = [re.findall(r'<section class="scenario" id="scenario-([^"]*)"', text) for text in pages.values()]
    assert [name for names in found for name in names] == [one.scenario.name for one in large.problems]
    assert found[-1] == []


def test_only_some_motions_are_read_for_a_large_run(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """Motions of other scenarios are not read; their sections name the commands that draw them."""
    monkeypatch.setattr(report, "_MOST_TRACKS", 2)
    read: list[str] = []

    def lazy(case: CaseResult) -> CaseResult:
        def motion() -> MeasuredMotion:
            read.append(case.columns["scenario"])
            return MeasuredMotion(case.trajectory, case.series, case.departures, case.floors)

        return replace(case, motion=motion)

    large = grown(run, 12)
    large = replace(large, cases=tuple(map(lazy, large.cases)))
    ((_, page),) = report.report_pages(large)
    assert set(read) == {"copy-0"}
    assert page.count("data-motion ") == 1
    assert page.count('data-plot="drift"') == 1
    assert re.sub("<[^>]+>", "", page).count("bodycheck movie RUN --scenario copy-") == 11


def test_long_tables_of_cases_end_with_the_number_of_all(run: Run, monkeypatch: pytest.MonkeyPatch) -> None:
    """The first rows are on the page; results.csv has the others."""
    monkeypatch.setattr(report, "_MOST_ROWS", 1)
    ((_, text),) = report.report_pages(run)
    assert all(len(table.rows) == 2 for table in Page(text).with_class("cases"))
    most = max(
        sum(key_of(one.columns) == key_of(case.columns) for one in run.cases) // 2 for case in run.cases
    )
    assert f"The first 1 of {most} cases" in text


def pages_of(text: str, parts: int) -> Iterator[tuple[str, str]]:
    """Yield a first page and further ones."""
    for number in range(1, parts + 1):
        yield f"report-files/{number}.html", f"<title>bodycheck {text}</title>"
    yield FIRST, text


def files_in(folder: Path) -> dict[str, str]:
    """Return the content of all files, hidden ones included."""
    return {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*") if path.is_file()}


def test_a_report_replaces_all_pages_of_the_former_one(tmp_path: Path) -> None:
    """No page of the former report is left, and nothing else is there."""
    write_pages(pages_of("old", 3), tmp_path)
    for parts in (2, 0, 1):
        replace_pages(pages_of("new", parts), tmp_path / FIRST)
        assert files_in(tmp_path) == dict(pages_of("new", parts))


def test_a_report_that_fails_leaves_the_former_one(tmp_path: Path) -> None:
    """All pages are made before any is replaced."""

    def failing() -> Iterator[tuple[str, str]]:
        yield from list(pages_of("new", 2))[:2]
        raise InputError("no motion")

    write_pages(pages_of("old", 3), tmp_path)
    with pytest.raises(InputError, match="no motion"):
        replace_pages(failing(), tmp_path / FIRST)
    assert files_in(tmp_path) == dict(pages_of("old", 3))


@pytest.mark.parametrize("name", ["notes.txt", "1.html"])
def test_a_folder_of_other_files_is_not_replaced(
    name: str, tmp_path: Path, expected_message: ExpectedMessage, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file of the user stays, even if it is named like a page."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "report-files").mkdir()
    (tmp_path / "report-files" / name).write_text("mine")
    with expected_message.raises(InputError):
        replace_pages(pages_of("new", 1), Path(FIRST))
    assert files_in(tmp_path) == {f"report-files/{name}": "mine"}
    replace_pages(pages_of("new", 0), Path(FIRST))
    assert files_in(tmp_path) == {f"report-files/{name}": "mine", FIRST: "new"}


@pytest.mark.slow
@pytest.mark.usefixtures("one_each")
def test_a_nightly_run_has_all_pages_of_its_report(run: Run, tmp_path: Path) -> None:
    """They are sealed with the run, so that a changed one is found, and removed with it."""
    history = History.at(tmp_path)
    store_nightly_runs(as_nightly_run(run, 1), tmp_path, [unchanged, unchanged])
    first, second = history.runs()
    pages = [f"report-files/{number}.html" for number in range(1, len(run.problems) + 1)]
    assert all((first / page).is_file() for page in pages)
    summary = read_summary(first)
    assert set(pages) <= summary["sha256"].keys()
    check_files(first, summary)
    (first / pages[0]).write_text("other")
    with pytest.raises(InputError, match=re.escape(pages[0])):
        check_files(first, summary)
    history.prune(1)
    assert [entry for entry in tmp_path.iterdir() if entry.name.startswith(first.name)] == []
    assert (second / pages[0]).is_file()


@pytest.mark.nightly
@pytest.mark.usefixtures("one_each")
def test_pages_open_one_another_in_a_browser(run: Run, chromium: Browser, tmp_path: Path) -> None:
    """A cell of the map opens its part on its page, with the error chosen before."""
    write_pages(report.report_pages(run), tmp_path)
    page = chromium.new_page(viewport={"width": 1200, "height": 800})
    page.set_default_timeout(LONG_MS)
    errors: list[Error] = []
    page.on("pageerror", lambda error: errors.append(error))
    page.goto((tmp_path / FIRST).as_uri())
    page.locator("#error").fill("5")
    page.locator("#heat tbody tr").nth(1).locator("td a").first.click()
    expect(page.locator("nav.pages")).to_be_visible()
    assert page.url.split("#")[0].endswith("report-files/2.html")
    expect(page.locator("#error")).to_have_value("5", timeout=LONG_MS)
    anchor = unquote(page.url.split("#")[1].split("?")[0])
    assert anchor.startswith("cell-")
    assert page.evaluate("id => document.getElementById(id).open", page.url.split("#")[1].split("?")[0])
    page.locator("[data-plot=error]").first.scroll_into_view_if_needed()
    expect(page.locator("[data-plot=error][data-drawn]").first).to_be_attached()
    page.locator("nav.pages a[rel=prev]").click()
    expect(page.locator("h1")).to_contain_text(run.problems[0].scenario.name)
    expect(page.locator("#error")).to_have_value("5", timeout=LONG_MS)  # its scripts have run
    page.locator("nav.pages a[rel=up]").click()
    expect(page.locator("#overall")).to_be_attached()
    expect(page.locator("#error")).to_have_value("5", timeout=LONG_MS)
    assert errors == []
    page.close()
