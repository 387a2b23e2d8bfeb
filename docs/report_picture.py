"""Makes pictures of a real report, for the README and the docs.

python docs/report_picture.py RUN_FOLDER: docs/report.png, from the top to the map of all methods.
python docs/report_picture.py RUN_FOLDER SCENARIO: docs/report-plots.png and docs/report-motion.png.

RUN_FOLDER is what `bodycheck run --out RUN_FOLDER` left; the test extra and Chromium are needed.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import Locator, Page, sync_playwright

HERE = Path(__file__).parent
WIDTH, HEIGHT = 1440, 2000


def front(page: Page) -> None:
    """Take the page down to the map of all methods."""
    end = page.evaluate("() => document.querySelector('#map').getBoundingClientRect().bottom")
    page.screenshot(path=HERE / "report.png", clip={"x": 0, "y": 0, "width": WIDTH, "height": end})


def parts(page: Page, scenario: str) -> None:
    """Take the plots of a scenario and its motion, where it opens."""
    section = page.locator("section.scenario", has=page.get_by_role("heading", name=scenario, exact=True))
    section.locator("details").first.evaluate("part => { part.open = true; }")  # it is, in a short report
    take(section.locator(".plots"), "[data-plot]", "report-plots.png")
    take(section.locator("[data-motion]"), "canvas", "report-motion.png")


def take(part: Locator, drawn: str, name: str) -> None:
    """Take a part of the page once there is something drawn in it."""
    part.scroll_into_view_if_needed()
    part.locator(drawn).first.wait_for()
    part.page.wait_for_timeout(1000)  # sections are drawn one after the other as they come near
    part.screenshot(path=HERE / name)


def main(folder: Path, *scenario: str) -> None:
    """Open the report and take what was asked for."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": WIDTH, "height": HEIGHT})
        page.goto((folder.resolve() / "report.html").as_uri())
        if scenario:
            parts(page, *scenario)
        else:
            front(page)
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]), *sys.argv[2:])
