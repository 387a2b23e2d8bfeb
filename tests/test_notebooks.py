"""The notebooks run, and the docs are generated from the program."""

from __future__ import annotations

import json
import runpy
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from bodycheck.cli.commands import app
from bodycheck.reports.measurement.measures import MEASURES
from tests.helpers.doc_pages import ROOT

NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.ipynb"))


@pytest.mark.nightly
@pytest.mark.parametrize("file", NOTEBOOKS, ids=lambda file: file.stem)
def test_notebook_runs(file: Path, tmp_path: Path) -> None:
    """Every cell of a notebook runs, and prints where it printed when its output was stored."""
    copy = tmp_path / file.name
    copy.write_bytes(file.read_bytes())
    words = [sys.executable, ROOT / "docs/run_notebooks.py", copy]
    done = subprocess.run(words, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    before, after = (json.loads(one.read_text())["cells"] for one in (file, copy))
    assert [bool(cell.get("outputs")) for cell in after] == [bool(cell.get("outputs")) for cell in before]


@pytest.fixture(scope="module")
def generated() -> dict[str, Any]:
    """Return the functions of the extension that generates pages."""
    pytest.importorskip("sphinx")
    return runpy.run_path(str(ROOT / "docs/generated_pages.py"))


def test_every_command_and_option_has_its_place(generated: dict[str, Any]) -> None:
    """The page of a command shows each of its options, and the index lists each command once."""
    found = list(generated["commands"](get_command(app)))
    assert {"bodycheck run", "bodycheck history accept", "bodycheck schema"} <= {name for name, _, _ in found}
    index = generated["index_of"](found)
    for name, _, command in found:
        page = generated["page_of"](name, command)
        assert page.startswith(f"# `{name}`\n")
        assert all(
            f"{option.opts[0]}" in page for option in command.params if option.param_type_name == "option"
        )
        assert index.count(f"[`{name}`]") == 1


def test_every_measure_is_in_the_table(generated: dict[str, Any]) -> None:
    """The table has one row per measure, with its columns."""
    table = generated["table_of_measures"]()
    for measure in MEASURES.values():
        assert table.count(f"\n| `{measure.name}` |") == 1
        assert all(f"`{column}`" in table for column in measure.columns)


def test_arguments_become_entries() -> None:
    """A paragraph that explains arguments becomes one entry each; other text stays as it is."""
    pytest.importorskip("sphinx")
    entries = runpy.run_path(str(ROOT / "docs/plain_docstrings.py"))["entries"]
    text = [
        "Return a sum.",
        "",
        "a, b: numbers [default: 0]. mass: in kg; as b: is no entry. Raises ValueError",
        "for text.",
    ]
    expected = [
        *("Return a sum.", ""),
        *(":param a, b: numbers [default: 0].", ":param mass: in kg; as b: is no entry.", ""),
        *("Raises ValueError for text.", ""),
    ]
    assert entries(text, ["a", "b", "mass"]) == expected
    assert entries(text[:1], ["a"]) == ["Return a sum.", ""]
