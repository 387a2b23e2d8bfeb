"""A night on the terminal, and a history's nights."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.text import Text

from bodycheck.reports.comparison.text import print_changes
from bodycheck.reports.comparison.words import HEADINGS
from bodycheck.reports.console import console, print_columns
from bodycheck.reports.history.judgement import Judgement
from bodycheck.reports.history.past import TOLD
from bodycheck.reports.history.words import headline, night_sentences

if TYPE_CHECKING:
    import pandas as pd

_STYLES = {
    "regression": "bold red",
    "no regression": "bold green",
    "past too thin": "bold yellow",
    "nothing measured": "bold red",
}


def print_night(judged: Judgement) -> None:
    """Print what was told of a night, the worst first."""
    out = console()
    out.print(Text(headline(judged), style=_STYLES[judged.status]))
    for sentence in night_sentences(judged):
        out.print(Text(sentence))
    if judged.comparison is not None:
        print_changes(judged.comparison.changes, "night.html and changes.csv have all")


def print_nights(nights: pd.DataFrame) -> None:
    """Print one line a night, the oldest first."""
    rows = nights[list(TOLD)].astype(str).to_numpy().tolist()
    print_columns(console(), TOLD, rows, right=(*HEADINGS, "cases"))
