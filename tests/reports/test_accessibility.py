"""axe finds nothing on the pages of any command, in light and in dark."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from playwright.sync_api import Browser

from tests.helpers.in_process_cli import run_bodycheck

pytestmark = pytest.mark.nightly

ROBOT = """<robot name="arm"><link name="base"><inertial><mass value="2"/>
<inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="2.5"/></inertial></link></robot>
"""
CASE = "run/trajectories/free-flight/reference_m1_0.005.npz"
TREE = "chain/trajectories/free-chain/reference_m1_0.025.npz"
COMMANDS = {
    "run free-flight --engine reference:m1 --dt 0.01,0.005 --no-speed --out run": "run/report.html",
    "compare run run --html compare.html": "compare.html",
    "explain run --case free-flight,reference:m1 --html explain.html": "explain.html",
    f"judge {CASE} --scenario free-flight --html judge.html": "judge.html",
    "audit arm.urdf --html audit.html": "audit.html",
    "dynamics reference cart-pole --random 1 --html dynamics.html": "dynamics.html",
    f"judge {CASE} {CASE.replace('0.005', '0.01')} --scenario free-flight --html two.html": "two.html",
    "nightly free-flight --engine reference:rk4 --no-speed --history nights": "nights/*/night.html",
    "history list nights": "nights/trends.html",
    "run free-chain --engine reference:m1 --dt 0.025 --no-speed --out chain": "chain/report.html",
    f"judge {TREE} --scenario free-chain --html tree.html": "tree.html",
    "ensemble intermediate-axis --n 20 --engine reference:rk4 --out bodies": "bodies/report.html",
}
"""Command -> the page that it writes."""
READABLE = """() => {
  const captionOf = figure => figure.querySelector("figcaption")?.textContent.trim();
  const bare = [...document.querySelectorAll("figure")].filter(figure => !captionOf(figure));
  const pictures = [...document.querySelectorAll("svg, canvas, .plot")].filter(one => !one.closest("table"));
  const cut = pictures.filter(one => one.getBoundingClientRect().right > innerWidth + 1);
  const codes = [...document.querySelectorAll("code")];
  const commands = codes.filter(code => code.textContent.startsWith("bodycheck "));
  const broken = commands.flatMap(code => {
    const texts = document.createTreeWalker(code, NodeFilter.SHOW_TEXT), found = [];
    while (texts.nextNode()) for (const { 0: word, index } of texts.currentNode.data.matchAll(/\\S+/g)) {
      const range = document.createRange();
      range.setStart(texts.currentNode, index);
      range.setEnd(texts.currentNode, index + word.length);
      const rects = [...range.getClientRects()];
      const wide = rects.reduce((sum, rect) => sum + rect.width, 0);
      if (rects.length > 1 && wide < code.parentElement.clientWidth) found.push(word);
    }
    return found;
  });
  const seen = [...bare.map(() => "a figure has no caption"), ...cut.map(() => "a picture is cut")];
  return [...seen, ...broken.map(word => `broken: ${word}`)];
}"""
"""What readers miss: captions, parts of pictures, words of commands that are broken but fit on a line."""


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return the script of axe-core; without npm the test is skipped."""
    npm, folder = shutil.which("npm"), tmp_path_factory.mktemp("axe")
    if npm is None:
        pytest.skip("no npm on the path")
    subprocess.run([npm, "install", "--silent", "--prefix", str(folder), "axe-core@4.14.1"], check=True)
    return (folder / "node_modules/axe-core/axe.min.js").read_text()


def violations(chromium: Browser, axe: str, path: Path, width: int, scheme: str) -> list[str]:
    """Return the rules of axe that a page breaks, and what readers miss."""
    page = chromium.new_page(viewport={"width": width, "height": 1000}, color_scheme=scheme)  # type: ignore[arg-type]
    page.goto(path.as_uri())
    page.wait_for_timeout(500)
    page.evaluate(axe)
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    overflow = page.evaluate("document.documentElement.scrollWidth") > width
    found = [f"{one['id']}: {one['nodes'][0]['html'][:200]}" for one in found] + ["overflow"] * overflow
    found += page.evaluate(READABLE)
    page.close()
    return found


def test_axe_finds_nothing_on_any_page(chromium: Browser, axe: str, tmp_path: Path) -> None:
    """No page breaks a rule of axe, is wider than its window, breaks words of commands or misses captions."""
    (tmp_path / "arm.urdf").write_text(ROBOT)
    for command, pattern in COMMANDS.items():
        done = run_bodycheck(tmp_path, *command.split())
        (page, *_) = sorted(tmp_path.glob(pattern)) or [None]
        assert page is not None, f"{command}: {done.stderr}"
        for width in (1440, 768, 390):
            for scheme in ("light", "dark"):
                assert violations(chromium, axe, page, width, scheme) == [], (command, width, scheme)
    planted = tmp_path / "planted.html"
    planted.write_text(
        "<html><title>t</title><body><main><h1>t</h1>"
        "<figure></figure><code>bodycheck run intermediate-axis-somewhere --engine mujoco:rk4 --no-speed"
        "</code></main></body></html>"
    )
    language, *others = violations(chromium, axe, planted, 390, "light")
    assert language.startswith("html-has-lang")
    assert others == ["a figure has no caption", "broken: --engine"]
