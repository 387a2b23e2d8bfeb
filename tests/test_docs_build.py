"""The documentation builds as in CI, where warnings are errors, and its answers are found and read."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "docs"

pytestmark = pytest.mark.nightly


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of the pages, built by the command of CI."""
    folder = tmp_path_factory.mktemp("site")
    (command,) = (line for line in (ROOT / ".ci/run").read_text().splitlines() if "sphinx-build" in line)
    _, *options, source, _ = command.split()
    words = [sys.executable, "-m", "sphinx", *options, "-d", str(folder / "trees"), source]
    done = subprocess.run(
        [*words, str(folder / "html")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return folder / "html"


def test_every_page_is_built(site: Path) -> None:
    """Every page is in a table of contents, and every link and every name of the interface resolves."""
    pages = {page.relative_to(SOURCE) for page in SOURCE.rglob("*.md")}
    assert {page for page in pages if (site / page.with_suffix(".html")).exists()} == pages


SEARCHED = {
    "minimal install": "start",
    "timeout": "workers",
    "hang": "workers",
    "stuck": "workers",
    "omega frame": "notation",
    "wxyz": "notation",
    "c++": "add-an-engine",
    "exit code": "questions",
    "does not converge": "measures",
    "untrusted": "security",
    "malicious": "security",
    "stable": "security",
    "cite": "contributing",
    "licence": "contributing",
}
"""What readers search for, and the page that answers."""


def test_words_that_readers_search_for_lead_to_the_page_that_answers(site: Path) -> None:
    """Each word is an entry of the index, which the search shows first; options have their command."""
    text = (site / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
    found = {
        word: [index["docnames"][page] for page, *_ in index["indexentries"].get(word, ())]
        for word in SEARCHED
    }
    assert {word: SEARCHED[word] in pages for word, pages in found.items()} == dict.fromkeys(SEARCHED, True)
    assert "bodycheck run --timeout-s" in {name for *_, name in index["objects"][""]}


CUT = """() => [...document.querySelectorAll("article pre, article .table-wrapper")]
    .filter((one) => one.scrollWidth > one.clientWidth + 1).map((one) => one.innerText.slice(0, 80))"""


@pytest.mark.parametrize("width", [390, 1440])
def test_no_table_and_no_code_is_cut_off(site: Path, width: int) -> None:
    """Tables and blocks of code fit into pages of telephones and of wide screens."""
    browser = shutil.which("chromium") or pytest.skip("no Chromium on the path")
    cut = {}
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=["--no-sandbox"])
        page = chromium.new_page(viewport={"width": width, "height": 900})
        for file in sorted(site.rglob("*.html")):
            page.goto(file.as_uri())
            wide = page.evaluate("document.documentElement.scrollWidth > innerWidth")
            cut[file.relative_to(site).as_posix()] = page.evaluate(CUT) + (["the page"] if wide else [])
        chromium.close()
    assert {name: found for name, found in cut.items() if found} == {}
