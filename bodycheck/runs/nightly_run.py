"""A nightly run: an ordinary run, stored in a history and compared with the earlier runs."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from bodycheck._util.errors import InputError
from bodycheck._util.files import write_file
from bodycheck.examine.explanation.explain import MAX_EXPLAINED, with_causes
from bodycheck.reports.comparison.compare import unversioned
from bodycheck.reports.comparison.headlines import Headline
from bodycheck.reports.document import markdown
from bodycheck.reports.gates.thresholds import DEFAULT_THRESHOLDS, Thresholds
from bodycheck.reports.history.acceptances import read_acceptances
from bodycheck.reports.history.archive import TRAJECTORIES, History
from bodycheck.reports.history.baseline import read_summary, readable_runs, seal_run
from bodycheck.reports.history.history_output import nightly_document, nightly_page
from bodycheck.reports.history.nightly_files import (
    remove_old_motions,
    write_feed,
    write_judgement,
    write_unjudged,
)
from bodycheck.reports.history.open_regressions import NightlyState, open_lines, read_state
from bodycheck.reports.history.regression import Judgement, judge_run
from bodycheck.reports.history.trends import FILE as TRENDS
from bodycheck.reports.history.trends import trends_page
from bodycheck.reports.render.html import report_pages
from bodycheck.reports.run_files.report_files import write_pages
from bodycheck.reports.run_files.run_reader import read_tables
from bodycheck.reports.run_files.run_tables import FAILED_CASES, Run, failed_case, study_key
from bodycheck.reports.run_files.writer import write_tables, write_trajectories
from bodycheck.runs.directory import Storage, begin, interrupted_in, proceed, remove_interrupted
from bodycheck.runs.manifest import Identity
from bodycheck.runs.request import Request
from bodycheck.runs.run_progress import ProgressFactory

SPEED_PASSES = 10
"""How often a nightly run times every case; noise of a shared machine rarely disturbs every pass."""


def run_nightly(
    request: Request,
    folder: Path,
    make_progress: ProgressFactory,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
) -> tuple[Judgement, Path]:
    """Carry out a request, store it in a history, and return its judgement and its folder.

    folder: that of the history, created if it does not exist. thresholds: the size above which a change
    counts. Raises InputError if the input is wrong or cannot be written, and StoppedError if the user
    interrupts the run; `resume_nightly` continues it.
    """
    history, identity = History.at(folder), Identity.new()
    out = history.folder / identity.run_id
    return begin(request, identity, out, make_progress, _storage(history, thresholds))


def resume_nightly(
    folder: Path,
    make_progress: ProgressFactory,
    thresholds: Thresholds = DEFAULT_THRESHOLDS,
    *,
    allow_code: bool = False,
) -> tuple[Judgement, Path]:
    """Continue the newest interrupted nightly run of a history with its original settings.

    Finished cases are not run again, but all speeds are measured in one sitting. Parameters and errors as for
    `run_nightly`; raises InputError if there is no interrupted run.
    """
    interrupted = interrupted_in(folder)
    if not interrupted:
        raise InputError(f"--resume: {folder} has no interrupted nightly run")
    storage = _storage(History.at(folder), thresholds)
    return proceed(interrupted[-1], make_progress, storage, allow_code=allow_code)


def _storage(history: History, thresholds: Thresholds) -> Storage[tuple[Judgement, Path]]:
    def store(run: Run) -> tuple[Judgement, Path]:
        stored = store_nightly(run, history, thresholds)
        for earlier in interrupted_in(history.folder):
            if earlier.name < run.run_id:
                remove_interrupted(earlier)
        return stored

    again = ("nightly", "--history", str(history.folder), "--resume")
    return Storage(store, again, "comparing with earlier runs, and writing the report")


def store_nightly(
    run: Run, history: History, thresholds: Thresholds = DEFAULT_THRESHOLDS
) -> tuple[Judgement, Path]:
    """Judge a run and append it to a history, while no other run is being appended.

    An error in judging the run or in rendering its pages is raised after the run was stored.
    """
    fault: Exception | None = None
    with history.new_run(run.run_id) as folder:
        write_tables(run, folder)
        try:
            judged = _judged(run, history, folder, thresholds)
        except OSError:
            raise
        except Exception as error:  # noqa: BLE001 - store the run even if the history is faulty
            write_unjudged(run, folder)
            fault = error
        seal_run(folder)
        write_trajectories(run, folder / TRAJECTORIES)
    stored_folder = history.folder / run.run_id
    if fault is not None:
        fault.add_note(f"the run is stored in {stored_folder}, but could not be judged")
        raise fault
    with history.locked():
        remove_old_motions(history.runs())
        future = set(history.dated_in_future(run.run_id))
        stored = [folder for folder in history.runs() if folder not in future]
        readable, _ = readable_runs(stored)
        try:
            write_feed(history.folder, _reports(readable), read_acceptances(history))
            write_file(history.folder / TRENDS, trends_page(judged).encode())
        except InputError as error:  # the run is stored and judged
            print(f"{error}; the feed and the trends lack this run", file=sys.stderr)
    return judged, stored_folder


def _reports(runs: Iterable[Path]) -> Iterator[tuple[dict[str, Any], NightlyState]]:
    """Yield night.json and what is open after each nightly run, without those of which it is damaged."""
    for folder in runs:
        try:
            report = read_summary(folder), read_state(folder)
        except InputError:
            continue
        yield report


def _judged(run: Run, history: History, folder: Path, thresholds: Thresholds) -> Judgement:
    judged = judge_run(history, read_tables(folder), thresholds)
    explained = _with_causes(run, judged)
    if explained is not run:
        run = explained
        write_tables(run, folder)
        judged = judge_run(history, read_tables(folder), thresholds)
    write_pages(report_pages(run), folder)
    write_judgement(judged, folder)
    (folder / "night.html").write_bytes(nightly_page(judged).encode())
    (folder / "night.md").write_bytes(markdown(nightly_document(judged)).encode())
    return judged


def _worst_case(line: Headline, run: Run) -> str:
    """Return SCENARIO,ENGINE:METHOD of what a line names first; "" if no case of it ended well."""
    names = {base: name for name, base in unversioned(run.manifest["engines"]).items()}
    engine = names.get(line.engine, line.engine)
    key = line.main.scenario or "", engine, line.main.method
    ended = any(case.ok and study_key(case.columns) == key for case in run.cases)
    return failed_case(*key) if ended else ""


def _with_causes(run: Run, judged: Judgement) -> Run:
    """Return a run with what became worse without a cause in its manifest, and the faults that explain it."""
    worse = [_worst_case(one.line, run) for one in open_lines(judged.open) if not one.line.cause]
    worse = [case for case in worse if case][:MAX_EXPLAINED]
    if not worse:
        return run
    return with_causes(replace(run, manifest={**run.manifest, FAILED_CASES: worse}), worse)
