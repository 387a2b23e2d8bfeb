from __future__ import annotations

import pickle
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, expect, sync_playwright

from bodycheck.reports.run_files.run_tables import Run
from tests.helpers.html_page import Page, report_page
from tests.helpers.markup_run import markup_run
from tests.helpers.shared_folder import shared_folder

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
LONG_MS = 120_000
"""Time limit of the browser, long enough for a busy machine."""
expect.set_options(timeout=LONG_MS)


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Return a run of the reference and the odd engine on a free and a forced scenario."""

    def make(folder: Path) -> None:
        (folder / "run").write_bytes(pickle.dumps(markup_run(folder)))

    measured: Run = pickle.loads((shared_folder(tmp_path_factory, "odd", make) / "run").read_bytes())
    return measured


@pytest.fixture(scope="session")
def html(run: Run) -> str:
    """Return the report of that run."""
    return report_page(run)


@pytest.fixture(scope="session")
def page(html: str) -> Page:
    """Return the report as parsed."""
    return Page(html)


@pytest.fixture(scope="session")
def report_file(html: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the report as a file."""
    place = tmp_path_factory.mktemp("report") / "report.html"
    place.write_text(html, encoding="utf-8")
    return place


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """Return the installed Chromium; without one the test is skipped."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on the path")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"], timeout=LONG_MS)
        yield browser
        browser.close()
