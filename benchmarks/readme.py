"""`python -m benchmarks.readme`: put the table of benchmarks/results.csv into the README."""

from __future__ import annotations

import argparse
from pathlib import Path

from benchmarks.store import read_results
from benchmarks.table import markdown_table

ROOT = Path(__file__).parents[1]
BEGIN, END = "<!-- measured: begin -->\n", "<!-- measured: end -->\n"


def with_table(page: str, table: str) -> str:
    """Return the page with the text between its two markers replaced by the table."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"the page needs the markers {BEGIN.strip()} and {END.strip()}, in this order")
    return f"{before}{BEGIN}{table}{END}{after}"


def main() -> None:
    """Rewrite README.md in place."""
    argparse.ArgumentParser(prog="python -m benchmarks.readme", description=__doc__).parse_args()
    page = ROOT / "README.md"
    table = markdown_table(read_results(ROOT / "benchmarks"))
    page.write_text(with_table(page.read_text(encoding="utf-8"), table), encoding="utf-8")


if __name__ == "__main__":
    main()
