"""The documentation builds as in CI, where warnings are errors."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.nightly
def test_docs_build_without_a_warning(tmp_path: Path) -> None:
    """Every page is in a table of contents, and every link and every name of the interface resolves."""
    (command,) = (line for line in (ROOT / ".ci/run").read_text().splitlines() if "sphinx-build" in line)
    _, *options, source, _ = command.split()
    words = [sys.executable, "-m", "sphinx", *options, "-d", str(tmp_path / "trees"), source]
    done = subprocess.run(
        [*words, str(tmp_path / "html")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    pages = {page.relative_to(ROOT / source) for page in (ROOT / source).rglob("*.md")}
    assert {page for page in pages if (tmp_path / "html" / page.with_suffix(".html")).exists()} == pages
    index = (tmp_path / "html/searchindex.js").read_text()
    assert "--timeout-s" in index, "the search finds no option"
