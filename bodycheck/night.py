"""One night: a run like any other, stored in a history and judged beside its past."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from bodycheck.manifest import Identity
from bodycheck.progress import Watching
from bodycheck.reports.history.judgement import Judgement, judge_night
from bodycheck.reports.history.markdown import night_markdown
from bodycheck.reports.history.night_files import write_judgement, write_run_of_night
from bodycheck.reports.history.nights import History
from bodycheck.reports.history.page import render_night
from bodycheck.reports.run import Run
from bodycheck.reports.stored import read_tables
from bodycheck.runner import run_selection
from bodycheck.stored_run import Asked

SPEED_PASSES = 10
"""How often a night times all cases: what disturbs a shared machine rarely does so in all the passes."""


def run_night(asked: Asked, folder: Path, watching: Watching) -> tuple[Judgement, Path]:
    """Run what is asked, store it in a history, and return what it is beside the past, and its folder.

    folder: of the history, made if it is not there. Raises InputError where something is wrong or cannot be
    written: then the history is what it was.
    """
    selection, manner = asked.selection, replace(asked.manner, speed_passes=SPEED_PASSES)
    history = History.at(folder)
    with watching(selection.cases_listed()) as progress:
        run = run_selection(selection, manner, Identity.new(), journal=None, progress=progress)
    return store_night(run, history)


def store_night(run: Run, history: History) -> tuple[Judgement, Path]:
    """Append a run to a history; it is judged as it is stored, while no other night is."""
    with history.new_night(run.run_id) as folder:
        write_run_of_night(run, folder)
        judged = judge_night(history, read_tables(folder))
        write_judgement(judged, folder)
        (folder / "night.html").write_text(render_night(judged), encoding="utf-8")
        (folder / "night.md").write_text(night_markdown(judged), encoding="utf-8")
    return judged, history.folder / run.run_id
