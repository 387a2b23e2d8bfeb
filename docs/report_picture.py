"""Makes docs/report.png, the README's picture, from a real run: python docs/report_picture.py RUN_FOLDER.

RUN_FOLDER is what `bodycheck run --out RUN_FOLDER` left; the test extra and Chromium are needed.
"""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright


def main(folder: Path) -> None:
    """Take the page down to its plot over all scenarios, once that is drawn."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1440, "height": 2000})
        page.goto((folder.resolve() / "report.html").as_uri())
        page.wait_for_selector("[data-plot=overall][data-drawn]")
        end = page.evaluate(
            "() => document.querySelector('[data-plot=overall]').getBoundingClientRect().bottom"
        )
        picture = Path(__file__).with_name("report.png")
        page.screenshot(path=picture, clip={"x": 0, "y": 0, "width": 1440, "height": end})
        print(picture)
        browser.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
